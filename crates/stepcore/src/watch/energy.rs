//! Kinetic, gravitational and spring energy, momentum and overlap, at the present state.

use crate::detect::Contact;
use crate::elements::force::Group;
use crate::elements::forces::stored;
use crate::elements::{Element, Kind};
use crate::real::Real;
use crate::sim::{At, Sim};
use crate::spatial::{Force, V3};

/// Energies [J], per lane.
#[derive(Clone, Copy, Debug)]
pub struct Energy<R: Real> {
    pub kinetic: R,
    /// Gravity on every body, fixed ones too, zero at the world's origin; joint springs.
    pub potential: R,
}

impl<R: Real> Sim<R> {
    /// Energy at the present positions and velocities. Armature counts as inertia.
    pub fn energy(&mut self) -> Energy<R> {
        self.refresh();
        let kinetic = self.kinetic();
        let now = self.moment(At::State);
        let mut potential = R::zero();
        stored(&now, Group::Passive, &mut |_, energy| potential += energy);
        stored(&now, Group::Weight, &mut |_, energy| potential += energy);
        Energy { kinetic, potential }
    }

    /// Energy of springs and weight [J]: the potential without gravity compensation, which MuJoCo's
    /// sensor leaves out; for the present forces.
    pub(crate) fn potential_of_springs_and_weight(&self) -> R {
        let now = self.moment(At::State);
        let mut potential = R::zero();
        let mut add = |element: Element, energy| {
            if element.kind != Kind::GravityCompensation {
                potential += energy;
            }
        };
        stored(&now, Group::Passive, &mut add);
        stored(&now, Group::Weight, &mut add);
        potential
    }

    /// ½ vᵀMv with the present M [J].
    pub(crate) fn kinetic(&self) -> R {
        let model = &*self.model;
        let mut kinetic = R::zero();
        for k in 0..model.nv {
            let dof = &model.dofs[k];
            let v = self.state.qvel[k];
            let mut share = R::of(0.5) * self.placed.mass[dof.row.start] * v * v;
            for at in dof.row.range().skip(1) {
                share += self.placed.mass[at] * v * self.state.qvel[model.row_dofs[at]];
            }
            kinetic += share;
        }
        kinetic
    }

    /// Centre of mass of a body in the world [m].
    pub fn centre(&self, body: usize) -> V3<R> {
        self.placed.frames().centre(&self.model, body)
    }

    /// The deepest overlap of two geoms that can touch, at the present positions [m]; 0 where
    /// none do.
    pub fn overlap(&mut self) -> R {
        self.refresh();
        let zero = R::zero();
        let depth = |contact: &Contact<R>| R::select(contact.mask, -contact.dist, zero);
        self.detect_again().contacts.iter().map(depth).fold(zero, R::max)
    }

    /// Linear momentum, and angular momentum about the world's origin. Without armature.
    pub fn momentum(&mut self) -> Force<R> {
        self.refresh();
        let model = self.model.clone();
        self.placed.all_bodies(&model, &self.state.qvel);
        let mut sum = Force::zero();
        for (index, tree) in model.trees.iter().enumerate() {
            let mut part = Force::zero();
            for body in tree.bodies.range() {
                part.add(&self.placed.inertia[body].mul(&self.placed.velocity[body]));
            }
            part.ang += self.placed.origin[index].cross(&part.lin);
            sum.add(&part);
        }
        sum
    }

    /// Places bodies and geoms at the present state.
    pub(crate) fn place_poses(&mut self) {
        self.placed.carry(&self.inputs);
        self.placed.positions(&self.model, &self.state.qpos);
    }

    /// Computes poses, inertias, the mass matrix and the forces at the present state, except the
    /// forces that act through contacts.
    pub fn refresh(&mut self) {
        self.place_poses();
        let (qpos, qvel) = At::State.of(&self.state, &self.next);
        let act = self.state.activations(self.clock);
        self.placed.dynamics(&self.model, qpos, qvel, act, &self.inputs);
    }

    /// Adds these forces, for which contacts are detected.
    pub fn add_forces_through_contacts(&mut self) {
        let model = self.model.clone();
        let pulls = model.pulls_beside_rows(self.settings.law);
        if !pulls && !model.adheres {
            return;
        }
        let detected = self.detect_again();
        if pulls {
            self.placed.pull_contacts(&model, &detected.contacts);
        }
        if model.adheres {
            let act = self.state.activations(self.clock);
            let at = At::State.of(&self.state, &self.next);
            let guess = self.placed.guess.clone();
            self.placed.place_adhesion(&model, at, act, &self.inputs, &detected.contacts);
            self.placed.guess = guess;
        }
    }
}
