//! `Sim`: one model, one state (or a lane register of states), and its working space.

use crate::room::{room, Room};
use std::sync::Arc;

use crate::commit::Next;
use crate::detect::Detected;
use crate::elements::{Element, Kind};
use crate::error::{Error, Result};
use crate::model::Model;
use crate::place::Placed;
use crate::real::{Mask, Real};
use crate::settings::{Acceleration, Law, Settings, Solver, Sweeps};
use crate::solve::{Limits, Newton, Pgs, Report, Rows};
use crate::state::{Inputs, State};
use crate::watch::ledger::{Ledger, Tape};
use crate::watch::Past;

/// How the last solve went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Effort {
    /// Sweeps or Newton iterations of the last solve (the most of any island and lane).
    pub sweeps: u32,
    /// Row updates since the start, over all lanes together.
    pub row_updates: u64,
    /// Newton's last decrement, relative; 0 under PGS.
    pub decrement: f64,
}

/// One world, or a register of worlds side by side. `step.rs` steps it.
pub struct Sim<R: Real> {
    pub model: Arc<Model>,
    pub settings: Settings,
    pub state: State<R>,
    pub inputs: Inputs<R>,
    /// What each stage wrote when it last ran.
    pub placed: Placed<R>,
    pub detected: Detected<R>,
    pub rows: Rows<R>,
    /// v⁺ of the last solve, and (v⁺ − v)/dt.
    pub velocity: Vec<R>,
    pub qacc: Vec<R>,
    pub effort: Effort,
    pub(crate) next: Next<R>,
    pub(crate) past: Past<R>,
    /// There while `Settings::ledger` is on.
    pub(crate) ledger: Option<Box<Ledger<R>>>,
    /// Lanes (bits) that only repeat another, whose failures are told there.
    pub(crate) copies: u64,
    /// There while a step is written down.
    pub(crate) tape: Option<Box<Tape>>,
    pgs: Pgs<R>,
    newton: Newton<R>,
}

room!(Sim<R>: velocity, qacc; state, inputs, placed, detected, rows, next, past, pgs, newton);

impl<R: Real> Sim<R> {
    /// A world at qpos0 and at rest; refuses settings outside their limits.
    pub fn new(model: Arc<Model>, settings: Settings) -> Result<Self> {
        settings.check()?;
        check_masses::<R>(&model, settings.solver)?;
        Ok(Self {
            state: State::new(&model),
            inputs: Inputs::new(&model),
            placed: Placed::new(&model),
            detected: Detected::new(settings.max_contacts),
            rows: Rows::new(&model),
            velocity: vec![R::zero(); model.nv],
            qacc: vec![R::zero(); model.nv],
            effort: Effort::default(),
            next: Next::new(&model),
            pgs: Pgs::new(),
            newton: Newton::new(),
            past: Past::new(&model),
            ledger: settings.ledger.then(|| Box::new(Ledger::new(&model))),
            copies: 0,
            tape: None,
            model,
            settings,
        })
    }

    /// Solves the rows that were made, from the last step's impulses if they are kept.
    pub(crate) fn solve(&mut self) -> Result<()> {
        let (model, inv_d) = (&*self.model, &self.placed.metric.inv_d);
        if self.settings.warm_start {
            let last = if self.next.stage > 0 { &self.next.warm } else { &self.state.warm };
            self.rows.warm_start(model, inv_d, last);
        }
        let sweeps = self.settings.sweeps.limit();
        let limits = Limits {
            sweeps,
            tolerance: self.settings.tolerance,
            // By the law and not by the rows at hand, so that a lane equals its world alone.
            momentum: self.settings.acceleration == Acceleration::Momentum
                && !self.settings.law.on_guess(),
            exact: sweeps > 0 && self.settings.tolerance > 0.0 && self.settings.law != Law::Relaxed,
            rounding: self.settings.sweeps == Sweeps::Auto,
        };
        // One row on its own, and one update all that is asked or all that it takes.
        if self.settings.solver == Solver::Pgs && (limits.sweeps == 1 || limits.exact) {
            if let Some(report) = self.rows.solve_single(&model.dof_lists, inv_d) {
                self.effort.note(&report);
                return Ok(());
            }
        }
        let report = match self.settings.solver {
            Solver::Pgs => self.pgs.solve(&model.dof_lists, inv_d, &mut self.rows, limits),
            Solver::Newton => {
                let guess = &self.placed.guess;
                self.newton.solve(&model.dof_lists, inv_d, guess, &mut self.rows, limits)?
            }
        };
        self.effort.note(&report);
        let swept = self.settings.solver == Solver::Pgs && self.settings.tolerance > 0.0;
        if R::DIFFERENTIATES && swept && report.open.none() {
            self.settle(limits)?;
        }
        Ok(())
    }

    /// Derivatives of what PGS solved to its tolerance: a sweep moves them as it moves the
    /// numbers, but from farther away. Soft convex rows have a minimiser, which Newton's method
    /// differentiates; others are swept on.
    fn settle(&mut self, limits: Limits) -> Result<()> {
        let (dof_lists, found) = (&self.model.dof_lists, self.rows.u.clone());
        let impulses: Vec<R> = self.rows.rows.iter().map(|row| row.impulse).collect();
        let soft = self.rows.rows.iter().all(|row| row.c.gt(R::zero()).all());
        if self.settings.law.on_guess() || !soft {
            self.pgs.settle(dof_lists, &mut self.rows);
        } else {
            let (inv_d, guess) = (&self.placed.metric.inv_d, &self.placed.guess);
            self.newton.solve(dof_lists, inv_d, guess, &mut self.rows, limits)?;
        }
        let settled = self.rows.rows.iter_mut().map(|row| &mut row.impulse);
        let settled = self.rows.u.iter_mut().chain(settled);
        for (settled, found) in settled.zip(found.into_iter().chain(impulses)) {
            *settled = found.smooth(R::Mask::of(true), || *settled);
        }
        Ok(())
    }

    /// Memory of the state and of all working space [bytes]; the model is not in it.
    pub fn bytes(&self) -> usize {
        let ledger = self.ledger.as_ref();
        let ledger = ledger.map_or(0, |ledger| size_of::<Ledger<R>>() + ledger.room());
        size_of::<Self>() + self.room() + ledger
    }

    /// A lane that stands for a world of its own.
    pub(crate) fn is_world(&self, lane: usize) -> bool {
        self.copies >> lane & 1 == 0
    }

    /// The worst miss of the last solve, a speed [m/s]; 0 without rows.
    pub fn residual(&self) -> R {
        self.rows.residual(&self.model.dof_lists)
    }
}

/// The precision that computes must hold every mass and its inverse, and for Newton,
/// whose costs are energies of impulses, their squares.
fn check_masses<R: Real>(model: &Model, solver: Solver) -> Result<()> {
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
                "such that the precision can hold it and its inverse (under newton, their squares)";
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
    /// A step without rows takes none.
    pub(crate) fn rest(&mut self) {
        (self.sweeps, self.decrement) = (0, 0.0);
    }

    fn note<R: Real>(&mut self, report: &Report<R>) {
        let lanes = 0..R::LANES;
        self.sweeps = lanes.clone().map(|lane| report.sweeps.lane(lane) as u32).max().unwrap_or(0);
        self.row_updates += lanes.clone().map(|lane| report.updates.lane(lane) as u64).sum::<u64>();
        self.decrement = lanes.map(|lane| report.decrement.lane(lane)).fold(0.0, f64::max);
    }
}
