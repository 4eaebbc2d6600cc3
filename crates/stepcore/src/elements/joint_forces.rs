//! The force of one kind of element at given states.

use super::activation::Activations;
use super::actuator::Actuator;
use super::damper::Damper;
use super::force::{Forces, Moment};
use super::spring::Spring;
use super::Kind;
use crate::model::Model;
use crate::place::Placed;
use crate::state::Inputs;

/// Returns the force of all elements of one kind on the dofs at many states [N or N·m], for kinds that
/// depend on their joint alone: springs, dampers and actuators. None for others. ctrl, act, qpos and
/// qvel: one state after the other.
pub fn joint_forces(
    model: &Model,
    kind: Kind,
    ctrl: &[f64],
    act: &[f64],
    qpos: &[f64],
    qvel: &[f64],
) -> Option<Vec<f64>> {
    if !matches!(kind, Kind::Spring | Kind::Damper | Kind::Actuator) {
        return None;
    }
    let (mut inputs, mut placed) = (Inputs::<f64>::new(model), Placed::new(model));
    let nu = model.actuators.len();
    let mut all = Vec::with_capacity(qvel.len());
    if model.nv == 0 {
        return Some(all);
    }
    for (n, (qpos, qvel)) in qpos.chunks(model.nq.max(1)).zip(qvel.chunks(model.nv)).enumerate() {
        inputs.ctrl.copy_from_slice(&ctrl[n * nu..(n + 1) * nu]);
        let act = &act[n * model.na..(n + 1) * model.na];
        let act =
            Activations { act, history: &[], seconds: 0.0, period: 0.0, ahead: 0.0, middle: false };
        if kind == Kind::Actuator {
            let bounded = model.compensates && !model.clamps.is_empty();
            if bounded || !(model.tendons.is_empty() && model.linkages.is_empty()) {
                placed.positions(model, qpos);
            }
            placed.tensions(model, qpos, qvel, act, &inputs);
        }
        let frames = placed.frames();
        let now = Moment { model, frames, qpos, qvel, act, inputs: &inputs };
        let start = all.len();
        all.resize(start + model.nv, 0.0);
        let mut add = |dof: usize, force: f64| all[start + dof] += force;
        let acting = &model.acting;
        match kind {
            Kind::Spring => acting.spring.iter().for_each(|a| Spring::force(&now, &a.at, &mut add)),
            Kind::Damper => acting.damper.iter().for_each(|a| Damper::force(&now, &a.at, &mut add)),
            _ => acting.actuator.iter().for_each(|a| Actuator::force(&now, &a.at, &mut add)),
        }
    }
    Some(all)
}
