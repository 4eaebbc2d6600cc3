//! One world of either precision behind one interface: the content of `Sim` in Python.

use std::collections::BTreeMap;
use std::sync::Arc;

use stepcore::arrays::{lists, Array, ArraySet, Given};
use stepcore::batch::{Last, Motion};
use stepcore::elements::Element;
use stepcore::error::Result;
use stepcore::model::Model;
use stepcore::real::Real;
use stepcore::scene::Sensor;
use stepcore::sensors::Reading;
use stepcore::settings::{Precision, Settings};
use stepcore::sim::{Effort, Sim};
use stepcore::warm::Sleep;
use stepcore::watch::{
    Counter, Coupling, ElementSlopes, LastSolve, Linearizer, Neighbourhood, RayFilter, StepGains,
    Watched,
};

use crate::memo::{put_memo, warm_of, Memo, Solve};
use crate::readings::{self, flat, numbers, Rays, TendonPath};

/// Quantities of the present state.
#[derive(Clone, Copy)]
pub enum Placed {
    BodyPos,
    BodyQuat,
    BodyMat,
    GeomPos,
    GeomMat,
    SitePos,
    ActuatorLength,
    ActuatorVelocity,
    TendonLength,
    TendonVelocity,
    TendonJacobian,
    TendonForce,
    SiteMat,
    SubtreeCom,
    /// As in `Bodies`.
    Inertias,
    Velocities,
    MassMatrix,
    Bias,
    Passive,
    Energy,
    Momentum,
    Overlap,
    Jacobian(usize),
    SiteJacobian(usize),
    /// For the point of a body that is here in the world.
    PointJacobian(usize, [f64; 3]),
}

/// Quantities of bodies in the last solve.
#[derive(Clone, Copy)]
pub enum BodyForce {
    External,
    Internal,
    Acceleration,
}

/// Quantities of the last solve.
#[derive(Clone, Copy)]
pub enum Solved {
    Acceleration,
    ConstraintForce,
    ActuatorForce,
}

/// Contacts of the last solve: two geoms, and dist, pos, normal, force (10 numbers) each.
#[derive(Default)]
pub struct Contacts {
    pub elements: Vec<Element>,
    pub geoms: Vec<(usize, usize)>,
    pub numbers: Vec<f64>,
}

/// Rows of the last solve: element, its name, block, and 7 numbers each: impulse, velocity,
/// target, regulariser, residual, lo, hi.
#[derive(Default)]
pub struct Rows {
    pub elements: Vec<Element>,
    pub names: Vec<String>,
    pub blocks: Vec<usize>,
    pub numbers: Vec<f64>,
}

pub trait World: Send {
    fn check(&self, given: &Given) -> Result<()>;
    /// Checks some arrays and copies them in.
    fn load(&mut self, given: &Given, some: ArraySet) -> Result<()>;
    fn put(&mut self, given: &Given);
    fn take(&self, array: Array, out: &mut [f64]);
    /// Lets this many threads share the work of each step.
    fn use_threads(&mut self, threads: usize) -> Result<()>;
    fn step(&mut self, n: u64) -> Result<()>;
    /// Steps `from..from + n` of a motion.
    fn follow(&mut self, motion: &mut Motion, from: usize, n: usize) -> Result<()>;
    /// Ends a call of this many steps: balances the ledger if they are enough.
    fn balance_at_end(&mut self, n: u64) -> Result<()>;
    fn forward(&mut self) -> Result<()>;
    /// Puts the state where a step from here evaluates its forces last.
    fn go_to_last_stage(&mut self) -> Result<()>;
    /// A warning about energies, given once; see `Watched::take_warning`.
    fn take_warning(&mut self) -> Option<String>;
    /// Stops checking energies, except in the ledger of the settings.
    fn unwatch(&mut self);
    /// Steps once, and returns the energy that each element injected.
    fn taped_step(&mut self) -> Result<StepGains>;
    /// Time of the state, and time step [s].
    fn time(&self) -> f64;
    fn dt(&self) -> f64;
    fn settings(&self) -> &Settings;
    fn memo(&self) -> Memo;
    fn set_memo(&mut self, memo: &Memo);
    fn placed(&mut self, given: &Given, what: Placed) -> Result<Vec<f64>>;
    fn solved(&mut self, what: Solved) -> Vec<f64>;
    /// Records that the present state did not come from a solve: the last one is read there.
    fn unsolved(&mut self);
    /// The initial state and inputs of the last solve.
    fn last(&self) -> Option<Solve>;
    /// Sets the start of the last solve; it is repeated when something of it is read.
    fn set_last(&mut self, last: Option<&Solve>);
    /// Makes the last solve one at the present state, to be done when something of it is read.
    fn stayed(&mut self);
    /// Keeps the last solve for reading, because the following operation is none.
    fn keep_solve(&mut self);
    /// 6 numbers for each body, at the last solve or, before there was one, at the present state.
    fn body_force(&mut self, given: &Given, what: BodyForce) -> Result<Vec<f64>>;
    /// A sensor's values, or all sensors', at the same state.
    fn sensordata(&mut self, given: &Given, sensor: Option<usize>) -> Result<Vec<f64>>;
    /// Inverse dynamics at the present state; by default for the acceleration of the last solve.
    fn inverse(&mut self, given: &Given, qacc: Option<&[f64]>) -> Result<Vec<f64>>;
    /// Casts rays through the present state: origin and direction, 6 numbers for each ray.
    fn rays(&mut self, given: &Given, rays: &[f64], filter: &RayFilter) -> Result<Rays>;
    /// The paths of all tendons.
    fn tendon_paths(&mut self, given: &Given) -> Result<Vec<TendonPath>>;
    fn contacts(&mut self) -> Contacts;
    /// The generalised force of every element that pushes, at the state of the last solve.
    fn element_forces(&mut self, given: &Given) -> Result<BTreeMap<Element, Vec<f64>>>;
    fn rows(&mut self) -> Rows;
    fn coupling(&mut self) -> Coupling;
    fn residual(&mut self) -> f64;
    /// The overlap that `max_recovery_speed` left in the last solve.
    fn unrecovered(&mut self) -> f64;
    fn effort(&mut self) -> Effort;
    /// The reason why adaptive steps are slow.
    fn slow(&self) -> Option<String>;
    /// For each body: whether it sleeps.
    fn asleep(&self) -> Vec<bool>;
    /// The sleeping trees at the start.
    fn initial_sleep(&self) -> Sleep<f64>;
    /// The number of times the list of contacts had to grow.
    fn grown(&self) -> u64;
    /// Prepares a linearisation at the present state; `keep` it after use.
    fn linearizer(&mut self, of: &Arc<Neighbourhood>) -> Result<Linearizer>;
    fn keep(&mut self, linearizer: Linearizer);
    fn element_slopes(&mut self) -> Result<ElementSlopes>;
    fn counter(&mut self) -> Result<Counter>;
    fn bytes(&self) -> usize;
}

/// A world in the precision of the settings.
pub fn world(model: Arc<Model>, settings: &Settings) -> Result<Box<dyn World>> {
    Ok(match settings.precision {
        Precision::F64 => Box::new(One::<f64>::new(model, settings)?),
        Precision::F32 => Box::new(One::<f32>::new(model, settings)?),
    })
}

struct One<R: Real> {
    watched: Watched<R>,
    /// Readings are computed there, so that they leave the last solve as it is.
    last: LastSolve<R>,
    /// The call to which that solve belonged.
    of: Last,
    /// Whether it is in no `Sim` yet, except for its acceleration.
    unmade: bool,
    /// The last one.
    linearizer: Option<Linearizer>,
}

impl<R: Real> One<R> {
    fn new(model: Arc<Model>, settings: &Settings) -> Result<Self> {
        let watched = Watched::<R>::new(model, settings.clone())?;
        let last = LastSolve::new(&watched.sim);
        Ok(Self { watched, last, of: Last::Nothing, unmade: false, linearizer: None })
    }

    fn sim(&self) -> &Sim<R> {
        &self.watched.sim
    }

    /// The `Sim` with its last solve.
    fn made(&mut self) -> &Sim<R> {
        if std::mem::take(&mut self.unmade) {
            self.last.make_again(&mut self.watched.sim, self.of == Last::Step);
        }
        self.sim()
    }

    /// Makes the present solve the last one.
    fn solves(&mut self, of: Last) {
        (self.of, self.unmade) = (of, false);
    }

    /// Records the outcome: an error ended in a solve at the state that it left.
    fn noted<T>(&mut self, outcome: Result<T>) -> Result<T> {
        if outcome.is_err() {
            self.stayed();
        }
        outcome
    }

    /// Records that this many steps were taken.
    fn stepped(&mut self, n: u64, mut outcome: Result<()>) -> Result<()> {
        if n > 0 && self.sim().settings().accuracy.0.is_some() {
            // The last solve belongs to a part of a step: readings are for the state.
            outcome = outcome.and_then(|()| self.watched.forward());
            self.stayed();
        }
        self.noted(outcome)
    }

    /// A `Sim` at the present state.
    fn present(&mut self, given: &Given) -> Result<&mut Sim<R>> {
        self.check(given)?;
        self.last.present(&self.watched.sim, given)
    }

    /// Lets `read` see a `Sim` that has solved where this one last did.
    fn solved<T>(&mut self, given: &Given, read: impl FnOnce(&mut Sim<R>) -> T) -> Result<T> {
        self.last.read(&mut self.watched.sim, given, true, read)
    }
}

impl<R: Real> World for One<R> {
    fn check(&self, given: &Given) -> Result<()> {
        given.check::<R>(self.sim().model(), None)
    }
    fn load(&mut self, given: &Given, some: ArraySet) -> Result<()> {
        given.check_some::<R>(self.sim().model(), some, None)?;
        self.watched.put(0, given, some);
        Ok(())
    }
    fn put(&mut self, given: &Given) {
        self.watched.put(0, given, ArraySet::ALL);
    }
    fn take(&self, array: Array, out: &mut [f64]) {
        self.sim().state.take(0, array, out);
    }
    fn use_threads(&mut self, threads: usize) -> Result<()> {
        self.watched.sim.use_threads(threads)
    }
    fn step(&mut self, n: u64) -> Result<()> {
        if n > 0 {
            self.solves(Last::Step);
            self.last.stepped();
        }
        let outcome = self.watched.step(n);
        self.stepped(n, outcome)
    }
    fn follow(&mut self, motion: &mut Motion, from: usize, n: usize) -> Result<()> {
        if n > 0 {
            self.solves(Last::Step);
            self.last.stepped();
        }
        let outcome = motion.alone(&mut self.watched, from, n);
        self.stepped(n as u64, outcome)
    }
    fn balance_at_end(&mut self, n: u64) -> Result<()> {
        let outcome = self.watched.balance_at_end(n);
        self.noted(outcome)
    }
    fn forward(&mut self) -> Result<()> {
        self.solves(Last::Forward);
        self.last.solved();
        let outcome = self.watched.forward();
        self.noted(outcome)
    }
    fn go_to_last_stage(&mut self) -> Result<()> {
        let outcome = self.watched.go_to_last_stage();
        self.unsolved();
        outcome
    }
    fn take_warning(&mut self) -> Option<String> {
        self.watched.take_warning()
    }
    fn unwatch(&mut self) {
        self.watched.unwatch();
    }
    fn taped_step(&mut self) -> Result<StepGains> {
        let outcome = self.watched.taped_step(0);
        if outcome.is_ok() {
            // Energies were summed up after it.
            self.solves(Last::Step);
            self.last.stepped();
            self.keep_solve();
        }
        self.noted(outcome)
    }
    fn time(&self) -> f64 {
        self.sim().time()
    }
    fn dt(&self) -> f64 {
        self.sim().period()
    }
    fn settings(&self) -> &Settings {
        self.sim().settings()
    }
    fn memo(&self) -> Memo {
        Memo::of(&self.sim().state, 0)
    }
    fn set_memo(&mut self, memo: &Memo) {
        self.keep_solve();
        let state = &mut self.watched.sim.state;
        (state.start, state.steps) = (memo.start, memo.steps);
        state.sleep = memo.sleep.cast();
        let warm = warm_of(memo);
        self.watched.put_impulses(warm);
    }

    fn placed(&mut self, given: &Given, what: Placed) -> Result<Vec<f64>> {
        readings::placed(self.present(given)?, what)
    }

    fn solved(&mut self, what: Solved) -> Vec<f64> {
        match what {
            Solved::Acceleration => numbers(&self.sim().qacc),
            Solved::ConstraintForce => self.made().constraint_force(0),
            Solved::ActuatorForce => numbers(&self.made().placed.actuator),
        }
    }

    fn unsolved(&mut self) {
        self.solves(Last::Nothing);
        self.last.forget();
        self.watched.sim.clear_solve();
    }
    fn last(&self) -> Option<Solve> {
        let (state, inputs) = self.last.begun(self.sim())?;
        let (lists, memo) = (lists(&state, &inputs, 0), Memo::of(&state, 0));
        Some(Solve { of: self.of, qacc: numbers(&self.sim().qacc), lists, memo })
    }
    fn set_last(&mut self, last: Option<&Solve>) {
        self.unsolved();
        let Some(last) = last else { return };
        self.last.begin(&last.given(), |state| {
            put_memo(state, &last.memo);
            (state.start, state.steps) = (last.memo.start, last.memo.steps);
        });
        self.solves(last.of);
        self.unmade = true;
        let qacc = &mut self.watched.sim.qacc;
        qacc.iter_mut().zip(&last.qacc).for_each(|(to, from)| *to = R::of(*from));
    }
    fn stayed(&mut self) {
        self.solves(Last::Forward);
        self.last.stayed(&self.watched.sim);
    }
    fn keep_solve(&mut self) {
        self.last.keep(&self.watched.sim);
    }

    fn body_force(&mut self, given: &Given, what: BodyForce) -> Result<Vec<f64>> {
        self.solved(given, |sim| {
            let bodies = sim.bodies(0);
            readings::body_force(&sim.body_forces(&bodies, 0), what)
        })
    }

    fn sensordata(&mut self, given: &Given, sensor: Option<usize>) -> Result<Vec<f64>> {
        let model = self.sim().model().clone();
        let sensors = sensor.map_or(&*model.sensors, |index| &model.sensors[index..=index]);
        let solve = sensors.iter().any(Sensor::needs_solve);
        let mut values = Vec::new();
        if !model.features.sensor || sensors.is_empty() {
            values.resize(sensors.iter().map(Sensor::size).sum(), 0.0);
            return Ok(values);
        }
        self.last.read(&mut self.watched.sim, given, solve, |sim| {
            let mut reading = Reading::new(sim, 0);
            sensors.iter().for_each(|sensor| reading.read(sensor, &mut values));
        })?;
        Ok(values)
    }

    fn inverse(&mut self, given: &Given, qacc: Option<&[f64]>) -> Result<Vec<f64>> {
        let own = numbers(&self.sim().qacc);
        let sim = self.present(given)?;
        sim.forward()?;
        sim.inverse(qacc.unwrap_or(&own), 0)
    }

    fn rays(&mut self, given: &Given, rays: &[f64], filter: &RayFilter) -> Result<Rays> {
        Ok(readings::rays(self.present(given)?, rays, filter))
    }

    fn tendon_paths(&mut self, given: &Given) -> Result<Vec<TendonPath>> {
        Ok(readings::tendon_paths(self.present(given)?))
    }

    fn element_forces(&mut self, given: &Given) -> Result<BTreeMap<Element, Vec<f64>>> {
        self.solved(given, |sim| sim.element_forces(0))
    }

    fn contacts(&mut self) -> Contacts {
        let (sim, mut table) = (self.made(), Contacts::default());
        for (_, contact) in sim.live_contacts(0) {
            let pair = &contact.pair;
            let element = contact.element();
            table.elements.push(element);
            table.geoms.push((pair.geom1, pair.geom2));
            table.numbers.push(contact.dist.lane(0));
            table.numbers.extend(flat(&contact.pos));
            table.numbers.extend(flat(&contact.normal));
            table.numbers.extend(sim.contact_wrench(contact, 0));
        }
        table
    }

    fn rows(&mut self) -> Rows {
        let (sim, mut table) = (self.made(), Rows::default());
        let residuals: Vec<Vec<f64>> =
            sim.rows.blocks.iter().map(|block| sim.row_residuals(block, 0)).collect();
        let mut within = 0;
        for (index, row) in sim.live_rows(0) {
            within = if table.blocks.last() == Some(&index) { within + 1 } else { 0 };
            let element = sim.rows.blocks[index].element;
            table.elements.push(element);
            table.names.push(sim.model().element_name(element));
            table.blocks.push(index);
            let residual = residuals[index].get(within).copied().unwrap_or(0.0);
            let scale = sim.scale_of_row(&sim.rows.blocks[index], within, 0);
            let [impulse, velocity, t, c] =
                [row.total(), row.velocity, row.t, row.c].map(|x| x.lane(0));
            let moved = [impulse * scale, velocity / scale, t / scale, c / (scale * scale)];
            table.numbers.extend(moved);
            table.numbers.extend([residual / scale, row.lo.lane(0), row.hi.lane(0)]);
        }
        table
    }

    fn coupling(&mut self) -> Coupling {
        self.made().coupling(0)
    }
    fn residual(&mut self) -> f64 {
        self.made().residual().lane(0)
    }
    fn unrecovered(&mut self) -> f64 {
        self.made().rows.unrecovered.lane(0)
    }
    fn effort(&mut self) -> Effort {
        self.made().effort
    }
    fn slow(&self) -> Option<String> {
        let sim = self.sim();
        sim.effort.stretches.slow(sim.period(), sim.settings().accuracy.0, sim.model())
    }
    fn asleep(&self) -> Vec<bool> {
        self.sim().asleep()
    }
    fn initial_sleep(&self) -> Sleep<f64> {
        self.sim().initial_sleep().cast()
    }
    fn grown(&self) -> u64 {
        self.sim().detected.grown
    }
    fn linearizer(&mut self, of: &Arc<Neighbourhood>) -> Result<Linearizer> {
        let kept = self.linearizer.take().map(Ok);
        let mut made = kept.unwrap_or_else(|| Linearizer::new(self.sim()))?;
        made.begin(self.sim(), of)?;
        Ok(made)
    }
    fn keep(&mut self, linearizer: Linearizer) {
        self.linearizer = Some(linearizer);
    }
    fn element_slopes(&mut self) -> Result<ElementSlopes> {
        ElementSlopes::new(self.sim())
    }
    fn counter(&mut self) -> Result<Counter> {
        Counter::new(self.sim())
    }
    fn bytes(&self) -> usize {
        self.watched.bytes() + self.linearizer.as_ref().map_or(0, Linearizer::bytes)
    }
}
