//! Which exact test a pair of shapes has, chosen when a model is compiled.

use crate::scene::GeomType;

/// The most contacts of a pair.
pub const MOST_TOUCHES: usize = 2;

/// Geom 1's shape, then geom 2's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShapeTest {
    PlaneSphere,
    PlaneCapsule,
    SphereSphere,
    SphereCapsule,
    SphereBox,
    CapsuleCapsule,
}

impl ShapeTest {
    /// Of two shapes in the order of their types; None: not built yet.
    pub fn of(one: GeomType, two: GeomType) -> Option<Self> {
        use GeomType::{Box, Capsule, Plane, Sphere};
        match (one, two) {
            (Plane, Sphere) => Some(Self::PlaneSphere),
            (Plane, Capsule) => Some(Self::PlaneCapsule),
            (Sphere, Sphere) => Some(Self::SphereSphere),
            (Sphere, Capsule) => Some(Self::SphereCapsule),
            (Sphere, Box) => Some(Self::SphereBox),
            (Capsule, Capsule) => Some(Self::CapsuleCapsule),
            _ => None,
        }
    }
}
