//! Which element made a run leave the finite numbers: the one whose power grew most
//! between the last two finite states, not the first that shows a NaN.

use crate::error::Error;
use crate::model::Model;
use crate::real::{Mask, Real};
use crate::sim::Sim;
use crate::solve::Source;

/// Power [W] of every element in one lane.
struct Ledger {
    entries: Vec<(String, f64)>,
}

impl<R: Real> Sim<R> {
    /// The error for the lanes in `bad`, whose next state is not finite.
    pub(crate) fn diverged(&mut self, bad: R::Mask) -> Error {
        let world = (0..R::LANES).find(|lane| bad.lane(*lane)).unwrap_or(0);
        let quantity = self.first_not_finite(world);
        let now = self.ledger(world);
        let state = self.state.clone();
        self.state.qpos.copy_from_slice(&self.before.qpos);
        self.state.qvel.copy_from_slice(&self.before.qvel);
        let earlier = self.forward().map(|()| self.ledger(world));
        self.state = state;
        let element = match earlier {
            Ok(earlier) => grown_most(&earlier, &now),
            Err(_) => grown_most(&Ledger { entries: Vec::new() }, &now),
        };
        let time = self.state.time(self.settings.dt);
        Error::Diverged { step: self.state.steps, time, world, element, quantity }
    }

    fn first_not_finite(&self, lane: usize) -> String {
        let bad = |x: &R| !x.is_finite().lane(lane);
        let joint = |dof: usize| name("joint", &self.model.joints[self.model.dofs[dof].joint].name, self.model.dofs[dof].joint);
        match self.next.qvel.iter().position(bad) {
            Some(dof) => format!("the velocity of {}", joint(dof)),
            None => "a position".into(),
        }
    }

    /// Power of each element at the state of the last solve.
    fn ledger(&self, lane: usize) -> Ledger {
        let model = &*self.model;
        let mut entries = Vec::new();
        let v = |k: usize| self.state.qvel[k].lane(lane);
        for (index, joint) in model.joints.iter().enumerate() {
            let dofs = joint.dof..joint.dof + joint.dofs();
            let power = |force: &[R]| dofs.clone().map(|k| force[k].lane(lane) * v(k)).sum::<f64>();
            let passive = if joint.stiffness != 0.0 { "spring of joint" } else { "damper of joint" };
            entries.push((name(passive, &joint.name, index), power(&self.placed.passive)));
            entries.push((name("inertial force of joint", &joint.name, index), power(&self.placed.bias)));
        }
        for (index, motor) in model.actuators.iter().enumerate() {
            let joint = &model.joints[motor.joint];
            let force = self.placed.actuator[index].lane(lane);
            let power = (0..joint.dofs()).map(|k| motor.gear[k] * force * v(joint.dof + k)).sum();
            entries.push((name("motor", &motor.name, index), power));
        }
        for block in self.rows.blocks.iter().filter(|block| block.mask.lane(lane)) {
            let rows = &self.rows.rows[block.rows.range()];
            let power: f64 = rows.iter().map(|row| row.impulse.lane(lane) * row.velocity.lane(lane)).sum();
            entries.push((self.source_name(block.source), power / self.settings.dt));
        }
        Ledger { entries }
    }

    /// The element that a block of rows came from, as a user knows it.
    pub fn source_name(&self, source: Source) -> String {
        let model = &*self.model;
        match source {
            Source::Equality(e) => name("connect", &model.equalities[e].name, e),
            Source::FrictionLoss(dof) => {
                let joint = model.dofs[dof].joint;
                name("friction loss of joint", &model.joints[joint].name, joint)
            }
            Source::Limit(joint, _) => name("limit of joint", &model.joints[joint].name, joint),
            Source::Contact(index) => contact_name(model, self.detected.contacts[index].pair),
        }
    }
}

/// "contact `a`/`b`".
pub fn contact_name(model: &Model, pair: usize) -> String {
    let pair = &model.pairs[pair];
    let geom = |index: usize| {
        let geom = &model.geoms[index];
        if geom.name.is_empty() { format!("`{index}`") } else { format!("`{}`", geom.name) }
    };
    format!("contact {}/{}", geom(pair.geom1), geom(pair.geom2))
}

fn name(kind: &str, name: &str, index: usize) -> String {
    if name.is_empty() {
        format!("{kind} {index}")
    } else {
        format!("{kind} `{name}`")
    }
}

/// The largest growth of |power|; an element whose power is no longer finite counts
/// only where every one is.
fn grown_most(earlier: &Ledger, now: &Ledger) -> String {
    let before = |name: &str| {
        earlier.entries.iter().find(|(n, _)| n == name).map_or(0.0, |(_, power)| power.abs())
    };
    let growth = |(name, power): &(String, f64)| {
        let grown = power.abs() - before(name);
        if grown.is_finite() { grown } else { f64::MIN }
    };
    now.entries
        .iter()
        .max_by(|a, b| growth(a).total_cmp(&growth(b)))
        .map_or_else(|| "no single element".into(), |(name, _)| name.clone())
}
