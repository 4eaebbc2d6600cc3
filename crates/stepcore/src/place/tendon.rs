//! Lengths of tendons and their arms, ∂length/∂dof.
//!
//! To first order, the shortest path does not change its length when the points at which it touches a
//! geom move along it: its gradient is the gradient of its straight parts between points fixed to their
//! bodies.

use super::wrap::{wrap, Obstacle};
use super::Placed;
use crate::model::{Course, Model, Movers, Point, Round, Stretch, Tendon};
use crate::real::{Mask, Real};
use crate::spatial::{rotate, splat, Force, Pose, Quat, V3};

/// An arm that is smaller than this many roundings of its terms counts as zero.
const ROUNDING: f64 = 16.0;

/// Points of bodies at which a stretch pulls: both ends, and the points where it reaches and leaves its
/// geom. Directions are of unit length, from the other end of a straight part to this one.
struct Pull<R: Real> {
    ends: [(V3<R>, V3<R>); 2],
    geom: [(V3<R>, V3<R>); 2],
    length: R,
    /// The lanes in which it lies on its geom.
    wraps: R::Mask,
}

/// The part of a pull at the points that a joint moves: their wrench about the origin of its motion,
/// and a bound on its rounding.
struct Felt<R: Real> {
    wrench: Force<R>,
    reach: R,
    points: R,
}

impl<R: Real> Pull<R> {
    /// Returns the part of the pull at the first end, the geom and the second end, for each that moves.
    #[inline(never)]
    fn felt(&self, origin: &V3<R>, [first, middle, second]: [bool; 3]) -> Felt<R> {
        let wrench = Force { ang: V3::zeros(), lin: V3::zeros() };
        let mut felt = Felt { wrench, reach: R::zero(), points: R::zero() };
        let [one, two] = &self.ends;
        let [on, off] = &self.geom;
        for (moves, (at, along)) in [(first, one), (middle, on), (middle, off), (second, two)] {
            if moves {
                felt.wrench.ang += (at - origin).cross(along);
                felt.wrench.lin += *along;
                felt.reach += span(at) + span(origin);
                felt.points += R::one();
            }
        }
        felt
    }
}

impl<R: Real> Placed<R> {
    /// Computes length and arms of the tendons that are needed; bodies must have been placed.
    pub(super) fn place_tendons(
        &mut self,
        model: &Model<R::Value>,
        qpos: &[R],
        needed: impl Fn(&Tendon<R::Value>) -> bool,
    ) {
        for (index, tendon) in model.tendons.iter().enumerate().filter(|(_, t)| needed(t)) {
            match &tendon.course {
                Course::Fixed(parts) => {
                    let mut length = R::zero();
                    for (joint, coef) in parts {
                        length += R::of(*coef) * qpos[model.joints[*joint].qpos];
                    }
                    self.tendon_length[index] = length;
                }
                Course::Spatial(stretches) => {
                    self.tendon_arms[tendon.arms.range()].fill(R::zero());
                    let mut length = R::zero();
                    for stretch in stretches {
                        length += self.place_stretch(model, tendon, stretch);
                    }
                    self.tendon_length[index] = length;
                }
            }
        }
    }

    /// Computes the arms of fixed tendons, which no position changes.
    pub(super) fn constant_arms(&mut self, model: &Model<R::Value>) {
        for tendon in &model.tendons {
            let Course::Fixed(parts) = &tendon.course else { continue };
            for (joint, coef) in parts {
                let dof = model.joints[*joint].dof;
                let dofs = tendon.dofs.of(&model.dof_lists);
                let at = dofs.iter().position(|k| *k == dof);
                self.tendon_arms[tendon.arms.start + at.unwrap_or(0)] += R::of(*coef);
            }
        }
    }

    pub(super) fn point(&self, point: &Point) -> V3<R> {
        self.xpos[point.body] + rotate(&self.xmat[point.body], &splat(&point.pos))
    }

    /// Adds the arms of a stretch; returns its share of the length.
    fn place_stretch(
        &mut self,
        model: &Model<R::Value>,
        tendon: &Tendon<R::Value>,
        stretch: &Stretch,
    ) -> R {
        let pull = self.pull_of(model, stretch);
        let share = R::of(stretch.share);
        for Movers { tree, moves, dofs } in &stretch.movers {
            // A motion of both ends of a straight line leaves its length unchanged.
            let [first, _, second] = *moves;
            let bends = first && second;
            if bends && pull.wraps.none() {
                continue;
            }
            let Felt { wrench, reach, points } = pull.felt(&self.origin[*tree], *moves);
            for (dof, at) in dofs {
                let motion = &self.motion[*dof];
                let mut arm = motion.dot(&wrench);
                if bends {
                    arm = R::select(pull.wraps, arm, R::zero());
                }
                // The arm of a sphere that turns about its centre is rounding too: a row of roundings
                // alone could have any force.
                let size = span(&motion.ang) * reach + span(&motion.lin) * points;
                let rounding = arm.abs().le(R::of(ROUNDING * R::epsilon()) * size);
                arm = R::select(rounding, R::zero(), arm);
                self.tendon_arms[tendon.arms.start + at] += share * arm;
            }
        }
        share * pull.length
    }

    fn pull_of(&self, model: &Model<R::Value>, stretch: &Stretch) -> Pull<R> {
        let ends = [self.point(&stretch.ends[0]), self.point(&stretch.ends[1])];
        match &stretch.round {
            None => straight(ends),
            Some(round) => self.around(model, ends, round),
        }
    }

    /// Calls `each(body, point, direction)` for every point of a body at which a spatial tendon
    /// pulls: a force that lengthens it by 1 N pushes the body there by this direction [N].
    pub(crate) fn tendon_pulls(
        &self,
        model: &Model<R::Value>,
        index: usize,
        mut each: impl FnMut(usize, V3<R>, V3<R>),
    ) {
        let Course::Spatial(stretches) = &model.tendons[index].course else { return };
        for stretch in stretches {
            let (pull, share) = (self.pull_of(model, stretch), R::of(stretch.share));
            for (end, (at, along)) in stretch.ends.iter().zip(&pull.ends) {
                each(end.body, *at, *along * share);
            }
            if let Some(round) = &stretch.round {
                let body = model.geoms[round.geom].body;
                pull.geom.iter().for_each(|(at, along)| each(body, *at, *along * share));
            }
        }
    }

    fn around(&self, model: &Model<R::Value>, ends: [V3<R>; 2], round: &Round) -> Pull<R> {
        let pose = self.pose_of(model, round.geom);
        let side = round.side.as_ref().map(|side| self.point(side));
        let obstacle =
            Obstacle { pose: &pose, sphere: round.sphere, radius: R::of(round.radius), side };
        let wrapped = wrap(ends, &obstacle);
        let on = wrapped.touches;
        if on.none() {
            return straight(ends);
        }
        let [one, two] = wrapped.points;
        let (before, after) = (straight([ends[0], one]), straight([two, ends[1]]));
        let free = straight(ends);
        let pick = |yes: &V3<R>, no: &V3<R>| V3::from_fn(|k, _| R::select(on, yes[k], no[k]));
        let zero = V3::zeros();
        let whole = before.length + wrapped.length + after.length;
        Pull {
            ends: [
                (ends[0], pick(&before.ends[0].1, &free.ends[0].1)),
                (ends[1], pick(&after.ends[1].1, &free.ends[1].1)),
            ],
            geom: [
                (pick(&one, &zero), pick(&before.ends[1].1, &zero)),
                (pick(&two, &zero), pick(&after.ends[0].1, &zero)),
            ],
            length: R::select(on, whole, free.length),
            wraps: on,
        }
    }

    /// Returns the pose of a geom, whether or not it collides.
    fn pose_of(&self, model: &Model<R::Value>, index: usize) -> Pose<R> {
        let geom = &model.geoms[index];
        let pos = self.xpos[geom.body] + rotate(&self.xmat[geom.body], &splat(&geom.pos));
        Pose { pos, rot: self.xquat[geom.body].mul(&Quat::splat(&geom.quat)).matrix() }
    }
}

/// Returns the sum of the absolute values of the entries.
fn span<R: Real>(v: &V3<R>) -> R {
    v.x.abs() + v.y.abs() + v.z.abs()
}

/// Returns the pull of the straight line between two points; a line of zero length pulls nowhere.
fn straight<R: Real>([a, b]: [V3<R>; 2]) -> Pull<R> {
    let apart = b - a;
    let length = apart.dot(&apart).sqrt();
    let along = apart * length.recip_or_zero();
    let none = (V3::zeros(), V3::zeros());
    let wraps = R::Mask::of(false);
    Pull { ends: [(a, -along), (b, along)], geom: [none, none], length, wraps }
}
