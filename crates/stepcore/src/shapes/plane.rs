//! A plane against a sphere, a capsule, an ellipsoid, a cylinder or a box.
//!
//! The plane is infinite, its normal the z axis of its pose. The height of a shape's points above it
//! gives the contacts: for a sphere and an ellipsoid the lowest point; for a capsule the balls at both
//! ends, so that one lying flat rests on both; for a box the four corners below its centre; for a
//! cylinder the lowest point of either rim and two more points of the lower one, so that it can stand
//! upright. Points and their order are MuJoCo's.

use super::touch::{select3, unit, Touch, Touches};
use crate::real::{Mask, Real};
use crate::spatial::{Pose, V3};

pub fn plane_sphere<R: Real>(plane: &Pose<R>, sphere: &Pose<R>, radius: R) -> Touches<R, 1> {
    [plane_ball(plane, &sphere.pos, radius)]
}

/// Slot 0 is the end along the capsule's +z, slot 1 the other. `half` is half the distance between the
/// end balls' centres.
pub fn plane_capsule<R: Real>(
    plane: &Pose<R>,
    capsule: &Pose<R>,
    radius: R,
    half: R,
) -> Touches<R, 2> {
    let reach = capsule.axis(2) * half;
    [
        plane_ball(plane, &(capsule.pos + reach), radius),
        plane_ball(plane, &(capsule.pos - reach), radius),
    ]
}

#[inline(always)]
fn plane_ball<R: Real>(plane: &Pose<R>, centre: &V3<R>, radius: R) -> Touch<R> {
    let normal = plane.axis(2);
    let dist = normal.dot(&(centre - plane.pos)) - radius;
    let pos = centre - normal * (radius + R::of(0.5) * dist);
    Touch { dist, pos, normal, exists: R::Mask::of(true), feature: R::zero() }
}

/// `half` holds the half axes. With h the ellipsoid's support along the normal n, in the ellipsoid's
/// axes h = |(aₖnₖ)|, the lowest point is −(aₖ²nₖ)/h.
pub fn plane_ellipsoid<R: Real>(
    plane: &Pose<R>,
    ellipsoid: &Pose<R>,
    half: V3<R>,
) -> Touches<R, 1> {
    let normal = plane.axis(2);
    let stretched = ellipsoid.to_local(&normal).component_mul(&half);
    let support = stretched.dot(&stretched).sqrt();
    let lowest = ellipsoid.to_world(&(stretched.component_mul(&half) * (-R::one() / support)));
    let dist = normal.dot(&(ellipsoid.pos - plane.pos)) - support;
    let pos = ellipsoid.pos + lowest - normal * (R::of(0.5) * dist);
    [Touch { dist, pos, normal, exists: R::Mask::of(true), feature: R::zero() }]
}

/// A corner of a box, relative to its centre.
#[derive(Clone, Copy)]
struct Corner<R: Real> {
    /// Its number: bit k is set where its coordinate k is positive.
    index: R,
    /// Height above the centre, along the plane's normal.
    height: R,
    at: V3<R>,
}

impl<R: Real> Corner<R> {
    #[inline(always)]
    fn or_else(&self, mask: R::Mask, other: &Self) -> Self {
        Self {
            index: R::select(mask, self.index, other.index),
            height: R::select(mask, self.height, other.height),
            at: select3(mask, &self.at, &other.at),
        }
    }
}

/// Comparisons that put four in order.
const ORDER: [(usize, usize); 5] = [(0, 1), (2, 3), (0, 2), (1, 3), (1, 2)];

/// Returns the lower corner of each of the four diagonals, in the order of the corners' numbers, which
/// are the features. `half` holds the box's half lengths.
pub fn plane_box<R: Real>(plane: &Pose<R>, cuboid: &Pose<R>, half: V3<R>) -> Touches<R, 4> {
    let normal = plane.axis(2);
    let centre = normal.dot(&(cuboid.pos - plane.pos));
    let [x, y, z] = [0, 1, 2].map(|k| cuboid.axis(k) * half[k]);
    let [up_x, up_y, up_z] = [&x, &y, &z].map(|edge| normal.dot(edge));
    let blank = Corner { index: R::zero(), height: R::zero(), at: x };
    let mut corners = [blank; 4];
    for (k, corner) in corners.iter_mut().enumerate() {
        let sign = |bit: usize| if k & bit != 0 { R::one() } else { -R::one() };
        let height = up_x * sign(1) + up_y * sign(2) - up_z;
        let at = x * sign(1) + y * sign(2) - z;
        let one = Corner { index: R::of(k as f64), height, at };
        let opposite = Corner { index: R::of((7 - k) as f64), height: -height, at: -at };
        *corner = one.or_else(height.le(R::zero()), &opposite);
    }
    for (i, j) in ORDER {
        let (a, b) = (corners[i], corners[j]);
        let right = a.index.lt(b.index);
        corners[i] = a.or_else(right, &b);
        corners[j] = b.or_else(right, &a);
    }
    let none = R::zero();
    let blank = Touch { dist: none, pos: normal, normal, exists: R::Mask::of(true), feature: none };
    let mut touches = [blank; 4];
    for (touch, corner) in touches.iter_mut().zip(&corners) {
        touch.dist = centre + corner.height;
        touch.pos = cuboid.pos + corner.at - normal * (R::of(0.5) * touch.dist);
        touch.feature = corner.index;
    }
    touches
}

/// Sine of an angle that is only rounding.
const NO_ANGLE: f64 = 1e-15;

/// Slot 0 is the lowest point of the lower rim and slot 1 of the upper; slots 2 and 3 complete the
/// first to an equilateral triangle on the lower rim. For an upright cylinder the first lies along the
/// cylinder's x axis. `half` is half its height.
pub fn plane_cylinder<R: Real>(
    plane: &Pose<R>,
    cylinder: &Pose<R>,
    radius: R,
    half: R,
) -> Touches<R, 4> {
    let (normal, axis) = (plane.axis(2), cylinder.axis(2));
    let rise = normal.dot(&axis);
    let down = select3(rise.gt(R::zero()), &-axis, &axis);
    let out = downhill(cylinder, &(axis * rise - normal));
    let low = out * radius;
    // Across the lowest point and the axis: √3/2 of the radius, a third of a turn to either side.
    let side = out.cross(&down) * (radius * R::of(0.75).sqrt());
    let (end, third) = (down * half, low * R::of(-0.5));
    let points = [end + low, low - end, end + third + side, end + third - side];
    let mut slot = -R::one();
    points.map(|point| {
        let dist = normal.dot(&(cylinder.pos - plane.pos)) + normal.dot(&point);
        let pos = cylinder.pos + point - normal * (R::of(0.5) * dist);
        slot += R::one();
        Touch { dist, pos, normal, exists: R::Mask::of(true), feature: slot }
    })
}

/// Returns the unit vector along `raw`, which lies across the cylinder's axis except for rounding; if
/// only rounding is left of it, the cylinder's x axis.
#[inline(always)]
fn downhill<R: Real>(cylinder: &Pose<R>, raw: &V3<R>) -> V3<R> {
    let axis = cylinder.axis(2);
    let once = unit(raw);
    let twice = once - axis * axis.dot(&once);
    let tiny = R::of(f64::max(NO_ANGLE, 4.0 * R::epsilon()));
    let clear = raw.dot(raw).ge(tiny * tiny).and(twice.dot(&twice).ge(R::of(0.5)));
    select3(clear, &unit(&twice), &cylinder.axis(0))
}
