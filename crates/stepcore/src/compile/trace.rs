//! A step written down: which operations it is, for a model and its settings.

use num_traits::Zero;
use std::collections::HashMap;
use std::sync::Arc;

use super::handed::{Handed, HandedList};
use super::list::List;
use super::pairs::TakesAside;
use super::rows::{goes_by_lane, HandsOver};
use crate::model::{Model, SideBySide};
use crate::pool::lock;
use crate::real::traced::{Arg, Op, Parameter, Recorder, Traced, HANDED};
use crate::real::Real;
use crate::settings::Settings;
use crate::sim::Sim;
use crate::warm::{Warm, WARM_ROWS};

/// Entries after which a step is left to the stages: its code would not fit where it is quick.
const MOST: usize = 400_000;

/// Where the numbers of a step are in the memory of its code: what it reads and leaves (positions,
/// velocities, activations, what rows start from), what it leaves (accelerations), what it reads.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    pub nq: usize,
    pub nv: usize,
    pub na: usize,
    /// Of what rows start from: the slot, and how many rows its block has.
    pub warm: Vec<(u64, usize)>,
    pub nu: usize,
    /// By array of inputs that is neither a control nor a force: how many numbers.
    pub others: [usize; 3],
}

impl Layout {
    /// The first number of each part: positions, velocities, activations, impulses, accelerations,
    /// the count of rows, controls, other inputs; and one past the last.
    pub fn starts(&self) -> [usize; 9] {
        let warm = self.warm.iter().map(|(_, rows)| 1 + rows).sum();
        let sizes =
            [self.nq, self.nv, self.na, warm, self.nv, 1, self.nu, self.others.iter().sum()];
        let mut starts = [0; 9];
        for (at, size) in sizes.into_iter().enumerate() {
            starts[at + 1] = starts[at] + size;
        }
        starts
    }
}

/// Up to which sizes a list is right: of positions, velocities and inputs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    pub qpos: f64,
    pub qvel: f64,
}

impl Limits {
    fn of(settings: &Settings, single: bool) -> Self {
        let qpos = if single { 1e9 } else { 1e60 };
        // Whoever moves faster is beyond the limit after a step.
        Self { qpos, qvel: 4.0 * qpos / settings.dt }
    }
}

/// A step's list, and where its numbers are.
pub(crate) struct Trace {
    pub list: List,
    pub layout: Layout,
    pub limits: Limits,
    /// Numbers that differ by world: of each one for every model.
    pub columns: Vec<Vec<f64>>,
    /// What somebody else solves at the cuts of the list.
    pub handed: Vec<Handed>,
    /// The first place in the memory that is none of a number of the list.
    pub end: u32,
}

impl Trace {
    /// That of a model's steps in numbers of this unit roundoff, if it can be written down in so many
    /// entries.
    pub fn of(
        models: &Arc<[Arc<Model>]>,
        settings: &Settings,
        epsilon: f64,
        most: usize,
    ) -> Option<Self> {
        let model = &models[0];
        if settings.sleep || model.dynamic_pairs.is_some() || model.nhistory > 0 {
            return None;
        }
        Traced::round_as(epsilon);
        Parameter::begin();
        let models = SideBySide::<Traced>::new(models.to_vec()).ok()?;
        // Sweeps that end row by row are handed over too, where there is no list of them.
        let by = |all| Self::solved(&models, settings, (epsilon, most), all);
        by(false).or_else(|| if goes_by_lane(settings) { None } else { by(true) })
    }

    /// That in which every solve is handed over, or those that must be.
    fn solved(
        models: &SideBySide<Traced>,
        settings: &Settings,
        numbers: (f64, usize),
        all: bool,
    ) -> Option<Self> {
        // A step that starts without impulses tells which it leaves.
        let (cold, warm) = Self::starting(models, settings, numbers, (&[], all))?;
        if warm.is_empty() {
            return Some(cold);
        }
        let trace = Self::starting(models, settings, numbers, (&warm, all))?;
        (trace.1 == warm).then_some(trace.0)
    }

    /// That of steps whose rows start from impulses with these slots; and the slots that it leaves.
    fn starting(
        models: &SideBySide<Traced>,
        settings: &Settings,
        (epsilon, most): (f64, usize),
        (warm, all): (&[(u64, usize)], bool),
    ) -> Option<(Self, Vec<(u64, usize)>)> {
        let single = epsilon > f64::EPSILON;
        let limits = Limits::of(settings, single);
        Recorder::begin(if single { 1e38 } else { 1e300 }, most.min(MOST));
        let model = models.first();
        let handed = HandedList::default();
        let solver = Box::new(HandsOver::new(all, handed.clone()));
        let mut sim = Sim::<Traced>::solved_by(solver, models.clone(), settings.clone()).ok()?;
        if let Some(aside) = TakesAside::of(model, handed.clone()) {
            sim.detected.elsewhere = Some(Box::new(aside));
        }
        let mut others = [0; 3];
        sim.inputs.edit(|[_, _, _, rest @ ..]| others = rest.map(|list| list.len()));
        let layout = Layout {
            nq: model.nq,
            nv: model.nv,
            na: model.na,
            warm: warm.to_vec(),
            nu: sim.inputs.ctrl.len(),
            others,
        };
        let starts = layout.starts();
        read(&mut sim.state.qpos, starts[0], limits.qpos);
        read(&mut sim.state.qvel, starts[1], limits.qvel);
        read(&mut sim.state.act, starts[2], limits.qpos);
        let mut at = starts[3];
        for (slot, rows) in warm {
            let mut numbers = vec![Traced::of(0.0); 1 + rows];
            read(&mut numbers, at, f64::INFINITY);
            at += numbers.len();
            let mut impulse = [Traced::of(0.0); WARM_ROWS];
            impulse[..*rows].copy_from_slice(&numbers[1..]);
            sim.state.warm.push(Warm { slot: *slot, feature: numbers[0], impulse });
        }
        read(&mut sim.inputs.ctrl, starts[6], limits.qpos);
        sim.inputs.edit(|[_, _, _, rest @ ..]| {
            let mut at = starts[7];
            for list in rest {
                read(list, at, limits.qpos);
                at += list.len();
            }
        });
        let outcome = sim.integrate(&mut ());
        let rows = count(&sim);
        let recorded = Recorder::end();
        if outcome.is_err() || recorded.given_up {
            return None;
        }
        let slot = |warm: &Warm<Traced>| {
            let known = |x: &Traced| x.arg() == Arg::Known(0.0);
            let last = warm.impulse.iter().rposition(|x| !known(x));
            (warm.slot, last.map_or(0, |last| last + 1))
        };
        let left: Vec<(u64, usize)> = sim.next.warm.iter().map(slot).collect();
        let within = |list: &[Traced], limit: f64| -> Vec<(Arg, f64)> {
            list.iter().map(|x| (x.arg(), limit)).collect()
        };
        let mut wanted = within(&sim.next.qpos, limits.qpos);
        wanted.extend(within(&sim.next.qvel, limits.qvel));
        wanted.extend(within(&sim.next.act, limits.qpos));
        let mut under = HashMap::new();
        let all = sim.next.warm.iter().zip(&left).zip(&sim.rows.blocks);
        for ((own, (_, rows)), block) in all.filter(|_| !warm.is_empty()) {
            wanted.push((own.feature.arg(), f64::INFINITY));
            // Without a feature nobody reads the impulses.
            let mask = block.mask.arg().node().filter(|_| block.slot == own.slot);
            under.extend((wanted.len()..).take(*rows).zip(mask.into_iter().cycle()));
            wanted.extend(within(&own.impulse[..*rows], f64::INFINITY));
        }
        wanted.extend(within(&sim.qacc, f64::INFINITY));
        wanted.push((rows, f64::INFINITY));
        // Numbers of the models come after all others, and then what is handed over.
        let columns = Parameter::columns();
        let models = starts[8] as u32;
        let first = models + columns.len() as u32;
        let place = |place: u32| if place < HANDED { place } else { place - HANDED + first };
        let Recorder { entries, loops, assumed, puts, cuts, places, .. } = recorded;
        let mut nodes = entries.nodes;
        for node in &mut nodes {
            node.op = match node.op {
                Op::Parameter(column) => Op::Input(models + column),
                Op::Input(at) => Op::Input(place(at)),
                Op::Put(at) => Op::Put(place(at)),
                op => op,
            };
        }
        let mut handed = std::mem::take(&mut *lock(&handed));
        handed.iter_mut().for_each(|own| own.begins_at(first));
        let list = List { nodes, loops, wanted, under, assumed, puts, cuts };
        let end = first + places;
        Some((Self { list, layout, limits, columns, handed, end }, left))
    }
}

/// These numbers are read, from this place on.
fn read(list: &mut [Traced], from: usize, most: f64) {
    for (at, x) in list.iter_mut().enumerate() {
        *x = Traced::Node(Recorder::input(from + at, most));
    }
}

/// How many rows exist, once a step was written down.
fn count(sim: &Sim<Traced>) -> Arg {
    let mut sum = Traced::zero();
    for block in &sim.rows.blocks {
        sum += Traced::select(block.mask, Traced::of(block.rows.len as f64), Traced::zero());
    }
    sum.arg()
}
