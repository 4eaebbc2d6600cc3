//! What a step proposes, and the working space of the integrators.

use super::damped::Damped;
use super::implicit::Implicit;
use crate::integrator::Stages;
use crate::model::Model;
use crate::place::Metric;
use crate::plan::{Commit, Plan};
use crate::real::Real;
use crate::state::State;
use crate::warm::{Sleep, Warm};

/// The state that a step proposes, and the working space of the integrators.
pub struct Next<R: Real> {
    pub qpos: Vec<R>,
    pub qvel: Vec<R>,
    pub act: Vec<R>,
    /// By activation, the length about which a servo on a circle keeps it.
    pub(super) centres: Vec<R>,
    pub ctrl_history: Vec<R>,
    /// The velocities of the state, made to keep the equalities where these act within the step.
    pub start: Vec<R>,
    /// What the equalities gave in the stages, by row.
    pub held: Vec<R>,
    /// Working space, by dof.
    pub change: Vec<R>,
    /// The guess of the smooth forces alone, where contacts push beside their rows.
    pub smooth: Vec<R>,
    pub(super) gained: Vec<R>,
    /// The constant velocity that would have moved the positions as far, under `rk4` and `midpoint`.
    pub(super) mean: Vec<R>,
    /// Impulses for the next step's start.
    pub warm: Vec<Warm<R>>,
    /// Who sleeps in this step, and after it; and the impulses that those who wake in it start from,
    /// among the others. Empty: nobody wakes.
    pub sleep: Sleep<R>,
    pub woken: Vec<Warm<R>>,
    /// Which stage of `rk4` runs: after the first, rows start from the stage before.
    pub stage: usize,
    /// Where `rk4` and `midpoint` run the stages within the step, and how far in it that is.
    pub(crate) trial: Trial<R>,
    pub(crate) ahead: f64,
    /// That is the middle of a step: `Activations::middle`.
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
    /// The rotation vector by which this stage is away from the start.
    pub turned: Vec<R>,
    pub moved: Vec<R>,
    pub gained: Vec<R>,
    /// Rates of the activations; and of the first stage, how fast they fade too.
    pub act_rate: Vec<R>,
    pub act_first: Vec<R>,
    pub act_fading: Vec<R>,
}

room!(Sums<R>: rate, turned, moved, gained, act_rate, act_first, act_fading);

/// Working space of `midpoint`: M + dt/2·D + dt²/4·K, by dof the slopes of what acts by itself, and
/// the change that a correction makes.
pub(super) struct Iteration<R: Real> {
    pub metric: Metric<R>,
    /// Where each entry of M stands in it.
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
    /// The impulses from which rows start.
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
