//! The frame of a contact: the two directions of its friction, MuJoCo's choice.

use crate::real::{Mask, Real};
use crate::shapes::touch::{select3, unit};
use crate::shapes::ShapeTest;
use crate::spatial::{Pose, V3};

/// Sine of an angle that is only rounding.
const NO_ANGLE: f64 = 1e-15;

/// Returns the usual first tangent before it is made perpendicular, if a pair gives no hint and the
/// normal is not within 60° of it.
pub fn usual<R: Real>() -> V3<R> {
    V3::y()
}

/// Returns the replacement of a hint along the normal, unless the normal is within 60° of it.
pub fn spare<R: Real>() -> V3<R> {
    V3::x()
}

/// Returns the pair's hint: a capsule on a plane slides and rolls along its axis.
#[inline(always)]
pub fn hint<R: Real>(test: ShapeTest, second: &Pose<R>) -> Option<V3<R>> {
    (test == ShapeTest::PlaneCapsule).then(|| second.axis(2))
}

/// Returns the contact frame's second and third axis; the normal is its first.
///
/// The second axis is the hint (plane-capsule: the capsule's axis) or else the world's y, or z if the
/// normal is within 60° of ±y, made perpendicular to the normal. A hint along the normal gives no
/// direction: the world's x replaces it (y if the normal is within 60° of ±x).
#[inline(always)]
pub fn tangents<R: Real>(normal: &V3<R>, hint: Option<&V3<R>>) -> (V3<R>, V3<R>) {
    let half = R::of(0.5);
    let first = match hint {
        None => {
            let steep = normal.y.abs().lt(half);
            unit(&across(normal, &select3(steep, &usual(), &V3::z())))
        }
        Some(axis) => {
            let raw = across(normal, axis);
            // If it is nearly along the normal, the rest of the hint is rounding and may itself lean
            // along the normal: measure it, then project once more.
            let once = unit(&raw);
            let twice = across(normal, &once);
            let tiny = R::of(f64::max(NO_ANGLE, 4.0 * R::epsilon()));
            let clear = raw.dot(&raw).ge(tiny * tiny).and(twice.dot(&twice).ge(half));
            let guess = unit(&twice);
            if clear.all() {
                guess
            } else {
                let flat = normal.x.abs().lt(half);
                let other = unit(&across(normal, &select3(flat, &spare(), &V3::y())));
                select3(clear, &guess, &other)
            }
        }
    };
    (first, normal.cross(&first))
}

/// Returns the part of `v` across the unit vector `normal`.
#[inline(always)]
fn across<R: Real>(normal: &V3<R>, v: &V3<R>) -> V3<R> {
    v - normal * normal.dot(v)
}
