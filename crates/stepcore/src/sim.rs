//! `Sim`: one model, one state (or a lane register of states), and its working space.
//!
//! It steps, independent of its observers: see `observer.rs` and `watch/`.

use crate::room::Room;
use std::sync::Arc;

use crate::arrays::array::Array;
use crate::clock::Clock;
use crate::commit::{Extrapolation, Next};
use crate::detect::Detected;
use crate::elements::activation::Activations;
use crate::elements::{Element, Kind};
use crate::error::{Divergence, Error, Fault, Result};
use crate::integrator::Stages;
use crate::model::memory::check_spaces;
use crate::model::{ByLane, Model, SideBySide};
use crate::place::Placed;
use crate::plan::Plan;
use crate::pool::Pool;
use crate::real::{Mask, Real};
use crate::settings::{Integrator, Settings, Solver};
use crate::sleep::Sleeper;
use crate::solve::{Noslip, Report, Rows, Solve, Solvers, Unconstrained};
use crate::state::{Inputs, State};

/// Velocities from this size on are beyond any motion: MuJoCo resets such a world (`mjMAXVAL`).
const BEYOND: f64 = 1e10;

/// The effort of the last solve and of the run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Effort {
    /// Sweeps or Newton iterations of the last solve (the most of any island and lane).
    pub sweeps: u32,
    /// Row updates since the start, over all lanes together.
    pub row_updates: u64,
    /// The most rows that any solve since the start had.
    pub most_rows: usize,
    /// Evaluations of forces since the start: once per step or once per stage.
    pub evaluations: u64,
    /// Searches for the distance of two convex shapes since the start.
    pub separations: u64,
    /// Newton's last decrement, relative; 0 under PGS.
    pub decrement: f64,
    /// The parts of the last adaptive step.
    pub stretches: Stretches,
}

/// The parts of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stretches {
    /// The shortest accepted [s].
    pub shortest: f64,
    /// The shortest rejected [s], and the body whose error was too large; None: it diverged.
    pub refused: Option<(f64, Option<usize>)>,
}

impl Stretches {
    /// Explains why adaptive steps of `dt` are slow.
    pub fn slow(&self, dt: f64, accuracy: Option<f64>, model: &Model) -> Option<String> {
        let (accuracy, (_, refused)) = (accuracy?, self.refused?);
        let why = match refused {
            None => "in longer ones the motion diverges".into(),
            Some(body) => {
                let body = model.named(Element::whole(Kind::Body, body));
                format!("longer ones move {body} too far")
            }
        };
        Some(format!(
            "steps of {dt} s within accuracy {accuracy} m are slow here: one is made of parts as short as \
             {:.1e} s, because {why}",
            self.shortest
        ))
    }

    pub(crate) fn take(&mut self, length: f64) {
        self.shortest = self.shortest.min(length);
    }

    pub(crate) fn refuse(&mut self, length: f64, body: Option<usize>) {
        if self.refused.is_none_or(|(shortest, _)| length < shortest) {
            self.refused = Some((length, body));
        }
    }
}

/// One world, or a register of parallel worlds. `step.rs` steps it.
///
/// Model and settings were checked at its creation, and cannot be changed behind it:
///
/// ```compile_fail
/// fn backwards(sim: &mut stepcore::sim::Sim<f64>) {
///     sim.settings.dt = -1.0;
/// }
/// ```
pub struct Sim<R: Real> {
    pub(crate) model: Arc<Model<R::Value>>,
    /// The models of its worlds, by lane; the last one also applies to the remaining lanes.
    pub(crate) models: ByLane,
    pub(crate) settings: Settings,
    /// The plan of a step under these settings.
    pub(crate) plan: Plan,
    pub(crate) clock: Clock<R>,
    /// The time by which a step advances [s]; an adaptive step is made of shorter ones, whose
    /// length is in `clock` and `settings.dt`.
    pub(crate) period: f64,
    pub state: State<R>,
    pub inputs: Inputs<R>,
    /// The last output of each stage.
    pub placed: Placed<R>,
    pub detected: Detected<R>,
    pub rows: Rows<R>,
    /// v⁺ of the last solve, and (v⁺ − v)/dt.
    pub velocity: Vec<R>,
    pub qacc: Vec<R>,
    pub effort: Effort,
    /// An adaptive step is aborted after this many evaluations of the forces.
    pub(crate) most: u64,
    pub(crate) next: Next<R>,
    /// Whether the next step is placed, detected and solved already: see `ledger/audit.rs`.
    pub(crate) stands: bool,
    pub(crate) solver: Box<dyn Solve<R>>,
    noslip: Noslip<R>,
    pub(crate) sleeper: Sleeper<R>,
    /// Working space of adaptive steps.
    pub(crate) extrapolation: Option<Box<Extrapolation<R>>>,
}

/// The positions and velocities at which stages run.
#[derive(Clone, Copy, PartialEq)]
pub enum At {
    /// At the state.
    State,
    /// At the state, with velocities projected onto the equalities: `next.start`.
    Start,
    /// At a stage within the step: `next.trial`.
    Stage,
}

impl At {
    pub fn of<'a, R: Real>(self, state: &'a State<R>, next: &'a Next<R>) -> (&'a [R], &'a [R]) {
        match self {
            Self::State => (&state.qpos, &state.qvel),
            Self::Start => (&state.qpos, &next.start),
            Self::Stage => (&next.trial.qpos, &next.trial.qvel),
        }
    }

    /// Returns the activations there, in steps of `clock`.
    pub(crate) fn activations<'a, R: Real>(
        self,
        state: &'a State<R>,
        next: &'a Next<R>,
        clock: Clock<R>,
    ) -> Activations<'a, R> {
        if self == Self::Stage {
            return Activations {
                act: &next.trial.act,
                ahead: next.ahead,
                middle: next.middle,
                ..state.activations(clock)
            };
        }
        state.activations(clock)
    }
}

room!(Sim<R>: model, models, plan, clock, state, inputs, placed, detected, rows, velocity, qacc, effort,
    next, stands, solver, noslip, sleeper, extrapolation; settings, period, most);

impl<R: Real> Sim<R> {
    /// Creates a world at qpos0 and at rest; reject settings outside their limits.
    pub fn new(model: Arc<Model>, settings: Settings) -> Result<Self> {
        Self::side_by_side(SideBySide::new([model].into())?, settings)
    }

    /// The same for several worlds, one per lane, whose models differ in numbers.
    pub(crate) fn side_by_side(models: SideBySide<R>, settings: Settings) -> Result<Self> {
        Self::solved_by(Box::new(Solvers::new()), models, settings)
    }

    /// Resets the working space that an interrupted step has left inconsistent.
    #[cold]
    pub(crate) fn renew(&mut self) {
        let (model, pool) = (&self.model, self.rows.pool.take());
        (self.clock, self.settings.dt) = (Clock::new(self.period), self.period);
        self.placed = Placed::for_steps(model, &self.settings);
        self.detected = Detected::new(model, self.settings.max_contacts);
        self.rows = Rows::new(model);
        self.next = Next::new(model, &self.plan);
        self.solver.renew();
        self.noslip = Noslip::new();
        if self.extrapolation.is_some() {
            self.extrapolation = Some(Box::new(Extrapolation::new(&self.placed, model)));
        }
        self.stands = false;
        self.detected.pool.clone_from(&pool);
        self.rows.pool = pool;
        self.clear_solve();
    }

    /// Returns the models of its worlds.
    pub(crate) fn models(&self) -> SideBySide<R> {
        SideBySide { models: self.models.clone(), model: self.model.clone() }
    }

    /// Replaces the models of its worlds by models that differ in numbers.
    pub(crate) fn take_models(&mut self, models: &SideBySide<R>) {
        if Arc::ptr_eq(&self.model, &models.model) {
            return;
        }
        let stands = self.placed.effective.is_none() && self.model.stands_as(&models.model);
        // An interruption here leaves the former models.
        let placed = (!stands).then(|| Placed::for_steps(&models.model, &self.settings));
        (self.models, self.model) = (models.models.clone(), models.model.clone());
        if let Some(placed) = placed {
            self.placed = placed;
        }
    }

    /// The same with a given solver.
    pub(crate) fn solved_by(
        solver: Box<dyn Solve<R>>,
        models: SideBySide<R>,
        mut settings: Settings,
    ) -> Result<Self> {
        settings.check()?;
        let SideBySide { models, model } = models;
        for model in &*models {
            check_masses::<R>(model, settings.solver)?;
        }
        if model.sticks && settings.law.on_guess() {
            let limit =
                "solref or penalty: under the others contacts that adhere are not built yet";
            return Err(Error::value("law", settings.law.name(), limit));
        }
        if !R::ALONE && model.dynamic_pairs.is_some() {
            let limit = "1: the pairs of a heap are found one world at a time";
            return Err(Error::value("lanes", R::LANES, limit));
        }
        if !R::ALONE && settings.sleep {
            let limit = "1 with sleep: each world sleeps by itself";
            return Err(Error::value("lanes", R::LANES, limit));
        }
        check_spaces(&models[0], &settings, R::LANES, "lanes")?;
        if settings.accuracy.0.is_some() {
            extrapolates::<R>(&mut settings)?;
        }
        let plan = Plan::of(&models[0], &settings);
        let placed = Placed::for_steps(&model, &settings);
        let within = settings.accuracy.0.is_some();
        let mut sim = Self {
            state: State::new(&model),
            inputs: Inputs::new(&model),
            extrapolation: match within {
                true if R::ALONE => Some(Box::new(Extrapolation::new(&placed, &model))),
                _ => None,
            },
            placed,
            detected: Detected::new(&model, settings.max_contacts),
            rows: Rows::new(&model),
            velocity: vec![R::zero(); model.nv],
            qacc: vec![R::zero(); model.nv],
            effort: Effort::default(),
            most: u64::MAX,
            next: Next::new(&model, &plan),
            plan,
            stands: false,
            solver,
            noslip: Noslip::new(),
            sleeper: if settings.sleep { Sleeper::new(&models[0]) } else { Sleeper::off() },
            clock: Clock::new(settings.dt),
            period: settings.dt,
            models,
            model,
            settings,
        };
        if R::ALONE {
            sim.sleep_from_start()?;
        }
        Ok(sim)
    }

    /// Shares the work of each step among this many threads. The motion has the same bits with any
    /// number.
    pub fn use_threads(&mut self, threads: usize) -> Result<()> {
        let pool = Pool::new(threads)?;
        self.detected.pool.clone_from(&pool);
        self.rows.pool = pool;
        Ok(())
    }

    /// Returns the model of the first world.
    pub fn model(&self) -> &Arc<Model> {
        &self.models[0]
    }

    /// Returns the model of the world in a lane.
    pub(crate) fn model_of(&self, lane: usize) -> &Arc<Model> {
        &self.models[lane.min(self.models.len() - 1)]
    }

    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Returns the time of the state [s].
    pub fn time(&self) -> f64 {
        self.state.time(self.period)
    }

    /// Returns the time by which a step advances [s].
    pub fn period(&self) -> f64 {
        self.period
    }

    /// Starts the built rows from the last step's impulses, if these are stored, except equalities
    /// that the stages held (`inside`).
    pub(crate) fn warm_start(&mut self, inside: bool) {
        if self.plan.warm_start {
            let last = self.next.last_impulses(&self.state);
            let lists = self.detected.dof_lists(&self.model);
            self.rows.warm_start(last, inside);
            // Newton's method uses them for zones, and starts from the last acceleration.
            if !self.plan.resumes {
                self.rows.apply_impulses(lists, &self.placed.metric.inv_d);
            }
        }
    }

    /// Solves the built rows, from their current impulses.
    pub(crate) fn solve(&mut self) -> Result<()> {
        let (model, inv_d) = (&*self.model, &self.placed.metric.inv_d);
        let dof_lists = self.detected.dof_lists(model);
        if self.plan.weighs {
            self.rows.weigh_islands(model, &self.placed.mass);
        }
        let free = Unconstrained { dof_lists, inv_d, guess: &self.placed.guess };
        let report = self.solver.solve(&self.settings, free, &mut self.rows)?;
        self.effort.note(&report, self.rows.rows.len());
        if self.plan.noslip > 0 {
            let Plan { noslip, noslip_cost, .. } = self.plan;
            self.noslip.solve(free, &mut self.rows, noslip, noslip_cost);
        }
        Ok(())
    }

    /// Returns the error for the lanes in `failed`, whose step cannot be committed: the error of the
    /// first one.
    pub(crate) fn diverged(&self, failed: R::Mask, fault: impl FnOnce(usize) -> Fault) -> Error {
        let lane = (0..R::LANES).find(|lane| failed.lane(*lane)).unwrap_or(0);
        Error::Diverged(Box::new(self.divergence(lane, fault(lane))))
    }

    /// Returns the divergence at the present state of a lane, without an explanation.
    pub(crate) fn divergence(&self, lane: usize, fault: Fault) -> Divergence {
        let (step, time) = (self.state.steps, self.time());
        Divergence { step, time, world: lane, batch: false, fault, post: None }
    }

    /// Returns the first dof whose `quantity`, in `numbers`, is not finite in a lane.
    pub(crate) fn not_finite(&self, lane: usize, quantity: &'static str, numbers: &[R]) -> Fault {
        let Some(dof) = numbers.iter().position(|x| !x.is_finite().lane(lane)) else {
            return Fault::Position;
        };
        let joint = Element::whole(Kind::Joint, self.model.dofs[dof].joint);
        Fault::NotFinite { quantity, joint: self.model.named(joint) }
    }

    /// Returns the first velocity in a lane that is beyond `BEYOND`, if there is one.
    pub(crate) fn beyond(&self, lane: usize) -> Option<Fault> {
        let velocities = self.state.qvel.iter().map(|velocity| velocity.lane(lane));
        let (dof, velocity) = velocities.enumerate().find(|(_, v)| v.abs() > BEYOND)?;
        let joint = Element::whole(Kind::Joint, self.model.dofs[dof].joint);
        Some(Fault::Beyond { velocity, joint: self.model.named(joint) })
    }

    /// Returns the first activation after the step that is not finite in a lane.
    pub(crate) fn act_not_finite(&self, lane: usize) -> Fault {
        let bad = self.next.act.iter().position(|x| !x.is_finite().lane(lane));
        let Some(entry) = bad else { return Fault::Position };
        let element = Array::Act.owner(&self.model, entry);
        Fault::NotFinite { quantity: "activation", joint: self.model.named(element) }
    }

    /// Clears the last solve.
    pub fn clear_solve(&mut self) {
        self.rows.clear();
        self.detected.contacts.clear();
        self.placed.actuator.fill(R::zero());
        self.qacc.fill(R::zero());
        self.velocity.copy_from_slice(&self.state.qvel);
    }

    /// Returns the memory of the state and of all working space [bytes], without the model.
    pub fn bytes(&self) -> usize {
        size_of::<Self>() + self.room()
    }

    /// Returns the residual of the last solve [m/s]; 0 without rows.
    pub fn residual(&self) -> R {
        self.rows.residual(self.detected.dof_lists(&self.model))
    }
}

/// Checks the requirements of adaptive steps. They consist of first-order steps of any length, under
/// a law that does not depend on it.
fn extrapolates<R: Real>(settings: &mut Settings) -> Result<()> {
    if !R::ALONE {
        let limit = "1 with an accuracy: each world has steps of its own";
        return Err(Error::value("lanes", R::LANES, limit));
    }
    if settings.integrator.scheme().stages != Stages::Start {
        settings.integrator = Integrator::Euler;
    }
    settings.refsafe = false;
    Ok(())
}

/// Checks that the precision can represent every mass and its inverse, and for Newton, whose costs
/// are energies of impulses, their squares.
pub(crate) fn check_masses<R: Real>(model: &Model, solver: Solver) -> Result<()> {
    for (index, body) in model.bodies.iter().enumerate().filter(|(_, body)| body.mass > 0.0) {
        let mass = R::of(body.mass);
        let mass = if solver == Solver::Newton { mass * mass } else { mass };
        let inverse = R::one() / mass;
        if mass.is_finite().none()
            || mass.is_zero()
            || inverse.is_finite().none()
            || inverse.is_zero()
        {
            let limit =
                "representable in this precision, as must its inverse (under newton, their squares)";
            return Err(Error::value(
                format!("mass of {}", model.element_name(Element::whole(Kind::Body, index))),
                body.mass,
                limit,
            ));
        }
    }
    Ok(())
}

impl Effort {
    /// A step without rows needs no sweeps.
    pub(crate) fn rest(&mut self) {
        (self.sweeps, self.decrement) = (0, 0.0);
    }

    fn note<R: Real>(&mut self, report: &Report<R>, rows: usize) {
        let lanes = 0..R::LANES;
        self.most_rows = self.most_rows.max(rows);
        self.sweeps = lanes.clone().map(|lane| report.sweeps.lane(lane) as u32).max().unwrap_or(0);
        self.row_updates += lanes.map(|lane| report.updates.lane(lane)).sum::<u64>();
        self.decrement = report.decrement.largest().max(0.0);
    }
}
