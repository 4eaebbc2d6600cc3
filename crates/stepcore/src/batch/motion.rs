//! A whole motion: steps under controls over time, and samples of the results.

use super::lane_layout::LaneLayout;
use crate::arrays::Array;
use crate::elements::{Element, Kind};
use crate::error::{Error, Fault, Result};
use crate::model::Model;
use crate::real::{Constant, Real};
use crate::spatial::V3;
use crate::watch::Watched;

/// The quantity of a world that is sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sampled {
    Array(Array),
    /// Acceleration, and forces of actuators, in the last solve; zero before there was one.
    Acceleration,
    ActuatorForce,
    /// The position of each body's frame, and its orientation.
    Position,
    Orientation,
    /// Kinetic and potential.
    Energy,
    Time,
}

impl Sampled {
    pub const ALL: [Self; 11] = [
        Self::Array(Array::Qpos),
        Self::Array(Array::Qvel),
        Self::Array(Array::Act),
        Self::Array(Array::CtrlHistory),
        Self::Array(Array::Ctrl),
        Self::Acceleration,
        Self::ActuatorForce,
        Self::Position,
        Self::Orientation,
        Self::Energy,
        Self::Time,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::Array(array) => array.name(),
            Self::Acceleration => "qacc",
            Self::ActuatorForce => "actuator_force",
            Self::Position => "xpos",
            Self::Orientation => "xquat",
            Self::Energy => "energy",
            Self::Time => "time",
        }
    }

    /// The shape for one world.
    pub fn shape<N: Constant>(self, model: &Model<N>) -> Vec<usize> {
        match self {
            Self::Array(array) => array.shape(model),
            Self::Acceleration => vec![model.nv],
            Self::ActuatorForce => vec![model.actuators.len()],
            Self::Position => vec![model.bodies.len(), 3],
            Self::Orientation => vec![model.bodies.len(), 4],
            Self::Energy => vec![2],
            Self::Time => Vec::new(),
        }
    }
}

/// Room for the samples of one quantity: world, then sample, then entry.
pub struct Record<'a> {
    pub what: Sampled,
    pub numbers: &'a mut [f64],
}

pub struct Motion<'a> {
    /// Steps from one sample to the next, and how many samples there are.
    pub every: usize,
    pub samples: usize,
    /// The first sample is of the start.
    pub first: bool,
    /// Controls: for each world, or the same for all, `rows` rows, each held for `hold` steps and
    /// the last one to the end. Without rows the present controls stay.
    pub ctrl: &'a [f64],
    pub rows: usize,
    pub hold: usize,
    /// A world stops when a body is farther from its start than this [m].
    pub bound: f64,
    /// The largest number of force evaluations of adaptive steps; a world stops there.
    pub most: u64,
    /// Initial positions of bodies, by world; as long as `Sampled::Position` if there is a bound.
    pub home: Vec<f64>,
    pub records: Vec<Record<'a>>,
    /// The number of force evaluations, by world.
    pub evaluations: Vec<u64>,
}

/// A group's part of a `Motion`: lists by lane.
pub(super) struct Part<'a> {
    every: usize,
    first: usize,
    rows: usize,
    hold: usize,
    bound: f64,
    most: u64,
    nu: usize,
    ctrl: Vec<&'a [f64]>,
    home: Vec<&'a mut [f64]>,
    records: Vec<(Sampled, usize, Vec<&'a mut [f64]>)>,
    evaluations: Vec<&'a mut u64>,
}

impl Motion<'_> {
    /// The parts of the groups.
    pub(super) fn parts<N: Constant>(
        &mut self,
        layout: &LaneLayout,
        model: &Model<N>,
    ) -> Vec<Part<'_>> {
        let worlds = layout.all().len();
        let nu = model.actuators.len();
        let size = self.rows * nu;
        let alike = self.ctrl.len() == size;
        let samples = self.samples;
        let mut evaluations: Vec<_> = self.evaluations.iter_mut().map(Some).collect();
        let mut home = by_world(&mut self.home, worlds);
        let records = self.records.iter_mut();
        let mut records: Vec<_> = records
            .map(|Record { what, numbers }| {
                (*what, numbers.len() / (worlds * samples).max(1), by_world(numbers, worlds))
            })
            .collect();
        let ctrl = self.ctrl;
        let part = |group| {
            let own = layout.worlds(group);
            let table = |world: &usize| &ctrl[if alike { 0 } else { world * size }..][..size];
            Part {
                every: self.every,
                first: usize::from(self.first),
                rows: self.rows,
                hold: self.hold,
                bound: self.bound,
                most: self.most,
                nu,
                ctrl: own.iter().map(table).collect(),
                home: own.iter().filter_map(|world| home[*world].take()).collect(),
                records: records
                    .iter_mut()
                    .map(|(what, size, lists)| {
                        (
                            *what,
                            *size,
                            own.iter().filter_map(|world| lists[*world].take()).collect(),
                        )
                    })
                    .collect(),
                evaluations: own.iter().filter_map(|world| evaluations[*world].take()).collect(),
            }
        };
        (0..layout.groups()).map(part).collect()
    }

    /// Steps `from..from + n` of the only world.
    pub fn alone<R: Real>(
        &mut self,
        watched: &mut Watched<R>,
        from: usize,
        n: usize,
    ) -> Result<()> {
        let layout = LaneLayout::new(1, &[0], &[0]);
        let model = watched.sim.model().clone();
        let mut parts = self.parts(&layout, &model);
        (from..from + n).try_for_each(|step| parts[0].step(step, step == from, watched))
    }

    /// The place of a sample that is taken after this many steps, if there is one.
    fn sample_after(&self, steps: usize) -> usize {
        steps / self.every + usize::from(self.first) - 1
    }

    /// From this step on, repeats a failed world's arrays in its samples; the other sampled
    /// quantities are unknown.
    pub(super) fn stand(&mut self, world: usize, failed: &[Vec<f64>], done: usize, end: usize) {
        let steps = (done / self.every + 1) * self.every;
        let samples = self.samples;
        let first = self.sample_after(steps);
        let last = if end < steps { first } else { self.sample_after(end) + 1 };
        for Record { what, numbers } in &mut self.records {
            let worlds = self.evaluations.len();
            let size = numbers.len() / (worlds * samples).max(1);
            for at in first..last {
                let own = &mut numbers[(world * samples + at) * size..][..size];
                match what {
                    Sampled::Array(array) if (*array as usize) < Array::CHANGED => {
                        own.copy_from_slice(&failed[*array as usize]);
                    }
                    Sampled::Array(_) => (),
                    _ => own.fill(f64::NAN),
                }
            }
        }
    }
}

impl Part<'_> {
    /// One step, under its controls, and a sample if one follows; `begins`: a call starts with it.
    pub fn step<R: Real>(
        &mut self,
        step: usize,
        begins: bool,
        watched: &mut Watched<R>,
    ) -> Result<()> {
        if self.rows > 0 && (begins || step.is_multiple_of(self.hold)) {
            self.control(self.row(step), watched);
        }
        let before = watched.sim.effort.evaluations;
        let so_far = self.evaluations.first().map_or(0, |count| **count);
        watched.sim.most = self.most.saturating_sub(so_far).saturating_add(before);
        let stepped = watched.step(1);
        watched.sim.most = u64::MAX;
        let more = watched.sim.effort.evaluations - before;
        self.evaluations.iter_mut().for_each(|count| **count += more);
        stepped?;
        if (step + 1).is_multiple_of(self.every) {
            let row = (self.rows > 0).then(|| self.row(step));
            self.sample((step + 1) / self.every - 1 + self.first, true, row, watched)?;
        }
        Ok(())
    }

    /// The row of controls of a step.
    fn row(&self, step: usize) -> usize {
        (step / self.hold).min(self.rows - 1)
    }

    /// Sets a row of controls; lanes without a world repeat another.
    fn control<R: Real>(&self, row: usize, watched: &mut Watched<R>) {
        let own = (0..R::LANES).find(|lane| watched.is_world(*lane)).unwrap_or(0);
        for lane in 0..R::LANES {
            let world = if watched.is_world(lane) { lane.min(self.ctrl.len() - 1) } else { own };
            let from = &self.ctrl[world][row * self.nu..][..self.nu];
            for (to, from) in watched.sim.inputs.ctrl.iter_mut().zip(from) {
                to.set_lane(lane, *from);
            }
        }
    }

    /// The first sample: at the start, before anything was solved.
    pub fn begin<R: Real>(&mut self, watched: &mut Watched<R>) -> Result<()> {
        self.sample(0, false, None, watched)?;
        if self.bounded() {
            let second = watched.second()?;
            second.place_poses();
            for (lane, home) in self.home.iter_mut().enumerate() {
                put_poses(&second.placed.xpos, lane, home);
            }
        }
        Ok(())
    }

    /// `solved`: there was a step; row: the controls of that step.
    fn sample<R: Real>(
        &mut self,
        at: usize,
        solved: bool,
        row: Option<usize>,
        watched: &mut Watched<R>,
    ) -> Result<()> {
        let any = |what| self.records.iter().any(|(own, ..)| *own == what);
        let mut energy = None;
        if any(Sampled::Energy) {
            energy = Some(watched.second()?.energy());
        } else if any(Sampled::Position) || any(Sampled::Orientation) || self.bounded() {
            watched.second()?.place_poses();
        }
        for (what, size, lists) in &mut self.records {
            for (lane, list) in lists.iter_mut().enumerate() {
                let out = &mut list[at * *size..][..*size];
                let sim = &watched.sim;
                match *what {
                    Sampled::Array(Array::Ctrl) => match row {
                        // As they were given, in any precision.
                        Some(row) => {
                            out.copy_from_slice(&self.ctrl[lane][row * self.nu..][..self.nu])
                        }
                        None => put(&sim.inputs.ctrl, lane, out),
                    },
                    Sampled::Array(array) => sim.state.take(lane, array, out),
                    Sampled::Acceleration | Sampled::ActuatorForce if !solved => (),
                    Sampled::Acceleration => put(&sim.qacc, lane, out),
                    Sampled::ActuatorForce => put(&sim.placed.actuator, lane, out),
                    Sampled::Time => out[0] = sim.time(),
                    Sampled::Position => put_poses(&watched.placed().xpos, lane, out),
                    Sampled::Orientation => {
                        for (to, q) in out.chunks_exact_mut(4).zip(&watched.placed().xquat) {
                            let q = [q.w, q.v.x, q.v.y, q.v.z];
                            to.iter_mut().zip(q).for_each(|(to, x)| *to = x.lane(lane));
                        }
                    }
                    Sampled::Energy => {
                        let both = energy.as_ref().map(|energy| [energy.kinetic, energy.potential]);
                        out.iter_mut()
                            .zip(both.iter().flatten())
                            .for_each(|(to, x)| *to = x.lane(lane));
                    }
                }
            }
        }
        Ok(())
    }

    fn bounded(&self) -> bool {
        self.bound.is_finite()
    }

    /// Refuses a world with a body too far from its start, at a sample that was just taken.
    pub fn check<R: Real>(&self, step: usize, watched: &Watched<R>) -> Result<()> {
        if !(self.bounded() && (step + 1).is_multiple_of(self.every)) {
            return Ok(());
        }
        let sim = &watched.sim;
        for (lane, home) in self.home.iter().enumerate() {
            if !watched.is_world(lane) {
                continue;
            }
            let way = |(at, home): (&V3<R>, &[f64])| {
                let own = [at.x, at.y, at.z].map(|x| x.lane(lane));
                (0..3).map(|k| (own[k] - home[k]).powi(2)).sum::<f64>().sqrt()
            };
            let ways = watched.placed().xpos.iter().zip(home.chunks_exact(3)).map(way);
            let furthest = ways.enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
            if let Some((body, far)) = furthest.filter(|(_, far)| *far > self.bound) {
                let body = sim.model_of(lane).named(Element::whole(Kind::Body, body));
                let fault = Fault::Far { body, far, bound: self.bound };
                return Err(Error::Diverged(Box::new(sim.divergence(lane, fault))));
            }
        }
        Ok(())
    }
}

fn put<R: Real>(from: &[R], lane: usize, to: &mut [f64]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to = from.lane(lane));
}

fn put_poses<R: Real>(from: &[V3<R>], lane: usize, to: &mut [f64]) {
    for (to, from) in to.chunks_exact_mut(3).zip(from) {
        to.iter_mut().zip([from.x, from.y, from.z]).for_each(|(to, x)| *to = x.lane(lane));
    }
}

/// Equal parts of a list, to be taken one by one.
fn by_world(all: &mut [f64], worlds: usize) -> Vec<Option<&mut [f64]>> {
    let size = all.len() / worlds;
    let mut left = all;
    let mut parts = Vec::with_capacity(worlds);
    for _ in 0..worlds {
        let (own, rest) = left.split_at_mut(size);
        parts.push(Some(own));
        left = rest;
    }
    parts
}
