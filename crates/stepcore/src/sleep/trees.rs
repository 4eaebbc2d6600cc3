//! The constant data of sleep: MuJoCo's policy of each tree, and its lengths of dofs.

use crate::model::{Model, Union, NONE};
use crate::real::Real;
use crate::room::{listed, Room};
use crate::scene::{JointType, SleepPolicy, Target};
use crate::spatial::rotation;
use crate::warm::Sleep;
use std::sync::Arc;

/// MuJoCo's least length of a body [m].
const LEAST: f64 = 1e-5;

/// The constant data of sleep, and working space.
pub(crate) struct Sleeper<R: Real> {
    /// The trees that sleep from the start.
    pub initial: Arc<Sleep<R>>,
    /// For each tree: whether it never sleeps.
    pub never: Vec<bool>,
    /// For each dof: the speed of a point that a unit of its velocity moves.
    pub length: Vec<f64>,
    /// For each tree: its entries of qpos.
    pub qpos: Vec<[usize; 2]>,
    pub union: Union,
    /// For each island: whether all of it may sleep.
    pub ready: Vec<bool>,
}

impl<R: Real> Room for Sleeper<R> {
    fn room(&self) -> usize {
        let lists = listed(&self.never) + listed(&self.length) + listed(&self.qpos);
        // The two counts of an Arc, and its contents.
        let initial = 2 * size_of::<usize>() + size_of::<Sleep<R>>() + self.initial.room();
        lists + initial + self.union.room() + listed(&self.ready)
    }
}

impl<R: Real> Sleeper<R> {
    pub fn new(model: &Model) -> Self {
        let mut qpos = vec![[usize::MAX, 0]; model.trees.len()];
        for joint in &model.joints {
            let [from, to] = &mut qpos[model.bodies[joint.body].tree];
            *from = joint.qpos.min(*from);
            *to = (joint.qpos + joint.kind.positions()).max(*to);
        }
        Self { never: never(model), length: lengths(model), qpos, ..Self::off() }
    }

    /// For settings without sleep.
    pub fn off() -> Self {
        Self {
            initial: Arc::new(Sleep::new()),
            never: vec![],
            length: vec![],
            qpos: vec![],
            union: Union::default(),
            ready: vec![],
        }
    }
}

/// For each tree: whether it never sleeps. An automatic tree may sleep if no actuator drives it,
/// whose force may change at any time, and if it shares no pulling tendon, and none with two
/// others. A tree on a mocap body never sleeps: that body's earlier pose is not part of the state.
fn never(model: &Model) -> Vec<bool> {
    let mut bound = vec![false; model.trees.len()];
    for (actuator, along) in model.actuators.iter().zip(&model.along) {
        match actuator.target {
            // The bodies that it pulls share its contacts, and with them its island.
            Target::Body(body) if model.bodies[body].tree != NONE => {
                bound[model.bodies[body].tree] = true;
            }
            _ => along.movers(model, |dof| bound[model.dofs[dof].tree] = true),
        }
    }
    for tendon in &model.tendons {
        let dofs = tendon.dofs.of(&model.dof_lists);
        let mut trees: Vec<usize> = dofs.iter().map(|dof| model.dofs[*dof].tree).collect();
        trees.dedup();
        if trees.len() > 2 || (trees.len() == 2 && tendon.pulls()) {
            trees.iter().for_each(|tree| bound[*tree] = true);
        }
    }
    let never = |(tree, bound): (&crate::model::Tree, bool)| {
        let allowed = match tree.sleep {
            SleepPolicy::Auto => !bound,
            SleepPolicy::Never => false,
            SleepPolicy::Allowed | SleepPolicy::Init => true,
        };
        !allowed || model.bodies[tree.bodies.start].carried
    };
    model.trees.iter().zip(bound).map(never).collect()
}

/// MuJoCo's `dof_length`: 1 for a sliding dof; for a rotation the largest distance of the body's
/// geoms and joints, and of its children's joints, from its centre of mass [m].
fn lengths(model: &Model) -> Vec<f64> {
    let mut reach = vec![LEAST; model.bodies.len()];
    let mut extend = |body: usize, distance: f64| reach[body] = reach[body].max(distance);
    for joint in &model.joints {
        let body = &model.bodies[joint.body];
        extend(joint.body, (joint.pos - body.ipos).norm());
        let anchor = body.pos + rotation(body.quat) * joint.pos;
        extend(body.parent, (anchor - model.bodies[body.parent].ipos).norm());
    }
    for geom in &model.geoms {
        let [a, b, c] = geom.half;
        // For a mesh, use the box that contains it.
        let radius = if geom.hull.is_some() { (a * a + b * b + c * c).sqrt() } else { geom.reach };
        if radius.is_finite() {
            extend(geom.body, (geom.pos - model.bodies[geom.body].ipos).norm() + radius);
        }
    }
    let length = |(k, dof): (usize, &crate::model::Dof)| {
        let joint = &model.joints[dof.joint];
        match joint.kind {
            JointType::Slide => 1.0,
            JointType::Free if k < joint.dof + 3 => 1.0,
            _ => reach[dof.body],
        }
    };
    model.dofs.iter().enumerate().map(length).collect()
}
