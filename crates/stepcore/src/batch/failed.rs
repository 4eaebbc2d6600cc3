//! Worlds of a batch that failed while the others continue.
//!
//! A failed world keeps its last finite state here. Its lane repeats a healthy world of the group
//! from then on, as the lanes without a world do, so that nothing that is not finite is ever
//! computed again and the other lanes keep their bits.

use crate::arrays::{Array, Given};
use crate::error::Error;
use crate::real::Real;
use crate::state::{Inputs, State};
use crate::watch::Watched;

/// A failed world.
#[derive(Clone, Debug)]
pub struct Failed {
    /// In the order of `arrays::Array`.
    pub state: [Vec<f64>; Array::CHANGED],
    /// Steps of the present call before it failed; 0 where it had failed before.
    pub done: u64,
    pub error: Error,
}

impl Failed {
    /// Whether the user's state is still the one in which it failed.
    pub fn stands(&self, given: &Given) -> bool {
        self.state.iter().zip(given.lists()).all(|(own, given)| own == given)
    }
}

room!(Failed: state, done; error);

/// By lane of a group: the failed ones.
pub(super) struct Standing {
    pub lanes: Vec<Option<Box<Failed>>>,
}

room!(Standing: lanes);

impl Standing {
    pub fn new(worlds: usize) -> Self {
        Self { lanes: vec![None; worlds] }
    }

    /// A lane with a healthy world.
    pub fn healthy(&self) -> Option<usize> {
        self.lanes.iter().position(Option::is_none)
    }

    pub fn any(&self) -> bool {
        self.lanes.iter().any(Option::is_some)
    }

    /// Stores a lane's state; one that failed already, or without a world, is only a diverging
    /// copy.
    pub fn take<R: Real>(&mut self, state: &State<R>, lane: usize, done: u64, error: Error) {
        let Some(place) = self.lanes.get_mut(lane).filter(|place| place.is_none()) else { return };
        let plain = |list: &Vec<R>| list.iter().map(|x| x.lane(lane)).collect();
        *place = Some(Box::new(Failed { state: state.lists().map(plain), done, error }));
    }

    /// Lanes that repeat the healthy one: lanes of failed worlds, and lanes without one.
    fn copies<R: Real>(&self) -> impl Iterator<Item = usize> + '_ {
        (0..R::LANES).filter(|lane| self.lanes.get(*lane).is_none_or(Option::is_some))
    }

    /// The copies as bits: lanes without a world until a world has failed.
    pub fn mask<R: Real>(&self) -> u64 {
        if !self.any() {
            return 0;
        }
        self.copies::<R>().fold(0, |mask, lane| mask | 1 << lane)
    }

    /// Makes every copy repeat a healthy lane. False if there is none.
    pub fn mirror<R: Real>(&self, state: &mut State<R>, inputs: &mut Inputs<R>) -> bool {
        let Some(from) = self.healthy() else { return false };
        let copy = |list: &mut [R]| {
            for lane in self.copies::<R>() {
                list.iter_mut().for_each(|x| x.set_lane(lane, x.lane(from)));
            }
        };
        state.lists_mut().into_iter().for_each(|list| copy(list));
        for warm in &mut state.warm {
            copy(core::slice::from_mut(&mut warm.feature));
            copy(&mut warm.impulse);
        }
        inputs.edit(|arrays| arrays.into_iter().for_each(copy));
        true
    }

    /// The same in the working space of a thread, which has the group's ledger.
    pub fn mirror_in<R: Real>(&self, watched: &mut Watched<R>) -> bool {
        let Some(from) = self.healthy() else { return false };
        self.mirror(&mut watched.sim.state, &mut watched.sim.inputs);
        watched.repeat(from, self.mask::<R>());
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Model;
    use crate::real::Lanes;
    use crate::scene::{Body, Geom, Joint, JointType, Scene};
    use crate::warm::{Warm, WARM_ROWS};

    /// A copy that kept the contacts of its former world would start from other impulses, diverge
    /// and fail by itself.
    #[test]
    fn a_copy_has_all_that_its_world_has() {
        let mut scene = Scene::default();
        scene.bodies.push(Body::default());
        scene.joints.push(Joint { body: 1, kind: JointType::Slide, ..Joint::default() });
        scene.geoms.push(Geom { body: 1, size: [0.1, 0.0, 0.0], ..Geom::default() });
        let model = Model::compile(&scene).unwrap();
        let model = Model::same(&model);
        let (mut state, mut inputs) = (State::<Lanes>::new(&model), Inputs::new(&model));
        let by_lane = |scale: f64| Lanes(crate::real::array::from_fn(|lane| scale * lane as f64));
        state.qvel[0] = by_lane(2.0);
        let impulse = [by_lane(3.0); WARM_ROWS];
        state.warm.push(Warm { slot: 0, feature: by_lane(1.0), impulse });
        let mut standing = Standing::new(3);
        let error = Error::value("a world", 0, "well");
        for lane in [0, 2] {
            standing.take(&state, lane, 1, error.clone());
        }
        assert!(standing.mirror(&mut state, &mut inputs));
        let (warm, all) = (&state.warm[0], |scale| [scale; Lanes::<f64>::LANES]);
        assert_eq!([state.qvel[0].0, warm.feature.0, warm.impulse[0].0], [2.0, 1.0, 3.0].map(all));
    }
}
