//! Poses and velocities of the bodies of one world, as MuJoCo has them: about the centre of mass of
//! the tree that each hangs on (`subtree_com`, `cinert`, `cvel`).

use crate::model::{Model, NONE};
use crate::real::Real;
use crate::sim::Sim;
use crate::spatial::{Inertia, Motion, Pose, Quat, M3, V3};
use nalgebra::Vector3;

/// Below this mass [kg] MuJoCo uses a body's centre as the centre of its subtree (`mjMINVAL`).
const NO_MASS: f64 = 1e-15;

/// The bodies of one world, in doubles. Lists are by body.
pub struct Bodies {
    pub xpos: Vec<V3<f64>>,
    pub xquat: Vec<Quat<f64>>,
    pub xmat: Vec<M3<f64>>,
    /// Centre of mass [m].
    pub centre: Vec<V3<f64>>,
    /// Mass [kg] and centre of mass [m] of the body and all that hangs on it.
    pub subtree_mass: Vec<f64>,
    pub subtree_com: Vec<V3<f64>>,
    /// The body between it and the world, or its index if it is on the world.
    pub root: Vec<usize>,
    /// About the centre of mass of the root's subtree, and zero for the world.
    pub cinert: Vec<Inertia<f64>>,
    /// Velocity of the point of the body at that centre.
    pub cvel: Vec<Motion<f64>>,
}

/// One lane of a vector.
pub(super) fn lane_of<R: Real>(v: &V3<R>, lane: usize) -> V3<f64> {
    v.map(|x| x.lane(lane))
}

/// A motion about another point than its origin, `r` away.
pub(super) fn seen_from(motion: &Motion<f64>, r: &V3<f64>) -> Motion<f64> {
    Motion { ang: motion.ang, lin: motion.at(r) }
}

impl<R: Real> Sim<R> {
    /// The bodies at the present state, in one lane.
    pub fn bodies(&mut self, lane: usize) -> Bodies {
        let (model, plain) = (self.model.clone(), self.model_of(lane).clone());
        self.placed.carry(&self.inputs);
        self.placed.positions(&model, &self.state.qpos);
        self.placed.all_bodies(&model, &self.state.qvel);
        let placed = &self.placed;
        let quat = |q: &Quat<R>| Quat { w: q.w.lane(lane), v: lane_of(&q.v, lane) };
        let mut bodies = Bodies {
            xpos: placed.xpos.iter().map(|x| lane_of(x, lane)).collect(),
            xquat: placed.xquat.iter().map(quat).collect(),
            xmat: placed.xmat.iter().map(|m| m.map(|x| x.lane(lane))).collect(),
            centre: vec![],
            subtree_mass: vec![],
            subtree_com: vec![],
            root: roots(&plain),
            cinert: vec![],
            cvel: vec![],
        };
        bodies.weigh(&plain);
        bodies.cvel = (0..model.bodies.len())
            .map(|index| {
                let tree = model.bodies[index].tree;
                if tree == NONE {
                    return Motion::zero();
                }
                let velocity = &placed.velocity[index];
                let about_origin =
                    Motion { ang: lane_of(&velocity.ang, lane), lin: lane_of(&velocity.lin, lane) };
                let origin = lane_of(&placed.origin[tree], lane);
                seen_from(&about_origin, &(bodies.about(index) - origin))
            })
            .collect();
        bodies
    }
}

/// For each body: see `Bodies::root`.
fn roots(model: &Model) -> Vec<usize> {
    let mut roots: Vec<usize> = vec![0];
    for (index, body) in model.bodies.iter().enumerate().skip(1) {
        roots.push(if body.parent == 0 { index } else { roots[body.parent] });
    }
    roots
}

impl Bodies {
    fn weigh(&mut self, model: &Model) {
        let bodies = &model.bodies;
        let centres = bodies.iter().zip(&self.xpos).zip(&self.xmat);
        self.centre = centres.map(|((body, pos), mat)| pos + mat * body.ipos).collect();
        self.subtree_mass = bodies.iter().map(|body| body.mass).collect();
        let own = bodies.iter().zip(&self.centre);
        self.subtree_com = own.map(|(body, centre)| centre * body.mass).collect();
        for index in (1..bodies.len()).rev() {
            let (mass, moment) = (self.subtree_mass[index], self.subtree_com[index]);
            self.subtree_mass[bodies[index].parent] += mass;
            self.subtree_com[bodies[index].parent] += moment;
        }
        for index in 0..bodies.len() {
            let mass = self.subtree_mass[index];
            self.subtree_com[index] =
                if mass < NO_MASS { self.centre[index] } else { self.subtree_com[index] / mass };
        }
        self.cinert = vec![Inertia::zero()];
        for (index, body) in bodies.iter().enumerate().skip(1) {
            let turn = self.xmat[index];
            let inertia = turn * body.inertia * turn.transpose();
            let offset = self.centre[index] - self.about(index);
            self.cinert.push(Inertia::about_origin(body.mass, &offset, &inertia));
        }
    }

    /// The point about which a body's spatial quantities are expressed.
    pub fn about(&self, body: usize) -> V3<f64> {
        self.subtree_com[self.root[body]]
    }

    /// The pose of something fixed to a body.
    pub fn pose(&self, body: usize, pos: &Vector3<f64>, quat: &[f64; 4]) -> Pose<f64> {
        let rot = self.xquat[body].mul(&Quat::splat(quat)).matrix();
        Pose { pos: self.xpos[body] + self.xmat[body] * pos, rot }
    }

    /// Velocity of the point of a body at `point`.
    pub fn velocity_at(&self, body: usize, point: &V3<f64>) -> Motion<f64> {
        seen_from(&self.cvel[body], &(point - self.about(body)))
    }
}
