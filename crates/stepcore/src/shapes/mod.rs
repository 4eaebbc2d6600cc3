//! Shapes: the contacts of two of them, from their poses and sizes.
//!
//! One file for each family of pairs. A pair's test is a pure function of two shapes. The test of a
//! pair of geoms is chosen when the model is compiled (`ShapeTest`), and `meet` runs it.

pub(crate) mod boxes;
pub(crate) mod by_lane;
pub(crate) mod capsule;
mod capsule_box;
#[cfg(test)]
mod capsule_box_tests;
mod contact_feature;
mod convex;
#[cfg(test)]
mod convex_tests;
pub(crate) mod cylinder;
mod directions;
mod epa;
mod face;
mod facets;
mod field_list;
pub mod frame;
mod gjk;
mod grid;
pub mod height_field;
mod hint;
pub mod hull;
#[cfg(test)]
mod hull_tests;
mod manifold;
mod overlap;
mod peak;
#[cfg(test)]
mod peak_tests;
pub(crate) mod plane;
mod plane_mesh;
mod quickhull;
pub mod ray;
mod refine;
mod separation;
mod shape_test;
mod side;
mod solid;
pub(crate) mod sphere;
mod spread;
#[cfg(test)]
mod tests;
pub(crate) mod touch;
#[cfg(test)]
mod trial;

pub use hint::Hint;
pub(crate) use separation::searched;
pub use shape_test::ShapeTest;
pub use touch::{Touch, Touches};

use self::hull::Hull;
use by_lane::by_lane;
use convex::Convex;
use height_field::{HeightField, OnField};

use crate::real::{value, Real};
use crate::spatial::{Pose, V3};
use core::cell::Cell;

/// One of the two shapes of a pair.
#[derive(Clone, Copy)]
pub struct Shape<'a, R: Real> {
    pub pose: &'a Pose<R>,
    /// As for a geom: see `scene::Geom::size`.
    pub size: &'a [R::Value; 3],
    /// Present for a mesh, and for a height field.
    pub hull: Option<&'a Hull>,
    pub field: Option<&'a HeightField>,
}

impl<'a, R: Real> Shape<'a, R> {
    /// Returns the same shape at another pose, in another number type.
    #[inline(always)]
    pub fn at<S: Real>(&self, pose: &'a Pose<S>, size: &'a [S::Value; 3]) -> Shape<'a, S> {
        Shape { pose, size, hull: self.hull, field: self.field }
    }

    /// Returns the size in this number type.
    #[inline(always)]
    pub fn sizes(&self) -> V3<R> {
        V3::from(value::get(self.size))
    }
}

/// By lane; or empty.
pub type Hints<'a> = &'a [Cell<Hint>];

/// Tests a pair exactly: `take(slot, touch)` gets the touch of each of its slots. If the shapes are
/// `within` [m] apart or more, by lane, a slot may be empty.
#[inline(always)]
pub fn meet<R: Real>(
    test: ShapeTest,
    one: &Shape<R>,
    two: &Shape<R>,
    (within, hints): (impl Fn(usize) -> f64, Hints),
    mut take: impl FnMut(usize, &Touch<R>),
) {
    let (p1, p2) = (one.pose, two.pose);
    let (s1, s2) = (one.sizes(), two.sizes());
    let mut all = |touches: &[Touch<R>]| {
        touches.iter().enumerate().for_each(|(slot, touch)| take(slot, touch));
    };
    match test {
        ShapeTest::PlaneSphere => all(&plane::plane_sphere(p1, p2, s2.x)),
        ShapeTest::PlaneCapsule => all(&plane::plane_capsule(p1, p2, s2.x, s2.y)),
        ShapeTest::PlaneEllipsoid => all(&plane::plane_ellipsoid(p1, p2, s2)),
        ShapeTest::PlaneCylinder => all(&plane::plane_cylinder(p1, p2, s2.x, s2.y)),
        ShapeTest::PlaneBox => all(&plane::plane_box(p1, p2, s2)),
        ShapeTest::PlaneMesh => {
            let test = |lane| plane_mesh::PlaneMesh { within: within(lane) };
            all(&by_lane::<R, _, { plane_mesh::MOST }>(test, one, two));
        }
        ShapeTest::SphereSphere => all(&sphere::sphere_sphere(p1, s1.x, p2, s2.x)),
        ShapeTest::SphereCapsule => all(&sphere::sphere_capsule(p1, s1.x, p2, s2.x, s2.y)),
        ShapeTest::SphereBox => all(&sphere::sphere_box(p1, s1.x, p2, s2)),
        ShapeTest::OnField(kind) => {
            let test = |lane| OnField { kind, within: within(lane) };
            all(&by_lane::<R, _, { height_field::MOST }>(test, one, two));
        }
        ShapeTest::SphereCylinder => {
            all(&cylinder::sphere_cylinder(p1, s1.x, p2, s2.x, s2.y));
        }
        ShapeTest::CapsuleBox => all(&by_lane(|_| capsule_box::CapsuleBox, one, two)),
        ShapeTest::BoxBox => all(&by_lane(|lane| boxes::Boxes { within: within(lane) }, one, two)),
        ShapeTest::Convex(a, b) => {
            let test =
                |lane| Convex { one: a, two: b, within: within(lane), hint: hints.get(lane) };
            match convex::most(a, b) {
                1 => all(&by_lane::<R, _, 1>(test, one, two)),
                2 => all(&by_lane::<R, _, 2>(test, one, two)),
                _ => all(&by_lane::<R, _, { convex::PATCH }>(test, one, two)),
            }
        }
        ShapeTest::CapsuleCapsule => {
            all(&capsule::capsule_capsule(p1, s1.x, s1.y, p2, s2.x, s2.y));
        }
    }
}
