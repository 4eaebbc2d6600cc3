//! Inverse weights at qpos0: how easily a force moves a body or a dof. They set the
//! regulariser R of rows. Formulas at `fill`, MuJoCo's exception at `plain`. What a servo's
//! damping ratio means is decided by the same factors.

use super::pose::Pose;
use super::{tendons, Body, Dof, Model, Span, Tendon, Tree, NONE};
use crate::elements::{text, Kind, Text};
use crate::error::{Error, Result};
use crate::scene::{JointType, Scene};
use nalgebra::{DMatrix, DVector, Vector3};

/// A pivot this small, relative to its diagonal, is rounding: a dof that adds no
/// motion of its own.
const SINGULAR: f64 = 1e-14;

/// The inverse weight of a centre of mass that no dof moves is rounding: this much beside the
/// inverse of its tree's mass is none.
const WEIGHTLESS: f64 = 1e-20;

/// A dof's unit motion at qpos0 in world axes: the velocity at `at`, and the turn.
struct Motion {
    linear: Vector3<f64>,
    turn: Vector3<f64>,
    at: Vector3<f64>,
}

impl Motion {
    fn velocity(&self, point: Vector3<f64>) -> Vector3<f64> {
        self.linear + self.turn.cross(&(point - self.at))
    }
}

fn motions(model: &Model, poses: &[Pose]) -> Vec<Motion> {
    let mut list = Vec::with_capacity(model.nv);
    let mut add = |linear, turn, at| list.push(Motion { linear, turn, at });
    let zero = Vector3::zeros();
    for joint in &model.joints {
        let pose = &poses[joint.body];
        let (at, axis) = (pose.point(joint.pos), pose.rot * joint.axis);
        match joint.kind {
            JointType::Slide => add(axis, zero, at),
            JointType::Hinge => add(zero, axis, at),
            JointType::Ball => (0..3).for_each(|k| add(zero, pose.rot.column(k).into(), at)),
            JointType::Free => {
                (0..3).for_each(|k| add(Vector3::ith(k, 1.0), zero, pose.pos));
                (0..3).for_each(|k| add(zero, pose.rot.column(k).into(), pose.pos));
            }
        }
    }
    list
}

/// LᵀDL of one tree's mass matrix, armature included: L below the diagonal, D on it.
struct Factor<'a> {
    matrix: DMatrix<f64>,
    model: &'a Model,
    tree: Span,
}

impl<'a> Factor<'a> {
    fn new(model: &'a Model, poses: &[Pose], motions: &[Motion], tree: &Tree) -> Result<Self> {
        let (first, n) = (tree.dofs.start, tree.dofs.len);
        let mut matrix = DMatrix::zeros(n, n);
        for i in tree.bodies.range() {
            let (body, pose) = (&model.bodies[i], &poses[i]);
            let com = pose.point(body.ipos);
            let inertia = pose.rot * body.inertia * pose.rot.transpose();
            let chain = body.chain.of(&model.dof_lists);
            for (k, &a) in chain.iter().enumerate() {
                let force = motions[a].velocity(com) * body.mass;
                let torque = inertia * motions[a].turn;
                for &b in &chain[..=k] {
                    matrix[(a - first, b - first)] +=
                        force.dot(&motions[b].velocity(com)) + torque.dot(&motions[b].turn);
                }
            }
        }
        for i in 0..n {
            matrix[(i, i)] += model.dofs[first + i].armature;
        }
        for tendon in model.tendons.iter().filter(|tendon| tendon.armature > 0.0) {
            let arms = tree_arms(model, tendon, tree.dofs);
            matrix += tendon.armature * &arms * arms.transpose();
        }
        let mut factor = Self { matrix, model, tree: tree.dofs };
        factor.eliminate()?;
        Ok(factor)
    }

    /// The ancestors of a local dof, nearest first.
    fn ancestors(&self, local: usize) -> impl Iterator<Item = usize> + use<'a> {
        let (model, first) = (self.model, self.tree.start);
        model.dofs[first + local].row.of(&model.row_dofs)[1..].iter().map(move |d| d - first)
    }

    /// From the leaves to the root, so that only ancestors are touched.
    fn eliminate(&mut self) -> Result<()> {
        let diagonal = self.matrix.diagonal();
        for k in (0..self.tree.len).rev() {
            let pivot = self.matrix[(k, k)];
            if pivot.is_nan() || pivot <= SINGULAR * diagonal[k] {
                let joint = &self.model.joints[self.model.dofs[self.tree.start + k].joint];
                let name = Text::label(
                    Kind::Joint,
                    &joint.name,
                    self.model.dofs[self.tree.start + k].joint,
                );
                let body = Text::label(Kind::Body, &self.model.bodies[joint.body].name, joint.body);
                return Err(Error::Scene(text![
                    name,
                    " of ",
                    body,
                    " moves nothing that the joints after it do not move alike: \
                     the mass matrix has no inverse at the initial configuration"
                ]));
            }
            for i in self.ancestors(k) {
                let ratio = self.matrix[(k, i)] / pivot;
                self.matrix[(i, i)] -= ratio * self.matrix[(k, i)];
                for j in self.ancestors(i) {
                    self.matrix[(i, j)] -= ratio * self.matrix[(k, j)];
                }
                self.matrix[(k, i)] = ratio;
            }
        }
        Ok(())
    }

    /// M⁻¹ jᵀ.
    fn answer(&self, mut j: DVector<f64>) -> DVector<f64> {
        for k in (0..self.tree.len).rev() {
            for i in self.ancestors(k) {
                j[i] -= self.matrix[(k, i)] * j[k];
            }
        }
        for k in 0..self.tree.len {
            j[k] /= self.matrix[(k, k)];
            for i in self.ancestors(k) {
                j[k] -= self.matrix[(k, i)] * j[i];
            }
        }
        j
    }

    /// j M⁻¹ jᵀ.
    fn weight(&self, mut j: DVector<f64>) -> f64 {
        let mut sum = 0.0;
        for k in (0..self.tree.len).rev() {
            if j[k] != 0.0 {
                for i in self.ancestors(k) {
                    j[i] -= self.matrix[(k, i)] * j[k];
                }
                sum += j[k] * j[k] / self.matrix[(k, k)];
            }
        }
        sum
    }
}

/// The axes of a servo of orientations have the mean of their weights.
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
pub fn fill(scene: &Scene, model: &mut Model, poses: &[Pose], aligned: &[bool]) -> Result<()> {
    let motions = motions(model, poses);
    let mut bodies = vec![[0.0; 2]; model.bodies.len()];
    let mut dofs = vec![0.0; model.nv];
    let arms = model.arms_at_qpos0();
    let mut pulled = vec![[0.0; 2]; arms.len()];
    let mut tendons = vec![0.0; model.tendons.len()];
    for tree in &model.trees {
        let factor = Factor::new(model, poses, &motions, tree)?;
        let (first, n) = (tree.dofs.start, tree.dofs.len);
        for i in tree.bodies.range() {
            bodies[i] = body_weight(
                &factor,
                &motions,
                &model.bodies[i],
                poses[i].point(model.bodies[i].ipos),
            );
            if bodies[i][0] * tree.mass < WEIGHTLESS {
                bodies[i][0] = 0.0;
            }
        }
        for i in tree.dofs.range() {
            let mut unit = DVector::zeros(n);
            unit[i - first] = 1.0;
            dofs[i] = factor.weight(unit);
        }
        for (sum, arms) in pulled.iter_mut().zip(&arms) {
            let row = DVector::from_column_slice(&arms[tree.dofs.range()]);
            let answer = factor.answer(row.clone());
            sum[0] += row.dot(&answer);
            sum[1] += answer.norm_squared();
        }
        for (weight, tendon) in tendons.iter_mut().zip(&model.tendons) {
            *weight += tendon_weight(&factor, tendon);
        }
    }
    share_axes(model, &mut pulled);
    for (actuator, [weight, square]) in model.actuators.iter_mut().zip(pulled) {
        if actuator.dampratio != 0.0 {
            let inertia = if weight > 0.0 { 1.0 / weight } else { 0.0 };
            actuator.bias[2] = -2.0 * actuator.dampratio * (-actuator.bias[1] * inertia).sqrt();
        }
        let muscles = [&mut actuator.muscle_gain, &mut actuator.muscle_bias];
        for muscle in muscles.into_iter().flatten().filter(|muscle| muscle.force < 0.0) {
            muscle.force = muscle.scale / square.sqrt().max(1e-15);
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

/// The part of J M⁻¹ Jᵀ of a tendon that this tree gives.
fn tendon_weight(factor: &Factor, tendon: &Tendon) -> f64 {
    factor.weight(tree_arms(factor.model, tendon, factor.tree))
}

/// The arms of a tendon at qpos0 on the dofs of a tree.
fn tree_arms(model: &Model, tendon: &Tendon, tree: Span) -> DVector<f64> {
    let mut row = DVector::zeros(tree.len);
    for (dof, arm) in tendon.dofs.of(&model.dof_lists).iter().zip(&tendon.arms0) {
        if tree.range().contains(dof) {
            row[dof - tree.start] = *arm;
        }
    }
    row
}

fn body_weight(factor: &Factor, motions: &[Motion], body: &Body, com: Vector3<f64>) -> [f64; 2] {
    let chain = body.chain.of(&factor.model.dof_lists);
    let mean = |part: &dyn Fn(&Motion) -> Vector3<f64>| {
        let axis = |k: usize| {
            let mut row = DVector::zeros(factor.tree.len);
            for &d in chain {
                row[d - factor.tree.start] = part(&motions[d])[k];
            }
            factor.weight(row)
        };
        (axis(0) + axis(1) + axis(2)) / 3.0
    };
    [mean(&|m| m.velocity(com)), mean(&|m| m.turn)]
}

/// Bodies that MuJoCo weighs by their mass alone, whatever the armature of their joints and the
/// number of their axes: slides through the origin along coordinate axes, the
/// inertia's frame the body's own, no child, above it the world or one fixed
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
