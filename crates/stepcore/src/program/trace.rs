//! A step written down: which operations it is, for a model and its settings.

use std::sync::Arc;

use crate::integrator::Stages;
use crate::model::Model;
use crate::plan::Plan;
use crate::real::traced::{Arg, Node, Recorder, Traced};
use crate::real::Real;
use crate::scene::JointType;
use crate::settings::{Acceleration, Settings, Solver};
use crate::sim::Sim;
use crate::solve::Sweeper;
use num_traits::Zero;

/// More rows than these leave no list of any use.
const MOST_DOFS: usize = 16;
const MOST_PAIRS: usize = 16;

/// What a step computes from the state, as entries of a list.
pub(super) struct Trace {
    pub nodes: Vec<Node>,
    pub qpos: Vec<Arg>,
    pub qvel: Vec<Arg>,
    pub qacc: Vec<Arg>,
    /// How many rows exist.
    pub rows: Arg,
    /// Masks that hold in no lane of a step that the list is right for.
    pub assumed: Vec<u32>,
    /// The sizes of a position and of a velocity up to which it is.
    pub limit: f64,
    pub fastest: f64,
}

/// The list of a model's steps in numbers of this unit roundoff, if it has one of at most so many
/// entries.
///
/// Joints slide or turn about an axis, and nothing drives. Rows are swept over a fixed number of
/// times; where none can ever be, the solver does not matter.
pub(super) fn trace(
    model: &Arc<Model>,
    settings: &Settings,
    epsilon: f64,
    most: usize,
) -> Option<Trace> {
    if !plain(model, settings) {
        return None;
    }
    Traced::round_as(epsilon);
    let single = epsilon > f64::EPSILON;
    let (limit, largest) = if single { (1e9, 1e38) } else { (1e60, 1e300) };
    let solver = Box::new(Sweeper::new());
    let keeps = Plan::of(model, settings).keeps;
    let swept = settings.solver == Solver::Pgs && settings.tolerance == 0.0 && !keeps;
    // Where rows are not swept over, such a list is of use only if there is nothing to sweep over.
    let sweeps = if swept { settings.sweeps } else { 1.into() };
    let settings = Settings { sweeps, ..settings.clone() };
    let mut sim = Sim::<Traced>::solved_by(solver, model.clone(), settings).ok()?;
    Recorder::begin(largest, most);
    for (at, q) in sim.state.qpos.iter_mut().enumerate() {
        *q = Traced::Node(Recorder::input(at, limit));
    }
    // Whoever moves faster is beyond the limit after a step.
    let fastest = 4.0 * limit / sim.settings.dt;
    for (at, v) in sim.state.qvel.iter_mut().enumerate() {
        *v = Traced::Node(Recorder::input(model.nq + at, fastest));
    }
    let outcome = sim.integrate(&mut ());
    let rows = count(&sim);
    let list = Recorder::end();
    if outcome.is_err() || list.given_up {
        return None;
    }
    if !(rows == Arg::Known(0.0) || swept) {
        return None;
    }
    let args = |list: &[Traced]| list.iter().map(|x| x.arg()).collect();
    Some(Trace {
        qpos: args(&sim.next.qpos),
        qvel: args(&sim.next.qvel),
        qacc: args(&sim.qacc),
        nodes: list.entries.nodes,
        assumed: list.assumed,
        rows,
        limit,
        fastest,
    })
}

fn plain(model: &Model, settings: &Settings) -> bool {
    let kinds =
        |joint: &crate::model::Joint| matches!(joint.kind, JointType::Slide | JointType::Hinge);
    let small =
        model.nv <= MOST_DOFS && model.pairs.len() <= MOST_PAIRS && model.dynamic_pairs.is_none();
    let alone = model.actuators.is_empty()
        && model.tendons.is_empty()
        && model.linkages.is_empty()
        && model.equalities.is_empty()
        && model.mocaps.is_empty();
    let one_stage = settings.integrator.scheme().stages == Stages::Start;
    let sweeps = settings.acceleration == Acceleration::None && settings.noslip_iterations == 0;
    let looks = settings.sleep || settings.ledger;
    small && alone && one_stage && sweeps && !looks && model.joints.iter().all(kinds)
}

/// How many rows exist, once a step was written down.
fn count(sim: &Sim<Traced>) -> Arg {
    let mut sum = Traced::zero();
    for block in &sim.rows.blocks {
        sum += Traced::select(block.mask, Traced::of(block.rows.len as f64), Traced::zero());
    }
    sum.arg()
}
