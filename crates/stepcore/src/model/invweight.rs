//! Inverse weights at qpos0: how easily a force moves a body or a dof. They set the regulariser R
//! of rows. Formulas at `fill`, MuJoCo's exception at `plain`. The same factors decide the meaning
//! of a servo's damping ratio.

use super::{tendons, Body, Dof, Model, Tendon, NONE};
use crate::elements::{text, Kind, Text};
use crate::error::{Error, Result};
use crate::interrupt::Meter;
use crate::place::Placed;
use crate::scene::{JointType, Scene};

/// A pivot this small, relative to its diagonal, is rounding: the dof adds no independent motion.
const SINGULAR: f64 = 1e-14;

/// The inverse weight of a centre of mass that no dof moves is rounding: below this share of the
/// inverse of its tree's mass it counts as zero.
const WEIGHTLESS: f64 = 1e-20;

/// MuJoCo's `mjMINVAL`: the weight of an actuator whose arms are rounding is below it.
const MINVAL: f64 = 1e-15;

/// The mass matrix at qpos0 and its factors, and room for a row.
struct Factors<'a> {
    model: &'a Model,
    placed: Placed<f64>,
    row: Vec<f64>,
    meter: Meter,
}

impl<'a> Factors<'a> {
    fn new(model: &'a Model) -> Result<Self> {
        let mut placed = Placed::<f64>::new(model);
        placed.masses(model, &model.qpos0);
        let factors = Self { model, placed, row: vec![0.0; model.nv], meter: Meter::default() };
        factors.check()?;
        Ok(factors)
    }

    /// The pivots, from the leaves, so that the first one found is no consequence of another.
    fn check(&self) -> Result<()> {
        let Placed { metric, mass, composite, motion, .. } = &self.placed;
        for k in self.model.trees.iter().flat_map(|tree| tree.dofs.range().rev()) {
            let (dof, pivot) = (&self.model.dofs[k], metric.pivot(k));
            // Turned about the tree's origin: the terms that cancel are as large as this.
            let lever = composite[dof.body].mass * motion[k].lin.norm_squared();
            if pivot.is_nan() || pivot <= SINGULAR * (mass[dof.row.start] + lever) {
                let joint = &self.model.joints[dof.joint];
                let name = Text::label(Kind::Joint, &joint.name, dof.joint);
                let body = Text::label(Kind::Body, &self.model.bodies[joint.body].name, joint.body);
                return Err(Error::Scene(text![
                    name,
                    " of ",
                    body,
                    " moves nothing that the joints after it do not move alike: \
                     the mass matrix has no inverse at the initial configuration"
                ]));
            }
        }
        Ok(())
    }

    /// j M⁻¹ jᵀ of a row on these dofs, each with all dofs that move it.
    fn weight(&mut self, dofs: &[usize], entry: impl Fn(usize, usize) -> f64) -> f64 {
        self.meter.count(dofs.len() * dofs.len());
        dofs.iter().enumerate().for_each(|(at, k)| self.row[*k] = entry(at, *k));
        self.placed.metric.lift(dofs, &mut self.row);
        let inv_d = &self.placed.metric.inv_d;
        dofs.iter().map(|k| std::mem::take(&mut self.row[*k]).powi(2) * inv_d[*k]).sum()
    }

    /// The mean over three directions, for a body's centre of mass and for its rotation.
    fn of_body(&mut self, body: usize) -> [f64; 2] {
        let chain = self.model.bodies[body].chain.of(&self.model.dof_lists);
        let Placed { origin, motion, .. } = &self.placed;
        let arm =
            self.placed.frames().centre(self.model, body) - origin[self.model.bodies[body].tree];
        let moved: Vec<_> = chain.iter().map(|k| [motion[*k].at(&arm), motion[*k].ang]).collect();
        [0, 1].map(|part| {
            let axis = |axis| self.weight(chain, |at, _| moved[at][part][axis]);
            [0, 1, 2].map(axis).iter().sum::<f64>() / 3.0
        })
    }
}

/// Gives the axes of a servo of orientations the mean of their weights.
fn share_axes(model: &Model, pulled: &mut [[f64; 2]]) {
    let turns = |index: &usize| model.actuators[*index].orientation.is_some();
    let leads = |index: &usize| turns(index) && model.actuators[*index].feeds.is_none();
    for first in (0..pulled.len()).filter(leads) {
        let own = |index: &usize| model.actuators[*index].feeds == Some(first) && turns(index);
        let axes: Vec<usize> = (0..pulled.len()).filter(|k| *k == first || own(k)).collect();
        let mean = axes.iter().map(|k| pulled[*k][0]).sum::<f64>() / axes.len() as f64;
        axes.iter().for_each(|k| pulled[*k][0] = mean);
    }
}

/// Fills the inverse weights of all bodies and dofs.
///
/// A body: the mean over three directions of J M⁻¹ Jᵀ at its centre of mass, for
/// translation and for rotation. A dof: its entry of M⁻¹'s diagonal, the mean over
/// a ball's three, or a free joint's three and three.
pub fn weigh(scene: &Scene, model: &mut Model, aligned: &[bool]) -> Result<()> {
    let mut factors = Factors::new(model)?;
    let weigh = |(index, body): (usize, &Body)| match body.tree {
        NONE => [0.0; 2],
        tree => {
            let [shift, turn] = factors.of_body(index);
            [if shift * model.trees[tree].mass < WEIGHTLESS { 0.0 } else { shift }, turn]
        }
    };
    let mut bodies: Vec<_> = model.bodies.iter().enumerate().map(weigh).collect();
    let own = |k| {
        factors
            .weight(model.chain_of_dof(k).of(&model.dof_lists), |_, j| f64::from(u8::from(j == k)))
    };
    let mut dofs: Vec<f64> = (0..model.nv).map(own).collect();
    let along = |tendon: &Tendon| {
        let own = tendon.dofs.of(&model.dof_lists);
        factors.weight(tendon.closed.of(&model.dof_lists), |_, k| {
            own.binary_search(&k).map_or(0.0, |at| tendon.arms0[at])
        })
    };
    let tendons: Vec<f64> = model.tendons.iter().map(along).collect();
    let pull = |row: Vec<f64>| {
        let mut answer = row.clone();
        factors.placed.metric.solve(&mut answer);
        let products = row.iter().zip(&answer).map(|(arm, answer)| arm * answer);
        [products.sum::<f64>(), answer.iter().map(|x| x * x).sum()]
    };
    let mut pulled: Vec<_> = model.arms_at_qpos0(&factors.placed).into_iter().map(pull).collect();
    share_axes(model, &mut pulled);
    for (actuator, [weight, square]) in model.actuators.iter_mut().zip(pulled) {
        if actuator.dampratio != 0.0 {
            let inertia = if weight > MINVAL { 1.0 / weight } else { 0.0 };
            actuator.bias[2] = -2.0 * actuator.dampratio * (-actuator.bias[1] * inertia).sqrt();
        }
        let muscles = [&mut actuator.muscle_gain, &mut actuator.muscle_bias];
        for muscle in muscles.into_iter().flatten().filter(|muscle| muscle.force < 0.0) {
            muscle.force = muscle.scale / square.sqrt().max(MINVAL);
        }
    }
    for joint in model.joints.iter().filter(|j| matches!(j.kind, JointType::Ball | JointType::Free))
    {
        for three in dofs[joint.dof..joint.dof + joint.kind.dofs()].chunks_exact_mut(3) {
            three.fill(three.iter().sum::<f64>() / 3.0);
        }
    }
    for i in plain(scene, model, aligned) {
        let body = &model.bodies[i];
        bodies[i] = [1.0 / body.mass, 0.0];
        dofs[body.dofs.range()].fill(1.0 / body.mass);
    }
    model.tendons.iter_mut().zip(tendons).for_each(|(t, x)| t.invweight = x);
    model.bodies.iter_mut().zip(bodies).for_each(|(b, x)| b.invweight = x);
    model.dofs.iter_mut().zip(dofs).for_each(|(d, x): (&mut Dof, f64)| d.invweight = x);
    Ok(())
}

/// Bodies that MuJoCo weighs by their mass alone, whatever the armature of their joints and the
/// number of their axes: slides through the origin along coordinate axes, the
/// inertia's frame the body's, no child, above it the world or one fixed
/// child of the world, and no tendon with armature that has it in its path.
fn plain<'a>(
    scene: &Scene,
    model: &'a Model,
    aligned: &'a [bool],
) -> impl Iterator<Item = usize> + use<'a> {
    let mut leaf = vec![true; model.bodies.len()];
    for body in &model.bodies[1..] {
        leaf[body.parent] = false;
    }
    let mut drawn = vec![false; model.bodies.len()];
    let heavy = scene.tendons.iter().filter(|tendon| tendon.armature > 0.0);
    for body in heavy.flat_map(|tendon| &tendon.path).filter_map(|stop| tendons::body(model, stop))
    {
        drawn[body] = true;
    }
    let straight = |i: usize| {
        model.bodies[i].joints.of(&model.joints).iter().all(|j| {
            let along = j.axis.iter().filter(|x| x.abs() > 1e-14).count() == 1;
            j.kind == JointType::Slide && along && j.pos.norm_squared() == 0.0
        })
    };
    let grounded = |i: usize| {
        let parent = &model.bodies[model.bodies[i].parent];
        parent.parent == 0 && parent.dofs.len == 0
    };
    (1..model.bodies.len()).filter(move |&i| {
        let body = &model.bodies[i];
        body.tree != NONE
            && body.joints.len > 0
            && leaf[i]
            && !drawn[i]
            && aligned[i]
            && grounded(i)
            && straight(i)
    })
}

/// Springs and dampers of joints that are given by a time constant and a damping ratio, MuJoCo's
/// `springdamper`. With the inertia m = 1/invweight that a joint moves at the initial configuration
/// (the mean of a free joint's six), the stiffness becomes m/(τ ζ)² and the damping 2 m/τ.
pub fn spring_dampers(scene: &Scene, model: &mut Model) {
    for (index, source) in scene.joints.iter().enumerate() {
        let [constant, ratio] = source.springdamper;
        if !(constant > 0.0 && ratio > 0.0) {
            continue;
        }
        let joint = &mut model.joints[index];
        let dofs = &model.dofs[joint.dof..joint.dof + joint.dofs()];
        let weight = dofs.iter().map(|dof| dof.invweight).sum::<f64>() / dofs.len() as f64;
        let inertia = if weight > 0.0 { 1.0 / weight } else { 0.0 };
        if scene.features.spring {
            joint.stiffness[0] = inertia / (constant * constant * ratio * ratio);
        }
        if scene.features.damper {
            // The damping of actuators on it, which is in the sum already, stays.
            let of_actuators = joint.damping[0] - source.damping[0];
            joint.damping[0] = of_actuators + 2.0 * inertia / constant;
        }
    }
}
