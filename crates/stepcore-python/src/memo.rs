//! The data of a world besides its arrays, and the start of its last solve.

use stepcore::arrays::Given;
use stepcore::batch::Last;
use stepcore::real::{Mask, Real};
use stepcore::state::State;
use stepcore::warm::{Sleep, Warm, WARM_ROWS};

use crate::snapshot::Clock;

/// Time, and the data that a step passes to the next besides the arrays.
#[derive(Clone, Debug, PartialEq)]
pub struct Memo {
    pub start: f64,
    pub steps: u64,
    pub warm: Vec<Warm<f64>>,
    pub sleep: Sleep<f64>,
}

/// The last solve of one world: its start, from which it can be repeated.
#[derive(Clone, Debug, PartialEq)]
pub struct Solve {
    pub of: Last,
    pub qacc: Vec<f64>,
    pub lists: Lists,
    /// Its time belongs to no state.
    pub memo: Memo,
}

impl Solve {
    pub fn given(&self) -> Given<'_> {
        Given::new(|array| &self.lists[array as usize])
    }
}

/// One world's arrays, in the order of `Array::ALL`.
pub type Lists = Vec<Vec<f64>>;

impl Memo {
    pub fn clock(&self) -> Clock {
        Clock { start: self.start, steps: self.steps }
    }

    pub fn set_clock(&mut self, Clock { start, steps }: Clock) {
        (self.start, self.steps) = (start, steps);
    }

    /// Wakes all trees.
    pub fn wake(&mut self) {
        self.warm.extend(self.sleep.kept.drain(..).map(|(_, warm)| warm));
        self.warm.sort_by_key(|warm| warm.slot);
        self.sleep = Sleep::new();
    }

    /// Removes the impulses, and wakes all trees.
    pub fn forget(&mut self) {
        self.warm.clear();
        self.sleep = Sleep::new();
    }

    /// One lane's part of a state. An impulse of zero equals none, and a lane has zeros for the
    /// contacts of its neighbours.
    pub fn of<R: Real>(state: &State<R>, lane: usize) -> Self {
        let warm = state.warm.iter().map(|w| w.in_lane(lane)).filter(Warm::acts);
        let sleep = state.sleep.cast();
        Self { start: state.start, steps: state.steps, warm: warm.collect(), sleep }
    }
}

/// Copies impulses and sleep of a memo into a state; its time is left out.
pub fn put_memo<R: Real>(state: &mut State<R>, memo: &Memo) {
    state.sleep = memo.sleep.cast();
    state.warm = warm_of(memo).collect();
}

pub fn warm_of<R: Real>(memo: &Memo) -> impl Iterator<Item = Warm<R>> + '_ {
    let number = |x: f64| R::of(impulse::<R>(x));
    memo.warm.iter().map(move |w| Warm {
        slot: w.slot,
        feature: R::of(w.feature),
        impulse: w.impulse.map(number),
    })
}

/// Copies time, impulses and sleep of the worlds in a state's lanes.
pub fn put_memos<R: Real>(state: &mut State<R>, memos: Vec<&Memo>) {
    (state.start, state.steps) = (memos[0].start, memos[0].steps);
    state.sleep = memos[0].sleep.cast();
    let mut slots: Vec<u64> =
        memos.iter().flat_map(|memo| memo.warm.iter().map(|w| w.slot)).collect();
    slots.sort_unstable();
    slots.dedup();
    state.warm.clear();
    for slot in slots {
        let mut warm = Warm { slot, feature: -R::one(), impulse: [R::zero(); WARM_ROWS] };
        for lane in 0..R::LANES {
            // Lanes without a world repeat the last one.
            let memo = memos[lane.min(memos.len() - 1)];
            let Some(kept) = memo.warm.iter().find(|w| w.slot == slot) else { continue };
            warm.feature.set_lane(lane, kept.feature);
            for (x, kept) in warm.impulse.iter_mut().zip(kept.impulse) {
                x.set_lane(lane, impulse::<R>(kept));
            }
        }
        state.warm.push(warm);
    }
}

/// An impulse of a snapshot; one of an f64 world that is not finite in f32 becomes zero.
fn impulse<R: Real>(x: f64) -> f64 {
    if R::of(x).is_finite().all() {
        x
    } else {
        0.0
    }
}
