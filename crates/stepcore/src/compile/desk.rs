//! Worlds on their way through code: numbers side by side, as code reads them.

use std::sync::Arc;

use super::aside::Aside;
use super::handed::Handed;
use super::memory::Aligned;
use super::split::split;
use super::text;
use super::trace::{Layout, Limits, Trace};
use super::{Code, Isa};
use crate::model::{Model, SideBySide};
use crate::real::traced::Arg;
use crate::real::{Mask, Real, PACK};
use crate::room::Room;
use crate::settings::Settings;
use crate::state::{Inputs, State};
use crate::warm::{Warm, WARM_ROWS};

/// Code of the steps of models that differ in numbers alone, under their settings, for numbers of one
/// precision.
pub struct Compiled {
    /// The parts of a step.
    parts: Vec<Code>,
    /// What the stages do after each part but the last.
    handed: Vec<Handed>,
    settings: Settings,
    layout: Layout,
    starts: [usize; 9],
    limits: Limits,
    rowless: bool,
    /// Numbers that differ by world, of each one for every model.
    columns: Vec<Vec<f64>>,
    models: Arc<[Arc<Model>]>,
    /// Operations that were written down.
    pub operations: usize,
}

/// Operations that somebody may want to read.
const FEW: usize = 1000;

impl Compiled {
    /// None: the step cannot be written down in so many operations, or not for this machine.
    pub fn of<R: Real>(
        models: &Arc<[Arc<Model>]>,
        settings: &Settings,
        most: usize,
    ) -> Option<Arc<Self>> {
        let single = R::epsilon() > f64::EPSILON;
        let isa = Isa::of_this_machine(single)?;
        let Trace { list, layout, limits, columns, handed, end } =
            Trace::of(models, settings, R::epsilon(), most)?;
        let (operations, starts) = (list.nodes.len(), layout.starts());
        let rowless = list.wanted[starts[5]].0 == Arg::Known(0.0);
        if list.leaks() {
            return None;
        }
        let parts = split(list, end).into_iter().map(|part| Code::of(&part, isa));
        Some(Arc::new(Self {
            parts: parts.collect::<Option<Vec<Code>>>()?,
            handed,
            settings: settings.clone(),
            layout,
            starts,
            limits,
            rowless,
            columns,
            models: models.clone(),
            operations,
        }))
    }

    /// Its operations, one a line; none if they are many.
    pub fn lines<R: Real>(&self) -> Vec<String> {
        let trace = Trace::of(&self.models, &self.settings, R::epsilon(), FEW);
        trace.map_or(vec![], |trace| text::lines(&trace.list, &trace.layout))
    }

    /// The numbers of the models of some worlds, one a lane.
    pub fn parameters<R: Real>(&self, models: &SideBySide<R>) -> Option<Vec<R>> {
        if self.columns.is_empty() {
            return Some(vec![]);
        }
        let place = |model: &Arc<Model>| self.models.iter().position(|own| Arc::ptr_eq(own, model));
        let places: Option<Vec<usize>> = (0..R::LANES).map(|lane| place(models.of(lane))).collect();
        let places = places?;
        let number = |column: &Vec<f64>| {
            let mut x = R::zero();
            places.iter().enumerate().for_each(|(lane, at)| x.set_lane(lane, column[*at]));
            x
        };
        Some(self.columns.iter().map(number).collect())
    }

    /// No row can ever be.
    pub(super) fn has_no_rows(&self) -> bool {
        self.rowless
    }

    /// The stages do a part of it.
    pub fn hands_over(&self) -> bool {
        !self.handed.is_empty()
    }

    /// Bytes of machine code.
    pub fn bytes(&self) -> usize {
        self.parts.iter().map(|part| part.sizes[0]).sum()
    }

    /// Worlds that it steps side by side.
    pub fn lanes(&self) -> usize {
        self.parts[0].isa.lanes()
    }

    /// Memory for the state of its worlds, number by number, and to work in.
    fn memory(&self) -> [Aligned; 2] {
        let most = |which: usize| self.parts.iter().map(|part| part.sizes[which]).max();
        [2, 3].map(|which| Aligned::new(most(which).unwrap_or(0)))
    }
}

/// Memory for the worlds of a register of lanes, of which code takes a vector at a time.
pub(crate) struct Desk<R: Real> {
    compiled: Arc<Compiled>,
    aside: Vec<Aside<R>>,
    /// Of the worlds at hand.
    model: Option<Arc<Model<R::Value>>>,
    memory: [Aligned; 2],
    vectors: usize,
    /// The state before steps that may have to be made again.
    kept: Vec<u8>,
}

impl<R: Real> Room for Desk<R> {
    fn room(&self) -> usize {
        let [state, space] = &self.memory;
        let own = state.bytes().len() + space.bytes().len() + self.kept.capacity();
        own + self.aside.room()
    }
}

impl<R: Real> Desk<R> {
    pub fn new(compiled: Arc<Compiled>) -> Self {
        Self {
            vectors: R::LANES.div_ceil(compiled.lanes()),
            aside: compiled.handed.iter().map(Aside::new).collect(),
            model: None,
            memory: compiled.memory(),
            kept: vec![],
            compiled,
        }
    }

    /// The code.
    pub fn compiled(&self) -> &Arc<Compiled> {
        &self.compiled
    }

    fn put(&mut self, place: usize, x: &R) {
        x.pack(self.memory[0].number_mut(place));
    }

    fn take(&self, place: usize, x: &mut R) {
        x.unpack(self.memory[0].number(place));
    }

    /// Takes worlds in. False: the code is not right for them.
    pub fn enter(
        &mut self,
        state: &State<R>,
        inputs: &mut Inputs<R>,
        model: &Arc<Model<R::Value>>,
        parameters: &[R],
    ) -> bool {
        self.model = Some(model.clone());
        let compiled = self.compiled.clone();
        let Compiled { layout, starts, limits, .. } = &*compiled;
        if inputs.applied() || !state.sleep.slow.is_empty() {
            return false;
        }
        let mut right = true;
        let mut within = |list: &[R], most: f64| {
            let fits = |x: &R| (0..R::LANES).all(|lane| x.lane(lane).abs() <= most);
            right &= list.iter().all(fits);
        };
        within(&state.qpos, limits.qpos);
        within(&state.qvel, limits.qvel);
        within(&state.act, limits.qpos);
        inputs.edit(|[ctrl, _, _, rest @ ..]| {
            within(ctrl, limits.qpos);
            rest.iter().for_each(|list| within(list, limits.qpos));
        });
        if !right {
            return false;
        }
        for (from, list) in
            [(starts[0], &state.qpos), (starts[1], &state.qvel), (starts[2], &state.act)]
        {
            list.iter().enumerate().for_each(|(at, x)| self.put(from + at, x));
        }
        if !self.enter_warm(&state.warm, layout, starts[3]) {
            return false;
        }
        if parameters.len() != compiled.columns.len() {
            return false;
        }
        parameters.iter().enumerate().for_each(|(at, x)| self.put(starts[8] + at, x));
        inputs.edit(|[ctrl, _, _, rest @ ..]| {
            let all = std::iter::once(&*ctrl).chain(rest.iter().map(|list| &**list)).flatten();
            all.enumerate().for_each(|(at, x)| self.put(starts[6] + at, x));
        });
        true
    }

    /// Impulses from which rows start. False: there is one that the code does not know.
    fn enter_warm(&mut self, warm: &[Warm<R>], layout: &Layout, from: usize) -> bool {
        let (mut at, mut place) = (0, from);
        for (slot, rows) in &layout.warm {
            let own = warm.get(at).filter(|warm| warm.slot == *slot);
            at += usize::from(own.is_some());
            let beyond = |warm: &Warm<R>| warm.impulse[*rows..].iter().any(|x| !x.is_zero());
            if own.is_some_and(beyond) {
                return false;
            }
            let none = -R::one();
            self.put(place, own.map_or(&none, |warm| &warm.feature));
            for row in 0..*rows {
                self.put(place + 1 + row, own.map_or(&R::zero(), |warm| &warm.impulse[row]));
            }
            place += 1 + rows;
        }
        at == warm.len()
    }

    /// Controls of the next step. False: the code is not right for them.
    pub fn control(&mut self, ctrl: &[R]) -> bool {
        let (from, most) = (self.compiled.starts[6], self.compiled.limits.qpos);
        let fits = |x: &R| (0..R::LANES).all(|lane| x.lane(lane).abs() <= most);
        ctrl.iter().enumerate().for_each(|(at, x)| self.put(from + at, x));
        ctrl.iter().all(fits)
    }

    /// So many steps, or as many as the code is right for in all lanes: how many were made.
    pub fn step(&mut self, n: u64) -> u64 {
        let compiled = self.compiled.clone();
        let [code] = &*compiled.parts else {
            return (0..n).take_while(|_| self.step_in_parts()).count() as u64;
        };
        let Self { memory, vectors, kept, .. } = self;
        if n == 0 || *vectors == 1 {
            return n - code.run(memory, 0, n);
        }
        let state = ..PACK * compiled.starts[5];
        kept.clear();
        kept.extend_from_slice(&memory[0].bytes()[state]);
        let most = (0..*vectors).map(|vector| code.run(memory, vector, n)).max();
        let made = n - most.unwrap_or(0);
        if made < n {
            // All go as far as the first of them that can go no further.
            memory[0].bytes_mut()[state].copy_from_slice(kept);
            (0..*vectors).for_each(|vector| {
                code.run(memory, vector, made);
            });
        }
        made
    }

    /// One step, between whose parts the stages work. False: it was not made.
    fn step_in_parts(&mut self) -> bool {
        let Self { compiled, aside, model, memory, vectors, kept } = self;
        let Some(model) = model else { return false };
        let Compiled { parts, handed, settings, starts, .. } = &**compiled;
        let kept_state = ..PACK * starts[5];
        let works = handed.iter().zip(aside).map(Some).chain([None]);
        for (code, work) in parts.iter().zip(works) {
            if *vectors > 1 && work.is_none() {
                kept.clear();
                kept.extend_from_slice(&memory[0].bytes()[kept_state]);
            }
            if (0..*vectors).any(|vector| code.run(memory, vector, 1) > 0) {
                if *vectors > 1 && work.is_none() {
                    memory[0].bytes_mut()[kept_state].copy_from_slice(kept);
                }
                return false;
            }
            let done = |(handed, own): (&Handed, &mut Aside<R>)| {
                own.work(handed, (model, settings), &mut memory[0])
            };
            if !work.is_none_or(done) {
                return false;
            }
        }
        true
    }

    /// How many rows the last step had, in the first lane.
    pub fn rows(&self) -> usize {
        let mut rows = R::zero();
        self.take(self.compiled.starts[5], &mut rows);
        rows.lane(0) as usize
    }

    /// Gives the worlds' state out.
    pub fn leave(&self, state: &mut State<R>) {
        let State { qpos, qvel, act, warm, .. } = state;
        self.leave_moving([qpos, qvel, act]);
        self.leave_warm(warm);
    }

    /// What rows start from.
    pub fn leave_warm(&self, warm: &mut Vec<Warm<R>>) {
        let Compiled { layout, starts, .. } = &*self.compiled;
        let mut at = starts[3];
        warm.clear();
        for (slot, rows) in &layout.warm {
            let mut own = Warm { slot: *slot, feature: R::zero(), impulse: [R::zero(); WARM_ROWS] };
            self.take(at, &mut own.feature);
            for (row, impulse) in own.impulse[..*rows].iter_mut().enumerate() {
                self.take(at + 1 + row, impulse);
            }
            at += 1 + rows;
            // In lanes that have none, impulses of another step may stand here.
            let none = -R::one();
            let there = own.feature.le(none).and(own.feature.ge(none)).not();
            own.impulse.iter_mut().for_each(|x| *x = R::select(there, *x, R::zero()));
            if there.any() {
                warm.push(own);
            }
        }
    }

    /// Positions, velocities and activations.
    pub fn leave_moving(&self, lists: [&mut Vec<R>; 3]) {
        for (from, list) in self.compiled.starts.into_iter().zip(lists) {
            list.iter_mut().enumerate().for_each(|(at, x)| self.take(from + at, x));
        }
    }

    /// The accelerations of the last step.
    pub fn accelerations(&self, qacc: &mut [R]) {
        let from = self.compiled.starts[4];
        qacc.iter_mut().enumerate().for_each(|(at, x)| self.take(from + at, x));
    }
}
