//! Bounding spheres and bounding boxes show which pairs need no exact test.
//!
//! A box is turned as its geom is. For two boxes the normals of the faces are tried as axes of
//! separation (Gottschalk, Lin and Manocha 1996 try the products of edges too, for the few pairs that
//! these show to be apart).

use crate::model::{Geom, Model, Pair, Spheres};
use crate::place::Placed;
use crate::real::{value, Mask, Real, Value};
use crate::scene::GeomType;
use crate::shapes::ShapeTest;
use crate::spatial::{Pose, V3};

/// Margin by which boxes must be apart beyond the reach of a pair, in units of 1 and of rounding, so
/// that no rounding of the exact test finds a contact.
const SURE: f64 = 1e-6;
const UNITS: f64 = 64.0;

impl Spheres {
    /// The two are apart in every lane. inside: no joint is where `apart` does not hold.
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

/// Returns the lanes that may have a contact, none if the boxes are apart. In the other lanes the pair
/// is apart by `more` [m] where the law reads the guess, and else by more than the distance at which
/// contacts are listed. `poses`: by geom.
#[inline(always)]
pub(super) fn near<R: Real, P>(
    model: &Model<R::Value>,
    poses: &[Pose<R>],
    pair: &Pair<P>,
    more: Option<R>,
) -> R::Mask {
    let near = outside(model, poses, pair, more).not();
    if near.none() || boxed(pair.test) && boxes_far(model, poses, pair, more) {
        return R::Mask::of(false);
    }
    near
}

/// Checks that the boxes of a pair are apart in every lane.
#[inline(always)]
fn boxes_far<R: Real, P>(
    model: &Model<R::Value>,
    poses: &[Pose<R>],
    pair: &Pair<P>,
    more: Option<R>,
) -> bool {
    let (g1, g2) = (&model.geoms[pair.geom1], &model.geoms[pair.geom2]);
    let (p1, p2) = (&poses[pair.geom1], &poses[pair.geom2]);
    let more = more.unwrap_or_else(|| model.material(pair).listed());
    let between = p2.pos - p1.pos;
    if g1.kind == GeomType::Plane {
        return over_plane(&p1.axis(2), above(&between, p1), g2, p2, more);
    }
    boxes_apart([g1, g2], [p1, p2], &between, more)
}

/// Returns the height of a point over a plane.
#[inline(always)]
fn above<R: Real>(between: &V3<R>, plane: &Pose<R>) -> R {
    between.x * plane.rot.m13 + between.y * plane.rot.m23 + between.z * plane.rot.m33
}

/// Returns the lanes in which the pair's spheres are apart by this much.
#[inline(always)]
fn outside<R: Real, P>(
    model: &Model<R::Value>,
    poses: &[Pose<R>],
    pair: &Pair<P>,
    more: Option<R>,
) -> R::Mask {
    let (g1, g2) = (&model.geoms[pair.geom1], &model.geoms[pair.geom2]);
    let (p1, p2) = (&poses[pair.geom1], &poses[pair.geom2]);
    let material = model.material(pair);
    let between = p2.pos - p1.pos;
    if g1.kind == GeomType::Plane {
        let more = more.unwrap_or_else(|| material.listed());
        return above(&between, p1).gt(g2.reach.get() + more);
    }
    let square = match more {
        None => {
            let of = [&g1.reach, &g2.reach, &material.margin, &material.gap];
            Value::calc(of, |[a, b, margin, gap]| {
                let reach = a + b + (margin + gap);
                reach * reach
            })
        }
        Some(more) => {
            let reach: R = Value::calc([&g1.reach, &g2.reach], |[a, b]| a + b);
            let reach = reach + more;
            reach * reach
        }
    };
    between.dot(&between).gt(square)
}

/// The exact test costs much more than a test of boxes, so the boxes are tried first. (The test of two
/// boxes starts with their axes itself.)
#[inline(always)]
fn boxed(test: ShapeTest) -> bool {
    use ShapeTest::{CapsuleBox, Convex, OnField, PlaneMesh};
    matches!(test, Convex(..) | CapsuleBox | PlaneMesh | OnField(_))
}

/// Margin that is added to a distance for rounding [m].
fn slack<R: Real, const N: usize>(reaches: [&R::Value; N]) -> R {
    Value::calc(reaches, |reaches| (SURE + UNITS * R::epsilon()) * reaches.iter().sum::<f64>())
}

/// Checks that a geom's box is above a plane by `more` [m] in every lane. `height`: of its centre.
fn over_plane<R: Real>(
    up: &V3<R>,
    height: R,
    geom: &Geom<R::Value>,
    pose: &Pose<R>,
    more: R,
) -> bool {
    let mut reach = more + slack([&geom.reach]);
    for k in 0..3 {
        reach += up.dot(&pose.axis(k)).abs() * geom.half[k].get();
    }
    height.gt(reach).all()
}

/// Checks that two geoms' boxes are apart by `more` [m] in every lane, along the normal of some face.
fn boxes_apart<R: Real>(
    geoms: [&Geom<R::Value>; 2],
    poses: [&Pose<R>; 2],
    between: &V3<R>,
    more: R,
) -> bool {
    let [one, two] = geoms.map(|geom| value::get(&geom.half));
    let more = more + slack([&geoms[0].reach, &geoms[1].reach]);
    let mut apart = R::Mask::of(false);
    // The reach of the first box along the axes of the second.
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
