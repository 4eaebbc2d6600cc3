//! Many worlds of either precision, in lanes or one by one, behind one interface:
//! what `Batch` in Python holds.

use std::sync::Arc;

use stepcore::arrays::{lists, Array, Given};
use stepcore::batch::{fills_lanes, gains_by_lanes, Batch, Last, Play};
use stepcore::error::{Error, Result};
use stepcore::model::Model;
use stepcore::real::{Lanes, LanesF32, Real};
use stepcore::settings::{Precision, Settings};
use stepcore::sleep::Sleep;
use stepcore::state::{Warm, WARM_ROWS};

use crate::world::{impulse, Memo, World};

pub trait Worlds: Send + Sync {
    fn check(&self, world: usize, given: &Given) -> Result<()>;
    fn put(&mut self, world: usize, given: &Given);
    fn take(&self, world: usize, array: Array, out: &mut [f64]);
    fn step(&mut self, n: u64) -> Result<()>;
    fn forward(&mut self) -> Result<()>;
    fn play(&mut self, play: &mut Play, from: usize, n: usize) -> Result<()>;
    /// The error of a world that failed while the others went on.
    fn failed(&self, world: usize) -> Option<&Error>;
    fn time(&self) -> f64;
    fn qacc(&self) -> Vec<f64>;
    /// Does a world's last solve again in `into`, which then has its rows and contacts.
    fn again(&self, world: usize, into: &mut dyn World) -> Result<()>;
    fn memos(&self) -> Vec<Memo>;
    fn set_memos(&mut self, memos: &[Memo]);
    /// Time and steps of all worlds; impulses forgotten.
    fn restart(&mut self, start: f64);
    /// The states at hand did not come from a solve.
    fn unsolved(&mut self);
    /// Some worlds begin anew; see `Batch::forget`.
    fn forget(&mut self, worlds: &[usize]);
    fn model(&self, world: usize) -> &Arc<Model>;
    /// All worlds, those of one model beside each other.
    fn by_model(&self) -> &[usize];
}

/// How worlds are stepped.
pub struct How<'a> {
    pub settings: &'a Settings,
    pub threads: usize,
    /// In lanes where it can be.
    pub lanes: bool,
    /// A world that fails stands still, and the others go on.
    pub goes_on: bool,
}

impl How<'_> {
    /// Worlds in the precision that the settings ask for; `model_of`: the model of each.
    pub fn worlds(&self, models: Vec<Arc<Model>>, model_of: &[usize]) -> Result<Box<dyn Worlds>> {
        let single = self.settings.precision == Precision::F32;
        let width = if single { <LanesF32>::LANES } else { <Lanes>::LANES };
        let gains = models.iter().all(|model| gains_by_lanes(model, self.settings));
        let lanes = self.lanes && gains && fills_lanes(model_of, width);
        match (single, lanes) {
            (false, true) => self.made::<Lanes>(models, model_of),
            (false, false) => self.made::<f64>(models, model_of),
            (true, true) => self.made::<LanesF32>(models, model_of),
            (true, false) => self.made::<f32>(models, model_of),
        }
    }

    fn made<R: Real>(
        &self,
        models: Vec<Arc<Model>>,
        model_of: &[usize],
    ) -> Result<Box<dyn Worlds>> {
        let mut batch = Batch::<R>::of_models(models, model_of, self.settings, self.threads)?;
        batch.goes_on = self.goes_on;
        Ok(Box::new(batch))
    }
}

impl<R: Real> Worlds for Batch<R> {
    fn check(&self, world: usize, given: &Given) -> Result<()> {
        Batch::check(self, world, given)
    }
    fn put(&mut self, world: usize, given: &Given) {
        Batch::put(self, world, given);
    }
    fn take(&self, world: usize, array: Array, out: &mut [f64]) {
        Batch::take(self, world, array, out);
    }
    fn step(&mut self, n: u64) -> Result<()> {
        Batch::step(self, n)
    }
    fn forward(&mut self) -> Result<()> {
        Batch::forward(self)
    }
    fn play(&mut self, play: &mut Play, from: usize, n: usize) -> Result<()> {
        Batch::play(self, play, from, n)
    }
    fn failed(&self, world: usize) -> Option<&Error> {
        Batch::failed(self, world).map(|failed| &failed.error)
    }
    fn time(&self) -> f64 {
        Batch::time(self)
    }
    fn qacc(&self) -> Vec<f64> {
        (0..self.worlds).flat_map(|world| Batch::qacc(self, world)).collect()
    }

    fn again(&self, world: usize, into: &mut dyn World) -> Result<()> {
        let (state, inputs, lane, last) = self.last(world);
        let mut lists = lists(state, inputs, lane);
        if let Some(failed) = Batch::failed(self, world) {
            // Its last solve led nowhere: what is read is that of the state it stands in.
            lists[..Array::CHANGED].clone_from_slice(&failed.state);
            into.put(&Given::new(|array| &lists[array as usize]));
            let _ = into.forward();
            return Ok(());
        }
        into.put(&Given::new(|array| &lists[array as usize]));
        into.set_memo(&Memo::of(state, lane));
        match last {
            Last::Nothing => {
                into.unsolved();
                Ok(())
            }
            Last::Forward => into.forward(),
            Last::Step => into.step(1),
        }
    }

    fn memos(&self) -> Vec<Memo> {
        let memo = |world| {
            let (state, lane) = self.state(world);
            Memo::of(state, lane)
        };
        let mut memos: Vec<Memo> = (0..self.worlds).map(memo).collect();
        for (world, memo) in memos.iter_mut().enumerate() {
            // A failed world's lane holds another's impulses.
            if Batch::failed(self, world).is_some() {
                memo.warm.clear();
                memo.sleep = Sleep::new();
            }
        }
        memos
    }

    fn set_memos(&mut self, memos: &[Memo]) {
        for (state, worlds) in self.states_mut() {
            let memos: Vec<&Memo> = worlds.iter().map(|world| &memos[*world]).collect();
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
    }

    fn unsolved(&mut self) {
        Batch::unsolved(self);
    }
    fn forget(&mut self, worlds: &[usize]) {
        Batch::forget(self, worlds);
    }
    fn model(&self, world: usize) -> &Arc<Model> {
        Batch::model(self, world)
    }
    fn by_model(&self) -> &[usize] {
        Batch::by_model(self)
    }

    fn restart(&mut self, start: f64) {
        for (state, _) in self.states_mut() {
            (state.start, state.steps) = (start, 0);
            state.warm.clear();
            state.sleep = Sleep::new();
        }
    }
}
