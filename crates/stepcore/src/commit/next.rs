//! The proposed next state, and the working space of the integrators.

use super::damped::Damped;
use super::implicit::Implicit;
use crate::integrator::Stages;
use crate::model::Model;
use crate::place::Metric;
use crate::plan::{Commit, Plan};
use crate::real::Real;
use crate::state::State;
use crate::warm::{Sleep, Warm};

/// The proposed next state, and the working space of the integrators.
pub struct Next<R: Real> {
    pub qpos: Vec<R>,
    pub qvel: Vec<R>,
    pub act: Vec<R>,
    /// Per activation: the length near which a servo on a circle keeps it.
    pub(super) centres: Vec<R>,
    pub ctrl_history: Vec<R>,
    /// The velocities of the state, projected to satisfy the equalities if these act within the step.
    pub start: Vec<R>,
    /// The impulses of the equalities in the stages, by row.
    pub held: Vec<R>,
    /// Working space, by dof.
    pub change: Vec<R>,
    /// The guess of the smooth forces alone, if contacts push outside the rows.
    pub smooth: Vec<R>,
    pub(super) gained: Vec<R>,
    /// The constant velocity with the same displacement, under `rk4` and `midpoint`.
    pub(super) mean: Vec<R>,
    /// Impulses for the next step's start.
    pub warm: Vec<Warm<R>>,
    /// The trees that sleep in this step, and after it; and the initial impulses, including those
    /// of trees that wake in it. Empty: none wakes.
    pub sleep: Sleep<R>,
    pub woken: Vec<Warm<R>>,
    /// The current stage of `rk4`: after the first, rows start from the stage before.
    pub stage: usize,
    /// The state of the current stage of `rk4` or `midpoint`, and its time within the step.
    pub(crate) trial: Trial<R>,
    pub(crate) ahead: f64,
    /// Whether that is the middle of a step: `Activations::middle`.
    pub(crate) middle: bool,
    pub(super) damped: Option<Damped<R>>,
    pub(super) implicit: Option<Implicit<R>>,
    pub(super) iteration: Option<Iteration<R>>,
    pub(super) sums: Sums<R>,
}

room!(Next<R>: qpos, qvel, act, centres, ctrl_history, start, held, change, smooth, gained, mean,
    warm, sleep, woken, stage, trial, ahead, middle, damped, implicit, iteration, sums);

/// Positions and velocities within a step.
pub(crate) struct Trial<R: Real> {
    pub qpos: Vec<R>,
    pub qvel: Vec<R>,
    pub act: Vec<R>,
}

room!(Trial<R>: qpos, qvel, act);

/// The weighted sums of the stages of `rk4`.
pub(super) struct Sums<R: Real> {
    pub rate: Vec<R>,
    /// The rotation vector of this stage relative to the start.
    pub turned: Vec<R>,
    pub moved: Vec<R>,
    pub gained: Vec<R>,
    /// Rates of the activations; and for the first stage, their decay rates too.
    pub act_rate: Vec<R>,
    pub act_first: Vec<R>,
    pub act_fading: Vec<R>,
}

room!(Sums<R>: rate, turned, moved, gained, act_rate, act_first, act_fading);

/// Working space of `midpoint`: M + dt/2·D + dt²/4·K, by dof the slopes of uncoupled forces, and
/// the change by a correction.
pub(super) struct Iteration<R: Real> {
    pub metric: Metric<R>,
    /// The place of each entry of M in it.
    pub places: Vec<usize>,
    pub slopes: Vec<[R; 2]>,
    pub change: Vec<R>,
    pub correction: Vec<R>,
}

room!(Iteration<R>: metric, places, slopes, change, correction);

impl<R: Real> Iteration<R> {
    pub fn new(model: &Model<R::Value>) -> Self {
        let (zero, metric) = (R::zero(), Metric::coupled(model));
        Self {
            places: metric.places(model),
            metric,
            slopes: vec![[zero; 2]; model.nv],
            change: vec![zero; model.nv],
            correction: vec![zero; model.nv],
        }
    }
}

impl<R: Real> Next<R> {
    /// Returns the initial impulses of rows.
    pub(crate) fn last_impulses<'a>(&'a self, state: &'a State<R>) -> &'a [Warm<R>] {
        if self.stage > 0 {
            &self.warm
        } else if self.woken.is_empty() {
            &state.warm
        } else {
            &self.woken
        }
    }

    pub fn new(model: &Model<R::Value>, plan: &Plan) -> Self {
        let does = |commit: Commit| plan.commit.contains(&commit);
        let middle = plan.scheme.stages == Stages::Middle;
        let zeros = |n| vec![R::zero(); n];
        let (nq, nv) = (model.nq, model.nv);
        Self {
            qpos: zeros(nq),
            qvel: zeros(nv),
            act: zeros(model.na),
            centres: zeros(model.na),
            ctrl_history: zeros(model.nhistory),
            start: zeros(nv),
            held: zeros(model.equalities.iter().map(|e| e.rows()).sum()),
            change: zeros(nv),
            smooth: zeros(nv),
            gained: zeros(nv),
            mean: zeros(nv),
            warm: Vec::new(),
            sleep: Sleep::new(),
            woken: Vec::new(),
            stage: 0,
            trial: Trial { qpos: zeros(nq), qvel: zeros(nv), act: zeros(model.na) },
            ahead: 0.5,
            middle,
            damped: (does(Commit::Damped) || does(Commit::Spinning))
                .then(|| Damped::new(model, &plan.late)),
            implicit: does(Commit::Turning).then(|| Implicit::new(model, &plan.late)),
            iteration: middle.then(|| Iteration::new(model)),
            sums: Sums {
                rate: zeros(nv),
                turned: zeros(nv),
                moved: zeros(nv),
                gained: zeros(nv),
                act_rate: zeros(model.na),
                act_first: zeros(model.na),
                act_fading: zeros(model.na),
            },
        }
    }
}
