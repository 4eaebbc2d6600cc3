//! The threads of a batch, which live as long as it does, and the working spaces of its models.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use super::group::Group;
use super::lane_layout::LaneLayout;
use crate::error::Result;
use crate::model::memory::check_spaces;
use crate::model::{Model, SideBySide};
use crate::pool::{lock, Pool};
use crate::real::Real;
use crate::settings::{Settings, Solver};
use crate::sim::{check_masses, Sim};
use crate::warm::Sleep;
use crate::watch::Watched;

/// Work of a call below which waking threads costs more than they save [ns].
const WORTH_WAKING: u64 = 60_000;
/// The number of portions of groups for each thread, so that all end together.
const PORTIONS: usize = 16;

pub(super) struct Workers<R: Real> {
    pool: Option<Arc<Pool>>,
    /// At most as many as can have work.
    pub threads: usize,
    solver: Solver,
    /// By kind of models: the spaces that no thread is using.
    spaces: Vec<Mutex<Vec<Watched<R>>>>,
    /// The duration of a step of all groups when it was last measured [ns].
    cost: AtomicU64,
}

impl<R: Real> Workers<R> {
    pub fn new(
        models: &[SideBySide<R>],
        settings: &Settings,
        layout: &LaneLayout,
        worlds: usize,
        threads: usize,
    ) -> Result<Self> {
        let threads = threads.min(layout.groups());
        let kinds = 1 + layout.kind(layout.groups() - 1);
        // By kind: the first group, and how many there are.
        let mut groups = vec![(0, 0); kinds];
        for group in (0..layout.groups()).rev() {
            let (first, count) = &mut groups[layout.kind(group)];
            (*first, *count) = (group, *count + 1);
        }
        for (first, count) in groups.iter().filter(|(_, count)| *count > 0) {
            let model = models[*first].first();
            let spaces = R::LANES * threads.min(*count);
            check_spaces(model, settings, spaces, "threads × lanes")?;
        }
        let space = |group: usize| {
            let sim = Sim::side_by_side(models[group].clone(), settings.clone())?;
            Ok(Watched::around(sim).among(worlds))
        };
        let spaces = groups.into_iter().map(|(first, count)| {
            let own = (0..threads.min(count)).map(|_| space(first));
            Ok(Mutex::new(own.collect::<Result<Vec<_>>>()?))
        });
        let spaces = spaces.collect::<Result<Vec<_>>>()?;
        let cost = AtomicU64::new(u64::MAX);
        Ok(Self { pool: Pool::new(threads)?, threads, solver: settings.solver, spaces, cost })
    }

    /// Whether worlds of this model can be stepped.
    pub fn takes(&self, model: &Model) -> bool {
        check_masses::<R>(model, self.solver).is_ok()
    }

    /// The sleeping trees in a new world of a kind of models.
    pub fn initial_sleep(&self, kind: usize) -> Arc<Sleep<R>> {
        let space =
            |own: &Vec<Watched<R>>| own.first().map(|space| space.sim.initial_sleep().clone());
        space(&lock(&self.spaces[kind])).unwrap_or_default()
    }

    /// Memory of the working spaces [bytes].
    pub fn bytes(&self) -> usize {
        let spaces = self.spaces.iter().flat_map(|own| {
            let own = lock(own);
            own.iter().map(Watched::bytes).collect::<Vec<_>>()
        });
        spaces.sum()
    }

    /// Does the work on every group; `steps` is its amount. A group's computation depends on
    /// nothing else, so no bit depends on the thread that does it.
    pub fn share(
        &self,
        groups: &mut [Group<R>],
        steps: u64,
        work: impl Fn(&mut Workspace<R>, usize, &mut Group<R>) + Sync,
    ) {
        let started = Instant::now();
        let portion = groups.len().div_ceil(self.threads * PORTIONS).max(1);
        let left = Mutex::new(groups.chunks_mut(portion).enumerate());
        let take_all = |_: usize| {
            let mut workspace = Workspace { workers: self, held: None };
            loop {
                // The lock is open again before the work starts.
                let next = lock(&left).next();
                let Some((index, portion_of_groups)) = next else { return };
                for (k, group) in portion_of_groups.iter_mut().enumerate() {
                    work(&mut workspace, index * portion + k, group);
                }
            }
        };
        let expected = self.cost.load(Ordering::Relaxed).saturating_mul(steps);
        match &self.pool {
            Some(pool) if expected > WORTH_WAKING => pool.share(self.threads, &take_all),
            _ => take_all(0),
        }
        if let Some(took) = (started.elapsed().as_nanos() as u64).checked_div(steps) {
            let threads = if expected > WORTH_WAKING { self.threads as u64 } else { 1 };
            self.cost.store(took.saturating_mul(threads), Ordering::Relaxed);
        }
    }
}

/// The number of worlds below which waking threads costs more than copying all arrays in one.
const WORTH_CARRYING: usize = 1024;

impl<R: Real> Workers<R> {
    /// Lets `work` go through items, this many for each unit, in portions: for work of little time
    /// per world, without a working space. It receives the unit at which each portion starts.
    pub fn transfer<T: Send>(
        &self,
        worlds: usize,
        items: &mut [T],
        unit: usize,
        work: impl Fn(usize, &mut [T]) + Sync,
    ) {
        if unit == 0 {
            return;
        }
        let units = (items.len() / unit).div_ceil(self.threads * PORTIONS).max(1);
        let left = Mutex::new(items.chunks_mut(units * unit).enumerate());
        let take_all = |_: usize| loop {
            // The lock is open again before the work starts.
            let next = lock(&left).next();
            let Some((portion, own)) = next else { return };
            work(portion * units, own);
        };
        match &self.pool {
            Some(pool) if worlds >= WORTH_CARRYING => pool.share(self.threads, &take_all),
            _ => take_all(0),
        }
    }
}

/// The working space of a thread: the space of one kind of models at a time, which is returned to
/// the others when the thread is done with it.
pub(super) struct Workspace<'a, R: Real> {
    workers: &'a Workers<R>,
    held: Option<(usize, Watched<R>)>,
}

impl<R: Real> Workspace<'_, R> {
    /// The space of a kind of models.
    pub fn space(&mut self, kind: usize) -> &mut Watched<R> {
        if self.held.as_ref().is_none_or(|(held, _)| *held != kind) {
            self.put_back();
            // There is one for every thread, or for every group of the kind.
            self.held = lock(&self.workers.spaces[kind]).pop().map(|space| (kind, space));
        }
        match &mut self.held {
            Some((_, space)) => space,
            None => unreachable!("a space for every thread"),
        }
    }

    fn put_back(&mut self) {
        if let Some((kind, space)) = self.held.take() {
            lock(&self.workers.spaces[kind]).push(space);
        }
    }
}

impl<R: Real> Drop for Workspace<'_, R> {
    fn drop(&mut self) {
        self.put_back();
    }
}
