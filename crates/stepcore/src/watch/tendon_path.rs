//! The path of a spatial tendon in the world, for drawing.

use super::Bodies;
use crate::model::{Course, Model, Point, Round, Tendon};
use crate::place::{wrap, Obstacle};
use crate::spatial::{Pose, Quat, V3};

/// Straight pieces of an arc.
const PIECES: usize = 8;

/// A part of the path from a site to the next: two points; where it may touch a geom `PIECES + 3`,
/// which are on one line while it does not.
pub type Way = Vec<V3<f64>>;

/// The stretches of a tendon in their order; none for a fixed one.
pub fn tendon_path(model: &Model, bodies: &Bodies, tendon: &Tendon) -> Vec<Way> {
    let Course::Spatial(stretches) = &tendon.course else { return vec![] };
    let way = |stretch: &crate::model::Stretch| {
        let ends = [0, 1].map(|k| place(bodies, &stretch.ends[k]));
        match &stretch.round {
            None => ends.to_vec(),
            Some(round) => around(model, bodies, ends, round),
        }
    };
    stretches.iter().map(way).collect()
}

fn place(bodies: &Bodies, point: &Point) -> V3<f64> {
    bodies.xpos[point.body] + bodies.xmat[point.body] * point.pos
}

fn around(model: &Model, bodies: &Bodies, ends: [V3<f64>; 2], round: &Round) -> Way {
    let geom = &model.geoms[round.geom];
    let pos = bodies.xpos[geom.body] + bodies.xmat[geom.body] * geom.pos;
    let rot = bodies.xquat[geom.body].mul(&Quat::splat(&geom.quat)).matrix();
    let pose = Pose { pos, rot };
    let side = round.side.as_ref().map(|side| place(bodies, side));
    let (sphere, radius) = (round.sphere, round.radius);
    let touch = wrap(ends, &Obstacle { pose: &pose, sphere, radius, side });
    let parts = (0..=PIECES).map(|k| k as f64 / PIECES as f64);
    let middle: Way = if touch.touches {
        let centre = pose.pos;
        let [one, two] = touch.points.map(|point| point - centre);
        let axis = if sphere { one.cross(&two) } else { rot.column(2).into() };
        parts.map(|part| centre + on_arc([one, two], axis, touch.length, part)).collect()
    } else {
        parts.map(|part| ends[0] + (ends[1] - ends[0]) * part).collect()
    };
    [vec![ends[0]], middle, vec![ends[1]]].concat()
}

/// A point of the screw line about an axis through the origin from one point to another, of this
/// length, at a part of the way.
fn on_arc([one, two]: [V3<f64>; 2], axis: V3<f64>, length: f64, part: f64) -> V3<f64> {
    let Some(axis) = axis.try_normalize(0.0) else { return one + (two - one) * part };
    let rise = (two - one).dot(&axis);
    let start = one - axis * one.dot(&axis);
    let radius = start.norm();
    if radius == 0.0 {
        return one + (two - one) * part;
    }
    let angle = (length * length - rise * rise).max(0.0).sqrt() / radius;
    let turned = |angle: f64| start * angle.cos() + axis.cross(&start) * angle.sin();
    // The end point decides which way round it goes.
    let miss = |sign: f64| (one + turned(sign * angle) - start + axis * rise - two).norm();
    let sign = if miss(1.0) <= miss(-1.0) { 1.0 } else { -1.0 };
    one - start + turned(sign * angle * part) + axis * (rise * part)
}
