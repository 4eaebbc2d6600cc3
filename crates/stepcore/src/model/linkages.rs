//! The compiled transmissions of actuators, and the linkages whose length is neither a joint's nor
//! a tendon's: the length of a site and of a slider-crank.

use super::{Linkage, Model, Moved, Span, Transmission};
use crate::real::Constant;
use crate::scene::{self, Dynamics, JointType, Scene, Target};

/// Compiles everything of actuators except their effect on inertias.
pub fn compile(scene: &Scene, model: &mut Model) {
    for actuator in &scene.actuators {
        let len = actuator.states();
        model.activations.push(Span { start: model.na, len });
        model.na += len;
        let len = actuator.history();
        model.histories.push(Span { start: model.nhistory, len });
        model.nhistory += len;
        let along = transmission(model, actuator);
        model.along.push(along);
        model.circles.push(circle(model, actuator));
    }
    model.feeders = vec![[None; 4]; scene.actuators.len()];
    for (index, actuator) in scene.actuators.iter().enumerate() {
        let leads = actuator.controller.is_some() || actuator.orientation.is_some();
        let owner = actuator.feeds.or(leads.then_some(index));
        if let Some(owner) = owner {
            model.feeders[owner][actuator.input.slot()] = Some(index);
        }
    }
    model.clamps = (model.joints.iter().enumerate())
        .filter_map(|(index, joint)| Some((index, joint.actuatorfrcrange?)))
        .collect();
}

/// Adds the damping and armature of actuators to the joints, tendons or dofs that they pull.
pub fn reflect(model: &mut Model) {
    for index in 0..model.actuators.len() {
        let scene::Actuator { target, gear, damping, armature, .. } = model.actuators[index];
        let square = gear[0] * gear[0];
        let (kept, heavier) = match target {
            Target::Joint(joint) | Target::InParent(joint) => {
                let dofs =
                    model.joints[joint].dof..model.joints[joint].dof + model.joints[joint].dofs();
                model.dofs[dofs].iter_mut().for_each(|dof| dof.armature += square * armature);
                (&mut model.joints[joint].damping, None)
            }
            Target::Tendon(tendon) => {
                let tendon = &mut model.tendons[tendon];
                (&mut tendon.damping, Some(&mut tendon.armature))
            }
            Target::Site { .. } | Target::Crank { .. } | Target::Body(_) => continue,
        };
        if let Some(heavier) = heavier {
            *heavier += square * armature;
        }
        for (sum, part) in kept.iter_mut().zip(damping) {
            *sum += if model.features.damper { square * part } else { 0.0 };
        }
    }
}

/// Stores a gear and returns its place.
fn stored(model: &mut Model, gear: [f64; 6]) -> usize {
    model.gears.extend(gear);
    model.gears.len() - gear.len()
}

fn transmission(model: &mut Model, actuator: &scene::Actuator) -> Transmission {
    let gear = actuator.gear;
    match actuator.target {
        Target::InParent(joint) if model.joints[joint].kind.dofs() > 1 => {
            Transmission::InParent(joint, stored(model, gear))
        }
        Target::Joint(joint) | Target::InParent(joint) => {
            Transmission::Geared(joint, stored(model, gear))
        }
        Target::Tendon(tendon) => Transmission::Tendon(tendon, Some(stored(model, gear))),
        course @ Target::Site { site, reference } => {
            link(model, course, gear, [site, reference.unwrap_or(site)], reference.is_some())
        }
        course @ Target::Crank { crank, slider, .. } => {
            link(model, course, gear, [crank, slider], false)
        }
        course @ Target::Body(_) => {
            let all: Vec<usize> = (0..model.nv).collect();
            let moved = |dof| Moved { dof, at: dof, ends: [true; 2] };
            let movers = all.iter().copied().map(moved).collect();
            model.adheres = true;
            push(model, course, gear, all, movers)
        }
    }
}

/// Adds a linkage between two sites; `apart`: dofs that move both ends do not count.
fn link(
    model: &mut Model,
    course: Target,
    gear: [f64; 6],
    sites: [usize; 2],
    apart: bool,
) -> Transmission {
    let chains = sites.map(|site| {
        let chain = model.bodies[model.sites[site].body].chain;
        chain.of(&model.dof_lists).to_vec()
    });
    let mut union = chains.concat();
    union.sort_unstable();
    union.dedup();
    let single = matches!(course, Target::Site { reference: None, .. });
    let moved = |(at, dof): (usize, &usize)| {
        let [first, second] = [0, 1].map(|end| chains[end].contains(dof));
        let ends = [first, second && !single];
        (!(apart && first && second)).then_some(Moved { dof: *dof, at, ends })
    };
    let movers = union.iter().enumerate().filter_map(moved).collect();
    push(model, course, gear, union, movers)
}

/// Adds a linkage that these dofs move.
fn push(
    model: &mut Model,
    course: Target,
    gear: [f64; 6],
    union: Vec<usize>,
    movers: Vec<Moved>,
) -> Transmission {
    let dofs = Span { start: model.dof_lists.len(), len: union.len() };
    model.dof_lists.extend(union);
    let tendons = model.tendons.last().map_or(0, |last| last.arms.start + last.arms.len);
    let start = model.linkages.last().map_or(tendons, |last| last.arms.start + last.arms.len);
    let length = model.tendons.len() + model.linkages.len();
    let arms = Span { start, len: dofs.len };
    model.linkages.push(Linkage { course, gear, length, dofs, arms, movers });
    Transmission::Linkage(model.linkages.len() - 1)
}

/// The length after which a servo's target is the same again; 0 where it never is.
fn circle(model: &Model, actuator: &scene::Actuator) -> f64 {
    let [x, y, z, a, b, c] = actuator.gear;
    let turn =
        |axis: [f64; 3]| std::f64::consts::TAU * axis.iter().map(|x| x * x).sum::<f64>().sqrt();
    match actuator.target {
        _ if !actuator.holds_a_length() || actuator.dynamics == Dynamics::Muscle => 0.0,
        Target::Joint(joint) | Target::InParent(joint)
            if model.joints[joint].kind == JointType::Ball =>
        {
            turn([x, y, z])
        }
        Target::Site { reference: Some(_), .. } if [x, y, z] == [0.0; 3] => turn([a, b, c]),
        _ => 0.0,
    }
}

impl<N: Constant> Model<N> {
    /// Whether the force of an actuator takes part.
    #[inline(always)]
    pub fn acts(&self, index: usize) -> bool {
        self.features.actuation && self.actuators[index].enabled
    }

    /// Entries of `Placed::shares`.
    pub(crate) fn shares(&self) -> usize {
        let bounded = self.tendons.iter().any(|tendon| tendon.actuatorfrcrange.is_some());
        let some = bounded || !self.clamps.is_empty();
        if some {
            2 * self.nv + self.tendons.len()
        } else {
            0
        }
    }

    /// Entries of `Placed::tendon_length` and of `Placed::tendon_arms`.
    pub(crate) fn lengths(&self) -> (usize, usize) {
        let tendons = self.tendons.iter().map(|t| t.arms.len).sum::<usize>();
        let linkages = self.linkages.iter().map(|l| l.arms.len).sum::<usize>();
        (self.tendons.len() + self.linkages.len(), tendons + linkages)
    }

    /// Whether a linkage ends on a body of each tree.
    pub(super) fn passed_by_linkages(&self) -> Vec<bool> {
        let mut found = vec![false; self.trees.len()];
        let ended = |linkage: &&Linkage| !matches!(linkage.course, Target::Body(_));
        for linkage in self.linkages.iter().filter(ended) {
            for dof in linkage.dofs.of(&self.dof_lists) {
                found[self.dofs[*dof].tree] = true;
            }
        }
        found
    }
}
