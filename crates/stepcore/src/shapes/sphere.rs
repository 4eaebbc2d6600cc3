//! A sphere against a sphere, a capsule or a box.
//!
//! The other shape's point nearest to the sphere's centre gives the contact. Inside a box this point is
//! the centre itself. There the nearest face is the way out, and among equally near faces the first in
//! the order −x, +x, −y, +y, −z, +z.

use super::touch::{balls, select3, Ball, Touch, Touches};
use crate::real::{Mask, Real};
use crate::spatial::{Pose, V3};

/// A centre no farther than this fraction of the sizes from a box is in it.
const IN_BOX: f64 = 1e-15;

pub fn sphere_sphere<R: Real>(a: &Pose<R>, ra: R, b: &Pose<R>, rb: R) -> Touches<R, 1> {
    [balls(&ball(a, ra), &ball(b, rb))]
}

/// `hc` is half the length of the capsule's axis.
pub fn sphere_capsule<R: Real>(s: &Pose<R>, rs: R, c: &Pose<R>, rc: R, hc: R) -> Touches<R, 1> {
    let axis = c.axis(2);
    let along = axis.dot(&(s.pos - c.pos)).clamp(-hc, hc);
    let nearest = Ball { centre: c.pos + axis * along, radius: rc, axis };
    [balls(&ball(s, rs), &nearest)]
}

#[inline(always)]
fn ball<R: Real>(pose: &Pose<R>, radius: R) -> Ball<R> {
    Ball { centre: pose.pos, radius, axis: pose.axis(2) }
}

/// `half` holds the box's half lengths.
pub fn sphere_box<R: Real>(s: &Pose<R>, r: R, b: &Pose<R>, half: V3<R>) -> Touches<R, 1> {
    let centre = b.to_local(&(s.pos - b.pos));
    let nearest = V3::new(
        centre.x.clamp(-half.x, half.x),
        centre.y.clamp(-half.y, half.y),
        centre.z.clamp(-half.z, half.z),
    );
    let apart = nearest - centre;
    let length = apart.dot(&apart).sqrt();
    let inside = length.le(R::of(IN_BOX) * (r + half.x + half.y + half.z));

    let mut normal = apart * (R::one() / length);
    let mut dist = length - r;
    let mut pos = (nearest + centre + normal * r) * R::of(0.5);
    if inside.any() {
        let (depth, outward) = nearest_face(&centre, &half);
        let middle = centre + outward * (R::of(0.5) * (depth - r));
        normal = select3(inside, &-outward, &normal);
        dist = R::select(inside, -depth - r, dist);
        pos = select3(inside, &middle, &pos);
    }
    [Touch {
        dist,
        pos: b.pos + b.to_world(&pos),
        normal: b.to_world(&normal),
        exists: R::Mask::of(true),
        feature: R::zero(),
    }]
}

/// Returns the depth below the nearest face of a point in the box, and this face's outward normal.
#[inline(always)]
fn nearest_face<R: Real>(point: &V3<R>, half: &V3<R>) -> (R, V3<R>) {
    let mut depth = point.x + half.x;
    let mut outward = -V3::x();
    for i in 0..3 {
        for sign in [-R::one(), R::one()] {
            let here = (half[i] - sign * point[i]).abs();
            let nearer = here.lt(depth);
            let mut way = V3::zeros();
            way[i] = sign;
            depth = R::select(nearer, here, depth);
            outward = select3(nearer, &way, &outward);
        }
    }
    (depth, outward)
}
