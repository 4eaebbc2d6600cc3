//! A sphere against a cylinder.
//!
//! Next to its side the cylinder is a ball at the height of the sphere's centre, above a lid a plane,
//! beyond both a point of the rim. A centre inside leaves by the nearer of side and lid; if the lids
//! are equally near, by the lower.

use super::touch::{balls, Ball, Touch, Touches};
use crate::real::{Mask, Real};
use crate::spatial::Pose;

/// `half` is half the cylinder's height.
pub fn sphere_cylinder<R: Real>(s: &Pose<R>, rs: R, c: &Pose<R>, rc: R, half: R) -> Touches<R, 1> {
    let axis = c.axis(2);
    let between = s.pos - c.pos;
    let height = axis.dot(&between);
    let across = between - axis * height;
    let out = across.dot(&across).sqrt();
    let (beside, above) = (out - rc, height.abs() - half);
    let up = axis * R::select(height.gt(R::zero()), R::one(), -R::one());

    let sphere = Ball { centre: s.pos, radius: rs, axis: s.axis(2) };
    let side = balls(&sphere, &Ball { centre: c.pos + axis * height, radius: rc, axis });
    let rim = c.pos + up * half + across * (rc / out);
    let rim = balls(&sphere, &Ball { centre: rim, radius: R::zero(), axis });
    let dist = above - rs;
    let lid = Touch {
        dist,
        pos: s.pos - up * (rs + R::of(0.5) * dist),
        normal: -up,
        exists: R::Mask::of(true),
        feature: R::zero(),
    };
    let beyond = beside.gt(R::zero()).and(above.gt(R::zero()));
    [rim.or_else(beyond, &side.or_else(beside.gt(above), &lid))]
}
