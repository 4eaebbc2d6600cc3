//! Any convex shape against any other: the pairs that have no closed form.

use super::by_lane::{empty, OneWorld};
use super::hint::Hint;
use super::manifold::ContactPatch;
use super::separation::{normal, Pairing, Separation};
use super::solid::{plain, Core, Solid};
use super::touch::{Touch, Touches};
use super::Shape;
use crate::real::{Constant, Mask, Real};
use crate::scene::GeomType;
use core::cell::Cell;

/// A pair of shapes by their types.
#[derive(Clone, Copy)]
pub struct Convex<'a> {
    pub one: GeomType,
    pub two: GeomType,
    /// Shapes that are this far apart [m] have no contact.
    pub within: f64,
    pub hint: Option<&'a Cell<Hint>>,
}

/// The largest number of contacts of two flat sides: the deepest place of their patch, the furthest
/// place from it, and the furthest ones from both. As soon as a shape leans its deepest place is where
/// it tips: a cylinder on a box, a pillar and a rounded sole tip at 0.84 to 0.98 of the force that tips
/// a rigid one (with eight contacts at 0.86 to 0.95), and rest at 1e-15 m/s (with three, five or six,
/// which share a load unevenly, at 1e-4 to 1e-2). See docs/method/detect.md.
pub const PATCH: usize = 4;

/// Returns the largest number of contacts: one of a round shape, two along a capsule's side.
pub fn most(one: GeomType, two: GeomType) -> usize {
    let either = |kind| one == kind || two == kind;
    if either(GeomType::Sphere) || either(GeomType::Ellipsoid) {
        1
    } else if either(GeomType::Capsule) {
        2
    } else {
        PATCH
    }
}

impl<const N: usize> OneWorld<N> for Convex<'_> {
    fn touches<R: Real>(&self, one: &Shape<R>, two: &Shape<R>) -> Touches<R, N> {
        let (one, two) = (solid(self.one, one), solid(self.two, two));
        match meeting(&one, &two, self.within, self.hint) {
            Some(found) => contacts(&one, &two, &found),
            None => [empty(); N],
        }
    }
}

/// Returns the core and the radius of a shape.
pub fn solid<'a, R: Real>(kind: GeomType, shape: &Shape<'a, R>) -> Solid<'a, R> {
    let size = shape.size.each_ref().map(|x| x.lane(0));
    let [a, b, _] = size;
    let (core, radius) = match kind {
        GeomType::Capsule => (Core::Segment(b), a),
        GeomType::Ellipsoid => (Core::Ellipsoid(size), 0.0),
        GeomType::Cylinder => (Core::Cylinder(a, b), 0.0),
        GeomType::Box => (Core::Box(size), 0.0),
        GeomType::Mesh => (shape.hull.map_or(Core::Point, Core::Hull), 0.0),
        GeomType::Sphere | GeomType::Plane | GeomType::HField => (Core::Point, a),
    };
    Solid { core, radius, pose: shape.pose }
}

/// Operations of one support function, for counting numbers.
const SUPPORT: u64 = 40;

/// Returns the distance of two convex shapes, and its direction; None if they are proven `within` [m]
/// apart.
pub fn meeting<R: Real>(
    one: &Solid<R>,
    two: &Solid<R>,
    within: f64,
    hint: Option<&Cell<Hint>>,
) -> Option<Separation> {
    let (p, q) = (plain(one.pose), plain(two.pose));
    let pairing = Pairing::new(
        Solid { core: one.core, radius: one.radius, pose: &p },
        Solid { core: two.core, radius: two.radius, pose: &q },
    );
    let separation = pairing.separation(within, hint);
    spend::<R>(pairing.asked() * SUPPORT);
    separation
}

/// Computes the contacts of two convex shapes along a direction.
pub fn contacts<R: Real, const N: usize>(
    one: &Solid<R>,
    two: &Solid<R>,
    found: &Separation,
) -> Touches<R, N> {
    let between = two.pose.pos - one.pose.pos;
    let normal = normal(found, one, two, &between);
    let size = one.extent() + two.extent();
    let manifold = ContactPatch { one: *one, two: *two, between, normal, size }.manifold(found, N);
    let (near, far) = (R::of(one.radius), R::of(two.radius));
    let mut out = [empty(); N];
    for (to, point) in out.iter_mut().zip(&manifold.points[..manifold.count]) {
        *to = Touch {
            dist: point.apart - near - far,
            pos: one.pose.pos + point.at + normal * (R::of(0.5) * (near - far)),
            normal,
            exists: Mask::of(true),
            feature: R::of(f64::from(point.name)),
        };
    }
    out
}

/// Counts operations that used plain numbers.
fn spend<R: Real>(operations: u64) {
    let mut sum = R::zero();
    for _ in 0..operations {
        sum += R::one();
    }
    let _ = sum;
}
