//! The contacts of a pile, from the pairs whose boxes overlap.

use super::apart::near;
use super::broad::Bounds;
use super::kept::Kept;
use super::swept::Swept;
use super::{listed, meet, push, rests, within, Contact, Detected};
use crate::error::Result;
use crate::interrupt::{Meter, TEST};
use crate::model::{DynamicPairs, Model, Pair};
use crate::place::Placed;
use crate::pool::{inside, lock, Pool, WORTH_SHARING};
use crate::real::{Constant, Mask, Real};
use std::sync::Mutex;

/// Margin of boxes, as a part of the geom's reach and in roundings of its place.
const ROUNDING: f64 = 1e-6;
const UNITS: f64 = 16.0;

impl<R: Real> Detected<R> {
    /// Lists the contacts of a pile, in the order that fixed pairs would have.
    pub(super) fn detect_near(
        &mut self,
        model: &Model<R::Value>,
        heap: &DynamicPairs,
        placed: &Placed<R>,
        ahead: bool,
    ) -> Result<()> {
        let (swept, asleep) = (&self.swept, &self.asleep);
        let boxes = |geom| {
            let guessed = if ahead { swept.geom(geom).lane(0) } else { 0.0 };
            let listed = if ahead && !model.adheres { 0.0 } else { heap.listed[geom] };
            let more = guessed.max(listed);
            Bounds { fixed: rests(model, asleep, geom), ..bounds(model, placed, geom, more) }
        };
        self.kept.refresh(model, heap, &mut self.lists, ahead, boxes)?;
        let Self { kept, found, contacts, grown, pool, .. } = self;
        let near = Near { model, placed, kept, swept: ahead.then_some(swept) };
        match pool {
            Some(pool) if kept.pairs.len() >= WORTH_SHARING => {
                near.meet_shared(pool, found, |contact| push(contacts, grown, contact));
            }
            _ => near.meet(&kept.pairs, |contact| push(contacts, grown, contact)),
        }
        Ok(())
    }
}

/// Parts of the work for each thread: some are done sooner than others.
const PARTS: usize = 4;

/// The input of the exact tests of near pairs.
struct Near<'a, R: Real> {
    model: &'a Model<R::Value>,
    placed: &'a Placed<R>,
    kept: &'a Kept,
    /// Present for laws that read the guess.
    swept: Option<&'a Swept<R>>,
}

impl<R: Real> Near<'_, R> {
    /// Passes the contacts of some pairs to `take`.
    fn meet(&self, pairs: &[Pair], mut take: impl FnMut(Contact<R>)) {
        let Self { model, placed, kept, swept } = *self;
        let mut meter = Meter::default();
        for pair in pairs.iter().filter(|pair| kept.overlap(pair)) {
            meter.count(TEST);
            let more = swept.map(|swept| swept.of(model, pair));
            if near(model, &placed.geom, pair, more).none() {
                continue;
            }
            let listed = listed(model, pair, more);
            let within = within(model, pair, swept.is_some());
            meet(model, &placed.geom, pair, (within, &[]), |part, touch| {
                let mask = touch.exists.and(touch.dist.lt(listed));
                if mask.any() {
                    take(Contact::of(pair, part, touch, mask));
                }
            });
        }
    }

    /// Does the same with the threads of a pool. The parts' contacts are joined in their order.
    fn meet_shared(
        &self,
        pool: &Pool,
        found: &mut Vec<Mutex<Found<R>>>,
        take: impl FnMut(Contact<R>),
    ) {
        let parts = PARTS * pool.threads();
        found.resize_with(parts, || Mutex::new(Found { contacts: vec![] }));
        let pairs = &self.kept.pairs;
        let len = pairs.len().div_ceil(parts);
        let places = &*found;
        pool.share(parts, &|part| {
            let Found { contacts } = &mut *lock(&places[part]);
            contacts.clear();
            let own = pairs.chunks(len).nth(part).unwrap_or(&[]);
            self.meet(own, |contact| contacts.push(contact));
        });
        found.iter_mut().flat_map(|found| inside(found).contacts.drain(..)).for_each(take);
    }
}

/// The contacts of one part of the near pairs.
pub(super) struct Found<R: Real> {
    contacts: Vec<Contact<R>>,
}

room!(Found<R>: contacts);

/// Returns the box that a geom stays in: its bounding box, and `more` on each side.
fn bounds<R: Real>(model: &Model<R::Value>, placed: &Placed<R>, index: usize, more: f64) -> Bounds {
    let (geom, pose) = (&model.geoms[index], &placed.geom[index]);
    let reach = geom.reach.lane(0);
    let centre = [pose.pos.x, pose.pos.y, pose.pos.z].map(|x| x.lane(0));
    let far = centre.iter().fold(reach, |far, x| far.max(x.abs()));
    let more = more + ROUNDING * reach + UNITS * R::epsilon() * far;
    let size: [f64; 3] = crate::real::array::from_fn(|i| {
        let along = |j: usize| pose.rot[(i, j)].lane(0).abs() * geom.half[j].lane(0);
        (along(0) + along(1) + along(2)).min(reach) + more
    });
    Bounds {
        low: crate::real::array::from_fn(|k| centre[k] - size[k]),
        high: crate::real::array::from_fn(|k| centre[k] + size[k]),
        geom: index as u32,
        fixed: false,
    }
}
