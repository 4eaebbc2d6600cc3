//! One world's arrays in the user's layout: `f64`, whatever number the engine computes with. They
//! are checked before anything moves, copied in, and copied out again.
//!
//! `Array` lists them. To add one, add a line to each of its functions, and one to `State::lists`
//! or `Inputs::arrays`, whichever stores it.

pub mod array;

pub use array::{Array, ArraySet};
use std::ops::{Index, Range};
use std::sync::Arc;

use crate::elements::{Element, Kind};
use crate::error::{Error, Result};
use crate::model::{Joint, Model};
use crate::real::{Constant, Mask, Real};
use crate::scene::JointType;
use crate::settings::{Precision, Settings};
use crate::sim::Sim;
use crate::state::{Inputs, State};
use crate::warm::{Sleep, Warm};

/// The smallest squared length of a quaternion that can be scaled to 1 in any precision.
const SHORTEST_SQUARE: f64 = 1e-30;

/// State and inputs of one world, read-only.
#[derive(Clone, Copy)]
pub struct Given<'a>([&'a [f64]; Array::COUNT]);

impl Index<Array> for Given<'_> {
    type Output = [f64];

    fn index(&self, array: Array) -> &[f64] {
        self.0[array as usize]
    }
}

impl<'a> Given<'a> {
    /// Creates from a function that returns each array.
    pub fn new(list: impl FnMut(Array) -> &'a [f64]) -> Self {
        Self(Array::ALL.map(list))
    }

    /// Returns the arrays in the order of `Array::ALL`.
    pub fn lists(&self) -> &[&'a [f64]; Array::COUNT] {
        &self.0
    }

    /// Reject numbers that are not finite in the engine's number, truths other than 0 and 1, and
    /// quaternions of zero length.
    /// `world`: its index in a batch, for the error text.
    pub fn check<R: Real>(&self, model: &Model, world: Option<usize>) -> Result<()> {
        self.check_some::<R>(model, ArraySet::ALL, world)
    }

    /// The same for some arrays.
    pub fn check_some<R: Real>(
        &self,
        model: &Model,
        some: ArraySet,
        world: Option<usize>,
    ) -> Result<()> {
        self.check_finite::<R>(model, some, world)?;
        let forms = [Array::Qpos, Array::EqActive, Array::MocapQuat];
        if forms.into_iter().any(|array| some.has(array)) {
            self.check_forms::<R>(model, world)?;
        }
        Ok(())
    }

    fn check_finite<R: Real>(
        &self,
        model: &Model,
        some: ArraySet,
        world: Option<usize>,
    ) -> Result<()> {
        for array in some.iter() {
            let values = &self[array];
            let Some(k) = values.iter().position(|x| !R::of(*x).lane(0).is_finite()) else {
                continue;
            };
            let place = match array.shape(model)[..] {
                [_, width] => format!("{}, {}", k / width, k % width),
                _ => k.to_string(),
            };
            let owner = model.element_name(array.owner(model, k));
            let field = format!("{}[{place}]", array.name());
            return Err(refuse::<R>(field, values[k], &owner, world));
        }
        Ok(())
    }

    /// The same for finite numbers.
    pub(crate) fn check_forms<R: Real>(&self, model: &Model, world: Option<usize>) -> Result<()> {
        self.check_truths(model, world)?;
        self.check_quaternions::<R>(model, world)
    }

    fn check_truths(&self, model: &Model, world: Option<usize>) -> Result<()> {
        let values = &self[Array::EqActive];
        let Some(k) = values.iter().position(|x| *x != 0.0 && *x != 1.0) else {
            return Ok(());
        };
        let whose = whose(&model.element_name(Array::EqActive.owner(model, k)), world);
        let limit = format!("0 or 1 ({whose}); nothing was stepped");
        Err(Error::value(format!("eq_active[{k}]"), values[k], limit))
    }

    fn check_quaternions<R: Real>(&self, model: &Model, world: Option<usize>) -> Result<()> {
        let joints = model.joints.iter().enumerate().filter_map(|(index, joint)| {
            let first = match joint.kind {
                JointType::Ball => joint.qpos,
                JointType::Free => joint.qpos + 3,
                JointType::Slide | JointType::Hinge => return None,
            };
            Some((Array::Qpos, first, Element::whole(Kind::Joint, index)))
        });
        let mocaps = model.mocaps.iter().enumerate();
        let mocaps =
            mocaps.map(|(at, body)| (Array::MocapQuat, 4 * at, Element::whole(Kind::Body, *body)));
        for (array, first, owner) in joints.chain(mocaps) {
            let quat = &self[array][first..first + 4];
            let square = quat.iter().fold(R::zero(), |sum, x| sum + R::of(*x) * R::of(*x));
            // Too short to be divided by, or so long that its square overflows.
            if !(square.gt(R::of(SHORTEST_SQUARE)).all() && square.is_finite().all()) {
                let whose = whose(&model.element_name(owner), world);
                let field = match array {
                    Array::MocapQuat => format!("mocap_quat[{}]", first / 4),
                    _ => format!("{}[{first}:{}]", array.name(), first + 4),
                };
                let limit = format!("a quaternion of a length that can be scaled to 1 ({whose}); nothing was stepped");
                return Err(Error::value(field, format!("{quat:?}"), limit));
            }
        }
        Ok(())
    }
}

/// State and inputs of many worlds, read-only: each array holds all worlds, one after another.
pub struct Givens<'a> {
    lists: [&'a [f64]; Array::COUNT],
    /// Numbers per world.
    lengths: [usize; Array::COUNT],
}

impl<'a> Givens<'a> {
    /// Creates from a function that returns each array, with this many worlds.
    pub fn new(worlds: usize, list: impl FnMut(Array) -> &'a [f64]) -> Self {
        let lists = Array::ALL.map(list);
        Self { lists, lengths: lists.map(|list| list.len() / worlds) }
    }

    /// Returns one world.
    #[inline]
    pub fn of(&self, world: usize) -> Given<'a> {
        let mut own: [&[f64]; Array::COUNT] = [&[]; Array::COUNT];
        for ((own, all), length) in own.iter_mut().zip(self.lists).zip(self.lengths) {
            *own = &all[world * length..(world + 1) * length];
        }
        Given(own)
    }

    /// Returns one array of one world.
    #[inline(always)]
    fn list(&self, array: Array, world: usize) -> &'a [f64] {
        let length = self.lengths[array as usize];
        &self.lists[array as usize][world * length..(world + 1) * length]
    }

    /// Returns whether all numbers of some worlds are finite in the engine's number: without a
    /// branch for each, so that the loop vectorises.
    pub(crate) fn all_finite<R: Real>(&self, worlds: Range<usize>) -> bool {
        Array::ALL
            .iter()
            .fold(true, |all, array| all & self.all(*array, &worlds, |x| R::One::of(x).is_finite()))
    }

    /// Returns whether no force is applied in some worlds.
    pub(crate) fn no_forces(&self, worlds: Range<usize>) -> bool {
        let forces = [Array::QfrcApplied, Array::XfrcApplied];
        forces.iter().fold(true, |none, array| none & self.all(*array, &worlds, |x| x == 0.0))
    }

    #[inline(always)]
    fn all(&self, array: Array, worlds: &Range<usize>, fine: impl Fn(f64) -> bool) -> bool {
        let (list, n) = (self.lists[array as usize], self.lengths[array as usize]);
        list[worlds.start * n..worlds.end * n].iter().fold(true, |all, x| all & fine(*x))
    }
}

impl<N: Constant> Model<N> {
    /// Returns whether there are truths or quaternions, which `Given::check_forms` checks.
    pub(crate) fn has_forms(&self) -> bool {
        let turns = |joint: &Joint<N>| matches!(joint.kind, JointType::Ball | JointType::Free);
        let others = !(self.equalities.is_empty() && self.mocaps.is_empty());
        others || self.joints.iter().any(turns)
    }
}

fn refuse<R: Real>(field: String, value: f64, element: &str, world: Option<usize>) -> Error {
    let kind = if R::epsilon() > f64::EPSILON { "finite in single precision" } else { "finite" };
    Error::value(field, value, format!("{kind} ({}); nothing was stepped", whose(element, world)))
}

fn whose(element: &str, world: Option<usize>) -> String {
    match world {
        Some(world) => format!("{element}, world {world}"),
        None => element.into(),
    }
}

fn put<R: Real>(to: &mut [R], lane: usize, from: &[f64]) {
    for (to, from) in to.iter_mut().zip(from) {
        to.set_lane(lane, *from);
    }
}

impl<R: Real> State<R> {
    /// Copies one world's state in; returns whether any of it differed.
    pub fn put(&mut self, lane: usize, given: &Given) -> bool {
        let differs =
            |now: &[R], new: &[f64]| now.iter().zip(new).any(|(now, new)| now.lane(lane) != *new);
        let both = self.lists().into_iter().zip(given.lists());
        let changed = both.into_iter().any(|(now, new)| differs(now, new));
        if changed {
            for (to, from) in self.lists_mut().into_iter().zip(given.lists()) {
                put(to, lane, from);
            }
        }
        changed
    }

    /// Copies a world's state into one lane; returns whether any of it differed.
    #[inline]
    pub(crate) fn put_of(&mut self, lane: usize, given: &Givens, world: usize) -> bool {
        let differs = |now: &[R], new: &[f64]| {
            now.iter().zip(new).fold(false, |any, (now, new)| any | (now.lane(lane) != *new))
        };
        let both = self.lists().into_iter().zip(Array::ALL);
        let changed =
            both.fold(false, |any, (now, array)| any | differs(now, given.list(array, world)));
        if changed {
            for (to, array) in self.lists_mut().into_iter().zip(Array::ALL) {
                put(to, lane, given.list(array, world));
            }
        }
        changed
    }

    /// Copies out one world's part of an array that a step changes.
    pub fn take(&self, lane: usize, array: Array, out: &mut [f64]) {
        for (to, from) in out.iter_mut().zip(self.lists()[array as usize]) {
            *to = from.lane(lane);
        }
    }
}

impl<R: Real> Sim<R> {
    /// Copies in one world's checked arrays; returns whether its state changed. Lane 0 comes first.
    pub fn put(&mut self, lane: usize, given: &Given) -> bool {
        self.put_some(lane, given, ArraySet::ALL)
    }

    /// The same for the arrays that may differ from the current ones.
    pub fn put_some(&mut self, lane: usize, given: &Given, some: ArraySet) -> bool {
        self.inputs.put(lane, given, some);
        some.meets(ArraySet::STATE) && self.state.put(lane, given)
    }

    /// Returns the world of lane 0 in plain numbers.
    pub fn plain(&self) -> Plain {
        Plain {
            model: self.model_of(0).clone(),
            settings: Settings {
                precision: Precision::F64,
                ledger: false,
                ..self.settings.clone()
            },
            lists: lists(&self.state, &self.inputs, 0),
            warm: self.state.warm.iter().map(|warm| warm.in_lane(0)).collect(),
            sleep: self.state.sleep.cast(),
            steps: self.state.steps,
            start: self.state.start,
        }
    }
}

/// A world in plain numbers, from which a world in other numbers is made.
///
/// It decouples generic code that reads a world from code of one number type that creates another:
/// so each type's step is compiled in one crate, not in every crate that passes a world on.
pub struct Plain {
    model: Arc<Model>,
    settings: Settings,
    lists: Vec<Vec<f64>>,
    warm: Vec<Warm<f64>>,
    sleep: Sleep<f64>,
    steps: u64,
    start: f64,
}

impl Plain {
    /// Returns the world in numbers as accurate as `f64`: the same model, settings, state and inputs.
    pub fn sim<R: Real>(&self) -> Result<Sim<R>> {
        self.under(self.settings.clone())
    }

    /// The same with all trees awake.
    pub fn awake<R: Real>(&self) -> Result<Sim<R>> {
        let mut sim = self.under(Settings { sleep: false, ..self.settings.clone() })?;
        sim.state.wake();
        Ok(sim)
    }

    fn under<R: Real>(&self, settings: Settings) -> Result<Sim<R>> {
        let mut sim = Sim::<R>::new(self.model.clone(), settings)?;
        self.give(&mut sim);
        Ok(sim)
    }

    /// Copies this world's state into a world of the same model.
    pub(crate) fn give<R: Real>(&self, sim: &mut Sim<R>) {
        sim.put(0, &Given::new(|array| &self.lists[array as usize]));
        sim.state.warm.clear();
        sim.state.warm.extend(self.warm.iter().map(Warm::of));
        sim.state.sleep = self.sleep.cast();
        (sim.state.steps, sim.state.start) = (self.steps, self.start);
    }
}

/// Returns one lane of state and inputs, in the order of `Array::ALL`.
pub fn lists<R: Real>(state: &State<R>, inputs: &Inputs<R>, lane: usize) -> Vec<Vec<f64>> {
    let plain = |list: &[R]| list.iter().map(|x| x.lane(lane)).collect();
    let state = state.lists().into_iter().map(|list| plain(list));
    state.chain(inputs.arrays().into_iter().map(plain)).collect()
}

impl<R: Real> Inputs<R> {
    /// Copies a world's inputs into one lane; no force is applied, in either.
    #[inline]
    pub(crate) fn put_idle(&mut self, lane: usize, given: &Givens, world: usize) {
        self.set_idle_lane(lane, |array| given.list(array, world));
    }

    /// Copies in some of one world's inputs. Lane 0 comes first.
    pub fn put(&mut self, lane: usize, given: &Given, some: ArraySet) {
        let (_, inputs) = given.lists().split_at(Array::CHANGED);
        self.set_lane(lane, inputs, some);
    }
}
