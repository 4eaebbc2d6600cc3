//! Poses, inertia and the smooth forces.

use super::{split, Of, Print};
use crate::elements::Kind;
use crate::integrator::Turning;
use crate::model::{Model, NONE};
use crate::plan::acting::Why;
use crate::settings::Settings;

const FIXED: &str = "fixed: computed once, at compilation";

/// How forces are printed: kind, name, and the type of their elements.
const FORCES: [(Kind, &str, Of); 6] = [
    (Kind::Spring, "springs", Of::Joint),
    (Kind::Damper, "dampers", Of::Joint),
    (Kind::TendonSpring, "tendon springs", Of::Tendon),
    (Kind::TendonDamper, "tendon damping", Of::Tendon),
    (Kind::Fluid, "fluid drag (by body)", Of::Body),
    (Kind::Actuator, "actuators", Of::Actuator),
];

impl Print {
    /// The poses of bodies and geoms, and the lengths of tendons.
    pub(super) fn places(&mut self, model: &Model) {
        let name = "poses of bodies";
        let bodies = &model.places.bodies;
        let placed: Vec<usize> = bodies.iter().map(|place| place.index).collect();
        let fixed = |body: usize| body > 0 && model.bodies[body].tree == NONE;
        let unused =
            |body: usize| model.trees.get(model.bodies[body].tree).is_some_and(|tree| !tree.seen);
        let nbody = model.bodies.len();
        self.does("place", name, Of::Body, placed.clone());
        self.omits("place", name, Of::Body, split(nbody, fixed)[0].clone(), FIXED);
        self.omits("place", name, Of::Body, split(nbody, unused)[0].clone(), "no step uses them");
        let (turning, level): (Vec<usize>, Vec<usize>) =
            placed.into_iter().partition(|body| model.bodies[*body].turns);
        self.does("place", "rotations of bodies", Of::Body, turning);
        self.omits("place", "rotations of bodies", Of::Body, level, "no joint rotates them");
        let name = "poses of geoms";
        let tree = |geom: usize| model.bodies[model.geoms[geom].body].tree;
        let moving = model.places.geoms.iter().filter(|place| place.tree != NONE);
        self.does("place", name, Of::Geom, moving.map(|place| place.index).collect());
        let collides = |geom: usize| model.geoms[geom].collides;
        let still = |geom: usize| collides(geom) && tree(geom) == NONE;
        let ngeom = model.geoms.len();
        self.omits("place", name, Of::Geom, split(ngeom, still)[0].clone(), FIXED);
        let ghosts = split(ngeom, collides)[1].clone();
        self.omits("place", name, Of::Geom, ghosts, "they collide with nothing");
        let [used, unused] = split(model.tendons.len(), |tendon| model.tendons[tendon].used);
        self.does("place", "lengths of tendons", Of::Tendon, used);
        let why = "nothing pulls along them: computed when read";
        self.omits("place", "lengths of tendons", Of::Tendon, unused, why);
    }

    /// Inertia, and everything that pushes without rows.
    pub(super) fn terms(&mut self, model: &Model, settings: &Settings) {
        let (trees, on) = (&model.trees, &model.features);
        let weighed = || model.places.weighed.clone();
        let mut used = |name: &str| {
            self.does("place", name, Of::Tree, weighed());
        };
        used("mass matrix and its factors (by tree)");
        used("bias force of gravity and velocity (by tree)");
        let name = "mass matrix, factors and bias force (by tree)";
        let constant = |slides: bool| {
            split(trees.len(), |tree| trees[tree].constant && trees[tree].slides_only == slides)
        };
        let [sliding, _] = constant(true);
        self.omits("place", name, Of::Tree, sliding, "constant: nothing rotates");
        let why = "isotropic: constant, and no gyroscopic term";
        let [balls, _] = constant(false);
        self.omits("place", name, Of::Tree, balls, why);
        let in_space = settings.integrator.scheme().turning == Some(Turning::Trees);
        let forces = if in_space { "" } else { ", mass matrix and bias force" };
        for (k, axis) in ["x", "y", "z"].into_iter().enumerate() {
            let [flat, _] = split(trees.len(), |tree| {
                trees[tree].plane.as_ref().is_some_and(|plane| plane.normal == k)
            });
            let name = format!("poses{forces} out of a plane (by tree)");
            let why = format!("hinges turn about {axis}, slides lie across it: two dimensions");
            self.omits("place", name, Of::Tree, flat, why);
        }
        let name = "of which Coriolis, centrifugal, gyroscopic";
        if on.coriolis {
            self.does("place", name, Of::Tree, weighed());
        } else {
            self.omits("place", name, Of::Tree, weighed(), "switched off (coriolis)");
        }
        self.forces(model);
        let heavy = |tendon: usize| model.tendons[tendon].armature > 0.0;
        let [heavy, _] = split(model.tendons.len(), heavy);
        self.does("place", "tendon armature", Of::Tendon, heavy);
        let beyond = model.armature_beyond_the_tree();
        let name = "tendon armature, between dofs of which neither moves the other";
        let why = "left out, as MuJoCo does: the mass matrix has no entry for such two dofs";
        self.omits("place", name, Of::Tendon, split(beyond.len(), |i| beyond[i])[0].clone(), why);
        let [held, _] = split(model.bodies.len(), |body| model.bodies[body].gravcomp != 0.0);
        let name = "gravity compensation (by body)";
        if model.compensates {
            self.does("place", name, Of::Body, held);
        } else {
            let above = model.bodies.iter().any(|body| body.gravcomp > 0.0);
            let why = if above { "switched off" } else { "none is above 0, as MuJoCo requires" };
            self.omits("place", name, Of::Body, held, why);
        }
        let joints = (0..model.joints.len()).collect();
        self.does("place", "velocity before constraints (by joint)", Of::Joint, joints);
        if !on.gravity || model.gravity.norm_squared() == 0.0 {
            let why = if on.gravity { "0" } else { "switched off" };
            self.omits("place", "gravity", Of::Body, vec![], why).counting(1);
        }
    }

    /// Everything in the lists of `elements/forces.rs` that a user can leave out.
    fn forces(&mut self, model: &Model) {
        let acting = model.acting.elements();
        for (kind, name, of) in FORCES {
            let own = acting.iter().filter(|element| element.kind == kind);
            self.does("place", name, of, own.map(|element| element.index as usize).collect());
            let mut reasons: Vec<Why> = vec![];
            let out = || model.acting.left_out.iter().filter(move |(e, _)| e.kind == kind);
            for (_, why) in out() {
                if !reasons.contains(why) {
                    reasons.push(*why);
                }
            }
            for reason in reasons {
                let own = out().filter(|(_, why)| *why == reason);
                let own = own.map(|(element, _)| element.index as usize).collect();
                let why = match reason {
                    Why::Off(flag) => format!("switched off ({flag})"),
                    // A quantity that no tendon has gets no entry.
                    Why::Zero(_) | Why::Unsaid if of != Of::Joint => continue,
                    Why::Zero(field) => format!("{field} 0"),
                    Why::Unsaid => continue,
                };
                self.omits("place", name, of, own, why);
            }
        }
    }
}
