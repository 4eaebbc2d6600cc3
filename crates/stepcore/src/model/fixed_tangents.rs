//! Contact tangents along which nothing can ever move.
//!
//! Under MuJoCo's pyramid the two edges along such a tangent are copies of the normal row, and
//! `solve` folds them into one. Tangents are claimed only if still in every configuration, to
//! rounding.
//!
//! - Slides only: the body never turns, and a tangent across every slide is still.
//! - A planar chain, every hinge along one n and every slide across it: points move across n, so a
//!   tangent along n is still.
//!
//! The contact's frame must be known for that. Against a plane its normal is constant. Two spheres
//! that slide along their common line have it as normal. A sphere and a sphere or a capsule whose
//! axis is in the plane of motion have their normal in it, unless a centre stays at the other's
//! centre or axis: then it may be across the plane. It is also across it where the axes of two
//! capsules cross, which they can anywhere: they keep both tangents.

use super::{Geom, Model};
use crate::scene::{GeomType, JointType};
use crate::shapes::frame::{hint, spare, tangents, usual};
use crate::shapes::ShapeTest;
use crate::spatial::{rotation, Pose};
use nalgebra::Vector3;

/// Sine of an angle that is rounding.
const ROUNDING: f64 = 1e-12;
/// A capsule this close to the normal leaves the direction of its tangent open.
const OPEN: f64 = 1e-6;

/// The still tangents of a pair of geoms; `[false, false]` if nothing is proved.
pub fn still(
    model: &Model,
    poses: &[Pose<f64>],
    test: ShapeTest,
    first: usize,
    second: usize,
) -> [bool; 2] {
    let (plane, other) = (&model.geoms[first], &model.geoms[second]);
    if model.bodies[plane.body].carried || model.bodies[other.body].carried {
        return [false; 2];
    }
    // A moving surface needs friction, whether bodies move or not.
    if plane.belt.is_some() || other.belt.is_some() {
        return [false; 2];
    }
    if plane.kind != GeomType::Plane {
        return between_round_shapes(model, poses, plane, other);
    }
    let frame = |geom: &Geom| poses[geom.body].then(&Pose::new(geom.pos, geom.quat));
    let normal = frame(plane).axis(2);
    let Some(motion) = motion(model, poses, other.body) else {
        return [false; 2];
    };
    match hint(test, &frame(other)) {
        Some(axis) => along_hint(&motion, &normal, &axis),
        None => {
            let (first, second) = tangents(&normal, None);
            [motion.lacks(&first), motion.lacks(&second)]
        }
    }
}

/// Whether no tangent of the body's contacts is ever still: it turns freely.
pub fn loose(model: &Model, body: usize) -> bool {
    let free = |dof: &usize| {
        let kind = model.joints[model.dofs[*dof].joint].kind;
        matches!(kind, JointType::Ball | JointType::Free)
    };
    model.bodies[body].chain.of(&model.dof_lists).iter().any(free)
}

/// How the points of one body can move, whatever the configuration.
enum Motion {
    /// Along these unit axes, without turning.
    Slides(Vec<Vector3<f64>>),
    /// Across this unit axis, turning about it.
    Planar(Vector3<f64>),
}

impl Motion {
    fn lacks(&self, tangent: &Vector3<f64>) -> bool {
        match self {
            Self::Slides(axes) => axes.iter().all(|a| a.dot(tangent).abs() <= ROUNDING),
            Self::Planar(n) => n.cross(tangent).norm() <= ROUNDING,
        }
    }
}

fn motion(model: &Model, poses: &[Pose<f64>], body: usize) -> Option<Motion> {
    let (mut slides, mut hinges) = (vec![], vec![]);
    let mut last = None;
    for &dof in model.bodies[body].chain.of(&model.dof_lists) {
        let index = model.dofs[dof].joint;
        if last.replace(index) == Some(index) {
            continue;
        }
        let joint = &model.joints[index];
        let axis = poses[joint.body].rot * joint.axis;
        match joint.kind {
            JointType::Slide => slides.push(axis),
            JointType::Hinge => hinges.push(axis),
            JointType::Ball | JointType::Free => return None,
        }
    }
    let Some(n) = hinges.first().copied() else {
        return Some(Motion::Slides(slides));
    };
    let planar = hinges.iter().all(|a| a.cross(&n).norm() <= ROUNDING)
        && slides.iter().all(|a| a.dot(&n).abs() <= ROUNDING);
    planar.then_some(Motion::Planar(n))
}

/// The first tangent is a hint, the axis of a capsule, laid into the plane.
fn along_hint(motion: &Motion, normal: &Vector3<f64>, axis: &Vector3<f64>) -> [bool; 2] {
    let laid = axis - normal * normal.dot(axis);
    match motion {
        Motion::Slides(axes) if laid.norm() < OPEN => {
            [axes.iter().all(|a| a.cross(normal).norm() <= ROUNDING); 2]
        }
        Motion::Slides(_) => {
            let (first, second) = tangents(normal, Some(axis));
            [motion.lacks(&first), motion.lacks(&second)]
        }
        // The axis turns within the plane of motion. The second tangent is along n, also where the
        // capsule is upright and the spare replaces it, unless the spare has a part along n.
        Motion::Planar(n) => {
            let across = |v: &Vector3<f64>| v.dot(n).abs() <= ROUNDING;
            [false, across(normal) && across(axis) && across(&spare())]
        }
    }
}

/// A sphere and a sphere or a capsule.
fn between_round_shapes(
    model: &Model,
    poses: &[Pose<f64>],
    first: &Geom,
    second: &Geom,
) -> [bool; 2] {
    let (sphere, other) =
        if second.kind == GeomType::Sphere { (second, first) } else { (first, second) };
    if sphere.kind != GeomType::Sphere
        || !matches!(other.kind, GeomType::Sphere | GeomType::Capsule)
    {
        return [false; 2];
    }
    let (Some(one), Some(two)) =
        (motion(model, poses, first.body), motion(model, poses, second.body))
    else {
        return [false; 2];
    };
    let apart = poses[second.body].point(second.pos) - poses[first.body].point(first.pos);
    let tiny = ROUNDING * (first.reach + second.reach);
    let capsule = (other.kind == GeomType::Capsule).then(|| -> Vector3<f64> {
        (poses[other.body].rot * rotation(other.quat)).column(2).into()
    });
    if let (Motion::Slides(a), Motion::Slides(b), None) = (&one, &two, capsule) {
        let axes = || a.iter().chain(b);
        let line = |along: &Vector3<f64>| {
            along.cross(&apart).norm() <= tiny && axes().all(|a| a.cross(along).norm() <= ROUNDING)
        };
        return [axes().next().is_some_and(line); 2];
    }
    // If they coincide in the first configuration, they may in every one.
    let beside = capsule.map_or(apart, |axis| apart - axis * axis.dot(&apart));
    if beside.norm() <= tiny {
        return [false; 2];
    }
    let across = |n: &Vector3<f64>| {
        let lies = capsule.is_none_or(|axis| axis.dot(n).abs() <= ROUNDING);
        let moves = |motion: &Motion| match motion {
            Motion::Slides(axes) => axes.iter().all(|axis| axis.dot(n).abs() <= ROUNDING),
            Motion::Planar(m) => m.cross(n).norm() <= ROUNDING,
        };
        apart.dot(n).abs() <= tiny && lies && moves(&one) && moves(&two)
    };
    // If the normal is across the usual tangent, that is the first one.
    [across(&usual()), across(&spare())]
}
