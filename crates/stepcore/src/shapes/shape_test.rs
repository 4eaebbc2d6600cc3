//! The exact test of a pair of shapes, chosen when a model is compiled.

use super::boxes;
use super::convex;
use super::{height_field, plane_mesh};
use crate::scene::GeomType;

/// Geom 1's shape, then geom 2's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShapeTest {
    PlaneSphere,
    PlaneCapsule,
    PlaneEllipsoid,
    PlaneCylinder,
    PlaneBox,
    PlaneMesh,
    SphereSphere,
    SphereCapsule,
    SphereBox,
    SphereCylinder,
    CapsuleCapsule,
    CapsuleBox,
    BoxBox,
    /// Two convex shapes of these types: the routine that needs no closed form.
    Convex(GeomType, GeomType),
    /// A height field and a shape of this type.
    OnField(GeomType),
}

/// The test of two shapes in the order of their types.
const TESTS: &[(GeomType, GeomType, ShapeTest)] = &[
    (GeomType::Plane, GeomType::Sphere, ShapeTest::PlaneSphere),
    (GeomType::Plane, GeomType::Capsule, ShapeTest::PlaneCapsule),
    (GeomType::Plane, GeomType::Ellipsoid, ShapeTest::PlaneEllipsoid),
    (GeomType::Plane, GeomType::Cylinder, ShapeTest::PlaneCylinder),
    (GeomType::Plane, GeomType::Box, ShapeTest::PlaneBox),
    (GeomType::Plane, GeomType::Mesh, ShapeTest::PlaneMesh),
    (GeomType::Sphere, GeomType::Sphere, ShapeTest::SphereSphere),
    (GeomType::Sphere, GeomType::Capsule, ShapeTest::SphereCapsule),
    (GeomType::Sphere, GeomType::Box, ShapeTest::SphereBox),
    (GeomType::Sphere, GeomType::Cylinder, ShapeTest::SphereCylinder),
    (GeomType::Capsule, GeomType::Capsule, ShapeTest::CapsuleCapsule),
    (GeomType::Capsule, GeomType::Box, ShapeTest::CapsuleBox),
    (GeomType::Box, GeomType::Box, ShapeTest::BoxBox),
    convex(GeomType::Sphere, GeomType::Ellipsoid),
    convex(GeomType::Capsule, GeomType::Ellipsoid),
    convex(GeomType::Capsule, GeomType::Cylinder),
    convex(GeomType::Ellipsoid, GeomType::Ellipsoid),
    convex(GeomType::Ellipsoid, GeomType::Cylinder),
    convex(GeomType::Ellipsoid, GeomType::Box),
    convex(GeomType::Cylinder, GeomType::Cylinder),
    convex(GeomType::Cylinder, GeomType::Box),
    convex(GeomType::Sphere, GeomType::Mesh),
    convex(GeomType::Capsule, GeomType::Mesh),
    convex(GeomType::Ellipsoid, GeomType::Mesh),
    convex(GeomType::Cylinder, GeomType::Mesh),
    convex(GeomType::Box, GeomType::Mesh),
    convex(GeomType::Mesh, GeomType::Mesh),
    on_field(GeomType::Sphere),
    on_field(GeomType::Capsule),
    on_field(GeomType::Ellipsoid),
    on_field(GeomType::Cylinder),
    on_field(GeomType::Box),
    on_field(GeomType::Mesh),
];

const fn on_field(kind: GeomType) -> (GeomType, GeomType, ShapeTest) {
    (GeomType::HField, kind, ShapeTest::OnField(kind))
}

const fn convex(one: GeomType, two: GeomType) -> (GeomType, GeomType, ShapeTest) {
    (one, two, ShapeTest::Convex(one, two))
}

impl ShapeTest {
    /// Checks that it reads only the position of a capsule's axis.
    pub fn by_axes(self) -> bool {
        matches!(self, Self::PlaneCapsule | Self::SphereCapsule | Self::CapsuleCapsule)
    }

    /// Checks that it is made in one world after the other: see `by_lane.rs`.
    pub fn by_lane(self) -> bool {
        matches!(
            self,
            Self::PlaneMesh | Self::CapsuleBox | Self::BoxBox | Self::Convex(..) | Self::OnField(_)
        )
    }

    /// Returns the test of two shapes in the order of their types; None: not built yet.
    pub fn of(one: GeomType, two: GeomType) -> Option<Self> {
        TESTS.iter().find(|(a, b, _)| (*a, *b) == (one, two)).map(|(.., test)| *test)
    }

    /// Returns the pairs that are built, as a user reads them.
    pub fn built() -> String {
        let pairs = TESTS.iter().map(|(a, b, _)| format!("{}-{}", a.word(), b.word()));
        pairs.collect::<Vec<_>>().join(", ")
    }

    /// Returns the largest number of contacts of such a pair: its slots.
    pub fn most_touches(self) -> usize {
        match self {
            Self::PlaneSphere
            | Self::PlaneEllipsoid
            | Self::SphereSphere
            | Self::SphereCapsule
            | Self::SphereBox
            | Self::SphereCylinder => 1,
            Self::PlaneCapsule | Self::CapsuleCapsule | Self::CapsuleBox => 2,
            Self::PlaneMesh => plane_mesh::MOST,
            Self::Convex(one, two) => convex::most(one, two),
            Self::PlaneCylinder | Self::PlaneBox => 4,
            Self::BoxBox => boxes::MOST,
            Self::OnField(_) => height_field::MOST,
        }
    }

    /// Checks that its contacts are identified from step to step by feature, not by slot.
    pub fn by_feature(self) -> bool {
        self.most_touches() > 2 || self == Self::CapsuleBox
    }

    /// Checks that the normal turns while one shape moves past the other.
    pub fn curved(self) -> bool {
        !matches!(
            self,
            Self::PlaneSphere
                | Self::PlaneCapsule
                | Self::PlaneEllipsoid
                | Self::PlaneCylinder
                | Self::PlaneBox
                | Self::PlaneMesh
        )
    }
}
