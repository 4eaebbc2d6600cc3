//! Which pairs need no exact test: their bounding spheres are apart, or their bounding boxes.
//!
//! A box is as its geom is turned. Of two boxes the normals of the faces are tried as axes of
//! separation (Gottschalk, Lin and Manocha 1996 try the products of edges too, for the few pairs
//! that these show to be apart).

use crate::model::{Geom, Model, Pair, Spheres};
use crate::place::Placed;
use crate::real::{Mask, Real};
use crate::scene::GeomType;
use crate::shapes::ShapeTest;
use crate::spatial::{Pose, V3};

/// Over the reach of a pair: by how much more boxes are apart, in units of 1 and of rounding, so
/// that no rounding of the exact test finds a contact.
const SURE: f64 = 1e-6;
const UNITS: f64 = 64.0;

impl Spheres {
    /// In every lane the two are apart. inside: no joint is where `apart` does not hold.
    #[inline(always)]
    pub fn far<R: Real>(&self, placed: &Placed<R>, inside: bool) -> bool {
        if self.apart && inside {
            return true;
        }
        if self.square == f64::INFINITY {
            return false;
        }
        let [one, two] = self.geoms.map(|geom| &placed.geom[geom as usize].pos);
        let between = two - one;
        between.dot(&between).gt(R::of(self.square)).all()
    }
}

/// No lane can have a contact: the pair is apart by `more` [m] where the law looks at the guess, and
/// else by more than the distance at which contacts are listed.
#[inline(always)]
pub(super) fn far<R: Real>(
    model: &Model,
    placed: &Placed<R>,
    pair: &Pair,
    more: Option<R>,
) -> bool {
    let (g1, g2) = (&model.geoms[pair.geom1], &model.geoms[pair.geom2]);
    let (p1, p2) = (&placed.geom[pair.geom1], &placed.geom[pair.geom2]);
    let listed = || model.material(pair).listed();
    let between = p2.pos - p1.pos;
    if g1.kind == GeomType::Plane {
        let height = between.x * p1.rot.m13 + between.y * p1.rot.m23 + between.z * p1.rot.m33;
        let more = more.unwrap_or_else(|| R::of(listed()));
        let above = height.gt(R::of(g2.reach) + more).all();
        return above || boxed(pair.test) && over_plane(&p1.axis(2), height, g2, p2, more);
    }
    let reach = g1.reach + g2.reach;
    let square = match more {
        None => R::of((reach + listed()) * (reach + listed())),
        Some(more) => {
            let reach = R::of(reach) + more;
            reach * reach
        }
    };
    if between.dot(&between).gt(square).all() {
        return true;
    }
    let more = || more.unwrap_or_else(|| R::of(listed()));
    boxed(pair.test) && boxes_apart([g1, g2], [p1, p2], &between, more())
}

/// The exact test costs so much more than one of boxes that these are tried first. (That of two
/// boxes begins with their axes itself.)
#[inline(always)]
fn boxed(test: ShapeTest) -> bool {
    use ShapeTest::{CapsuleBox, Convex, OnField, PlaneMesh};
    matches!(test, Convex(..) | CapsuleBox | PlaneMesh | OnField(_))
}

/// What is added to a distance for rounding [m].
fn slack<R: Real>(reach: f64) -> R {
    R::of((SURE + UNITS * R::epsilon()) * reach)
}

/// A geom's box is above a plane by `more` [m] in every lane: `height` is its centre's.
fn over_plane<R: Real>(up: &V3<R>, height: R, geom: &Geom, pose: &Pose<R>, more: R) -> bool {
    let mut reach = more + slack(geom.reach);
    for k in 0..3 {
        reach += up.dot(&pose.axis(k)).abs() * R::of(geom.half[k]);
    }
    height.gt(reach).all()
}

/// The boxes of two geoms are apart by `more` [m] in every lane, along the normal of some face.
fn boxes_apart<R: Real>(geoms: [&Geom; 2], poses: [&Pose<R>; 2], between: &V3<R>, more: R) -> bool {
    let [one, two] = geoms.map(|geom| geom.half.map(R::of));
    let more = more + slack(geoms[0].reach + geoms[1].reach);
    let mut apart = R::Mask::of(false);
    // How far the first box reaches along the axes of the second.
    let mut along = [more; 3];
    for i in 0..3 {
        let axis = poses[0].axis(i);
        let mut reach = more + one[i];
        for k in 0..3 {
            let cosine = axis.dot(&poses[1].axis(k)).abs();
            reach += cosine * two[k];
            along[k] += cosine * one[i];
        }
        apart = apart.or(axis.dot(between).abs().gt(reach));
    }
    if apart.all() {
        return true;
    }
    for k in 0..3 {
        apart = apart.or(poses[1].axis(k).dot(between).abs().gt(along[k] + two[k]));
    }
    apart.all()
}
