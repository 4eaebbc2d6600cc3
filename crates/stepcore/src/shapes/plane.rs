//! A plane against a sphere or a capsule.
//!
//! The plane is infinite, its normal the z axis of its pose. The sphere's height
//! above it gives the contact; a capsule is tested as the two balls at its ends,
//! each in a slot of its own, so that one lying flat rests on both.

use super::touch::{Touch, Touches};
use crate::real::{Mask, Real};
use crate::spatial::{Pose, V3};

pub fn plane_sphere<R: Real>(plane: &Pose<R>, sphere: &Pose<R>, radius: R) -> Touches<R, 1> {
    [plane_ball(plane, &sphere.pos, radius)]
}

/// Slot 0 is the end along the capsule's +z, slot 1 the other.
/// `half` is half the distance between the end balls' centres.
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
