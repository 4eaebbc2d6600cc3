//! Stage 1, place: the positions and masses of everything, and the motion to be expected without
//! contacts and other rows.
//!
//! Reads positions, velocities and the inputs; writes `Placed`. Its last result is the guess, in
//! factored coordinates: u = L v, û = u + dt·D⁻¹L⁻ᵀf.

mod bias;
pub(crate) mod bias_slopes;
mod effective;
mod factor;
mod force;
mod in_plane;
mod inertia;
mod kinematics;
mod kinematics_in_plane;
mod linkage;
mod resting;
mod tendon;
mod tendon_inertia;
mod wrap;

pub use effective::Effective;
pub use factor::{spread, Metric};
pub(crate) use wrap::{wrap, Obstacle};

use crate::elements::activation::Activations;
use crate::elements::force::Frames;
use crate::integrator::Turning;
use crate::model::transmission::Pulls;
use crate::model::{Body, Model, NONE};
use crate::plan::places::Place;
use crate::real::{Real, Stage};
use crate::settings::Settings;
use crate::spatial::{splat, Force, Inertia, Motion, Pose, Quat, M3, V3};
use crate::state::Inputs;
use in_plane::InPlane;
use resting::Resting;

/// The output of this stage. Lists are by body, dof, geom, tree as named.
pub struct Placed<R: Real> {
    /// Body frame, by body [m].
    pub xpos: Vec<V3<R>>,
    pub xquat: Vec<Quat<R>>,
    pub xmat: Vec<M3<R>>,
    /// From the parent's frame to this one before its joints move it, in world axes.
    offset: Vec<V3<R>>,
    /// Poses of mocap bodies, as last set.
    pub(crate) mocap: Vec<(V3<R>, Quat<R>)>,
    /// Everything was placed once, so that constants are valid.
    placed: bool,
    /// The next placing is at the positions of the last one: see `Sim::hold_positions`.
    pub(crate) held: bool,
    /// Trees that sleep, and need not be placed again.
    resting: Resting<R>,
    /// Pose of each geom that collides, by geom.
    pub geom: Vec<Pose<R>>,
    /// The point about which a tree's spatial quantities are expressed, by tree.
    pub origin: Vec<V3<R>>,
    /// Motion of a dof's body per unit of the dof's velocity, by dof.
    pub motion: Vec<Motion<R>>,
    /// Spatial inertia by body, and summed over all that hangs on the body.
    pub inertia: Vec<Inertia<R>>,
    pub composite: Vec<Inertia<R>>,
    /// The state of trees that move in a plane, by body; empty if there are none.
    in_plane: Vec<InPlane<R>>,
    /// Each step needs the motion of bodies in space, of these trees too.
    in_space: bool,
    /// The mass matrix, armature included, in the layout of `Model::row_dofs`.
    pub mass: Vec<R>,
    /// M = LᵀDL; under `discrete` the factors of M̂, and M̂ itself.
    pub metric: Metric<R>,
    pub effective: Option<Effective<R>>,
    /// Velocity by body.
    pub velocity: Vec<Motion<R>>,
    acceleration: Vec<Motion<R>>,
    wrench: Vec<Force<R>>,
    /// Coriolis, centrifugal and gravity forces, by dof; on the left side of the equation.
    pub bias: Vec<R>,
    /// Joint springs and dampers, by dof.
    pub passive: Vec<R>,
    /// Length of each tendon [m, or the unit of its joints], and its arms in the layout of
    /// `Tendon::arms`; for tendons that no step uses, from when they were last read. Then the linkages.
    pub tendon_length: Vec<R>,
    pub tendon_arms: Vec<R>,
    /// Force of each motor and servo before its gear, by actuator.
    pub actuator: Vec<R>,
    /// Rates of the activations, by entry of act.
    pub act_rate: Vec<R>,
    /// Rates at which `act_rate` fades as the activations move [1/s].
    pub act_fading: Vec<R>,
    /// The share of the actuators' forces that a joint lets through, by dof; then, by tendon and again
    /// by dof, 1 if no bound limits the sum of these forces, else 0. Empty: nothing has such bounds.
    pub shares: Vec<R>,
    /// All smooth forces summed, by dof: applied + actuated + passive − bias.
    pub force: Vec<R>,
    /// u = L v of the present velocity, and of the guess.
    pub u: Vec<R>,
    pub guess: Vec<R>,
}

room!(Placed<R>: xpos, xquat, xmat, offset, mocap, placed, held, resting, geom, origin, motion, inertia,
    composite, in_plane, in_space, mass, metric, effective, velocity, acceleration, wrench, bias,
    passive, tendon_length, tendon_arms, actuator, act_rate, act_fading, shares, force, u, guess);

impl<R: Real> Placed<R> {
    /// Creates the output for placing without steps.
    pub fn new(model: &Model<R::Value>) -> Self {
        Self::with(model, None, false)
    }

    /// Creates the output for steps with these settings.
    pub fn for_steps(model: &Model<R::Value>, settings: &Settings) -> Self {
        let scheme = settings.integrator.scheme();
        let in_space = scheme.turning == Some(Turning::Trees);
        Self::with(model, scheme.stiffness.then(|| R::of(settings.dt)), in_space)
    }

    /// effective: the step in whose metric rows are solved, if not in M [s].
    /// in_space: see `Placed::in_space`.
    fn with(model: &Model<R::Value>, effective: Option<R>, in_space: bool) -> Self {
        let planes = model.trees.iter().any(|tree| tree.plane.is_some());
        let (nbody, nv) = (model.bodies.len(), model.nv);
        let zero = R::zero();
        let identity = Quat::identity();
        let metric = match effective {
            Some(_) => Metric::coupled(model),
            None => Metric::new(model),
        };
        let mut placed = Self {
            xpos: vec![V3::zeros(); nbody],
            xquat: vec![identity; nbody],
            xmat: vec![identity.matrix(); nbody],
            offset: vec![V3::zeros(); nbody],
            mocap: model.mocaps.iter().map(|body| pose_of(&model.bodies[*body])).collect(),
            placed: false,
            held: false,
            resting: Resting::new(),
            geom: vec![Pose { pos: V3::zeros(), rot: identity.matrix() }; model.geoms.len()],
            origin: vec![V3::zeros(); model.trees.len()],
            motion: vec![Motion::zero(); nv],
            inertia: vec![Inertia::zero(); nbody],
            composite: vec![Inertia::zero(); nbody],
            in_plane: vec![InPlane::still(); if planes { nbody } else { 0 }],
            in_space,
            mass: vec![zero; model.row_dofs.len()],
            effective: effective.map(|dt| Effective::new(model, &metric, dt)),
            metric,
            velocity: vec![Motion::zero(); nbody],
            acceleration: vec![Motion::zero(); nbody],
            wrench: vec![Force::zero(); nbody],
            bias: vec![zero; nv],
            passive: vec![zero; nv],
            tendon_length: vec![zero; model.lengths().0],
            tendon_arms: vec![zero; model.lengths().1],
            actuator: vec![zero; model.actuators.len()],
            act_rate: vec![zero; model.na],
            act_fading: vec![zero; model.na],
            shares: vec![zero; model.shares()],
            force: vec![zero; nv],
            u: vec![zero; nv],
            guess: vec![zero; nv],
        };
        placed.place_constants(model);
        placed
    }

    /// Places everything that no step changes: fixed bodies, and all of a tree that only slides.
    fn place_constants(&mut self, model: &Model<R::Value>) {
        let qpos: Vec<R> = model.qpos0.iter().map(|q| R::of(*q)).collect();
        let still = vec![R::zero(); model.nv];
        for body in 1..model.bodies.len() {
            self.place_body(model, &qpos, body);
        }
        for geom in 0..model.geoms.len() {
            self.place_geom(model, geom);
        }
        self.placed = true;
        self.constant_arms(model);
        for (index, tree) in model.trees.iter().enumerate() {
            self.weigh(model, tree);
            self.factor_mass(tree);
            self.velocities(model, &still, tree);
            self.bias_of_tree(model, index);
            if tree.constant && self.effective.is_none() {
                self.metric.constant(tree.dofs.range());
            }
        }
        if let Some(effective) = &mut self.effective {
            effective.start(&self.mass, &mut self.metric);
        }
    }

    /// Computes positions only: bodies, geoms and the motion of every dof.
    pub fn positions(&mut self, model: &Model<R::Value>, qpos: &[R]) {
        self.resting.forget();
        R::enter(Stage::Kinematics);
        let trees = model.trees.iter().flat_map(|tree| tree.bodies.range());
        for body in model.carried.iter().copied().chain(trees) {
            self.place_body(model, qpos, body);
        }
        for (index, geom) in model.geoms.iter().enumerate() {
            let body = &model.bodies[geom.body];
            if geom.collides && (body.tree != NONE || body.carried) {
                self.place_part(model, index, model.part(index));
            }
        }
        self.place_tendons(model, qpos, |_| true);
        self.place_linkages(model);
    }

    /// Computes the positions that a step needs.
    pub fn positions_in_step(&mut self, model: &Model<R::Value>, qpos: &[R]) {
        R::enter(Stage::Kinematics);
        for body in &model.carried {
            self.place_body(model, qpos, *body);
        }
        for Place { index, tree, how } in &model.places.bodies {
            if !self.resting.skips(*tree) {
                self.place_by(model, qpos, *index, *how);
            }
        }
        for Place { index, tree, how } in &model.places.geoms {
            if !self.resting.skips(*tree) {
                self.place_part(model, *index, *how);
            }
        }
        if !model.tendons.is_empty() {
            self.place_tendons(model, qpos, |tendon| tendon.used);
        }
        if !model.linkages.is_empty() {
            self.place_linkages(model);
        }
    }

    /// Computes the poses of some bodies, each after its parent, and of some geoms on them.
    pub(crate) fn place_some(
        &mut self,
        model: &Model<R::Value>,
        qpos: &[R],
        bodies: &[usize],
        geoms: &[usize],
    ) {
        self.resting.forget();
        for body in bodies {
            self.place_body(model, qpos, *body);
        }
        for geom in geoms {
            self.place_geom(model, *geom);
        }
    }

    /// Changes the length of the steps [s].
    pub(crate) fn set_dt(&mut self, dt: R) {
        if let Some(effective) = &mut self.effective {
            effective.set_dt(dt);
        }
    }

    /// Makes the next call place every tree.
    pub(crate) fn place_all(&mut self) {
        self.resting.forget();
    }

    /// Returns the data that forces read.
    #[inline(always)]
    pub(crate) fn frames(&self) -> Frames<'_, R> {
        Frames {
            xpos: &self.xpos,
            xmat: &self.xmat,
            origin: &self.origin,
            motion: &self.motion,
            tension: &self.actuator,
            shares: &self.shares,
            pulls: self.pulls(),
        }
    }

    /// Returns the lengths and arms of tendons.
    #[inline(always)]
    pub(crate) fn pulls(&self) -> Pulls<'_, R> {
        Pulls { length: &self.tendon_length, arms: &self.tendon_arms }
    }

    /// Computes the smooth dynamics at (qpos, qvel): M, its factors, and the forces.
    pub(crate) fn dynamics(
        &mut self,
        model: &Model<R::Value>,
        qpos: &[R],
        qvel: &[R],
        act: Activations<R>,
        inputs: &Inputs<R>,
    ) {
        for &index in &model.places.weighed {
            if !self.resting.skips(index) {
                let tree = &model.trees[index];
                let plane = tree.plane.as_ref().filter(|_| !self.in_space);
                if !self.held {
                    R::enter(Stage::Inertia);
                    match plane {
                        Some(plane) => self.weigh_in_plane(model, tree, plane),
                        None => self.weigh(model, tree),
                    }
                    R::enter(Stage::Factor);
                    self.factor_mass(tree);
                }
                R::enter(Stage::Bias);
                match plane {
                    Some(plane) => self.bias_in_plane(model, qvel, tree, plane),
                    None => self.bias_in_space(model, qvel, index),
                }
            }
        }
        if !model.tendons.is_empty() {
            self.bias_of_tendons(model);
        }
        R::enter(Stage::Forces);
        self.smooth_force(model, qpos, qvel, act, inputs);
        if self.effective.is_some() {
            self.weigh_effective(model, qpos, qvel, act, inputs);
        }
    }

    /// Computes inertia and velocity of every body about its tree's origin; `dynamics` skips trees
    /// whose dynamics are constant although their bodies move, and trees that move in a plane.
    pub fn all_bodies(&mut self, model: &Model<R::Value>, qvel: &[R]) {
        self.resting.forget();
        for tree in &model.trees {
            self.inertias(model, tree);
            self.velocities(model, qvel, tree);
        }
    }

    /// Takes in the poses of mocap bodies.
    pub(crate) fn carry(&mut self, inputs: &Inputs<R>) {
        for (pose, given) in self.mocap.iter_mut().zip(inputs.mocap()) {
            *pose = given;
        }
    }

    /// Runs the whole stage, ending with the guess û.
    pub(crate) fn place(
        &mut self,
        model: &Model<R::Value>,
        qpos: &[R],
        qvel: &[R],
        act: Activations<R>,
        inputs: &Inputs<R>,
        dt: R,
    ) {
        self.resting.begin();
        if !self.held {
            self.carry(inputs);
            self.positions_in_step(model, qpos);
        } else if model.adheres {
            // The arms at contacts are zero until the contacts are detected.
            self.place_linkages(model);
        }
        self.dynamics(model, qpos, qvel, act, inputs);
        self.held = false;
        R::enter(Stage::Guess);
        self.metric.to_factored(qvel, &mut self.u);
        self.make_guess(dt);
        self.resting.end();
    }

    /// Computes û from the present smooth force.
    pub(crate) fn make_guess(&mut self, dt: R) {
        if self.metric.is_diagonal() && self.effective.is_none() {
            let each = self.u.iter().zip(&self.force).zip(&self.metric.inv_d);
            for (guess, ((u, force), inv_d)) in self.guess.iter_mut().zip(each) {
                *guess = *u + dt * (*force * *inv_d);
            }
            return;
        }
        self.guess.copy_from_slice(&self.force);
        if let Some(Effective { shift, .. }) = &self.effective {
            for (guess, shift) in self.guess.iter_mut().zip(shift) {
                *guess -= *shift;
            }
        }
        self.metric.half_solve(&mut self.guess);
        for (guess, u) in self.guess.iter_mut().zip(&self.u) {
            *guess = *u + dt * *guess;
        }
    }
}

/// Returns the pose of a fixed body in its scene.
fn pose_of<R: Real>(body: &Body<R::Value>) -> (V3<R>, Quat<R>) {
    (splat(&body.pos), Quat::splat(&body.quat))
}
