//! The pairs of a heap: found where the boxes of two geoms overlap, in every detection anew.

use super::apart::far;
use super::broad::Bounds;
use super::swept::Swept;
use super::{meet, push, Contact, Detected};
use crate::model::{Heap, Model, Span};
use crate::place::Placed;
use crate::pool::{inside, lock, Pool, WORTH_SHARING};
use crate::real::{Mask, Real};
use crate::room::room;
use crate::settings::Settings;
use std::sync::Mutex;

/// Of a geom's reach, and of roundings of its place: what boxes are larger by.
const ROUNDING: f64 = 1e-6;
const UNITS: f64 = 16.0;

/// What the spans of rows point into: the model's lists, in a heap followed by the dofs of each
/// two bodies that are in contact.
pub(crate) struct Lists {
    /// Empty where no pair is found live.
    own: Vec<usize>,
    /// How much of it is the model's.
    fixed: usize,
}

room!(Lists: own);

impl Lists {
    pub fn new(model: &Model) -> Self {
        let own = if model.heap.is_some() { model.dof_lists.clone() } else { vec![] };
        Self { fixed: own.len(), own }
    }

    pub fn of<'a>(&'a self, model: &'a Model) -> &'a [usize] {
        if model.heap.is_some() {
            &self.own
        } else {
            &model.dof_lists
        }
    }

    fn clear(&mut self) {
        self.own.truncate(self.fixed);
    }

    /// Takes in what another list has beside the model's; how much further on it stands here.
    fn append(&mut self, other: &Self) -> usize {
        let more = self.own.len() - self.fixed;
        self.own.extend_from_slice(&other.own[other.fixed..]);
        more
    }

    /// The dofs that move either body, ascending.
    fn union(&mut self, model: &Model, bodies: [usize; 2]) -> Span {
        let [one, two] = bodies.map(|body| model.bodies[body].closed);
        if one.len == 0 || two.len == 0 {
            return if one.len == 0 { two } else { one };
        }
        let start = self.own.len();
        let (mut one, mut two) = (one.range().peekable(), two.range().peekable());
        loop {
            let [a, b] = [&mut one, &mut two].map(|list| list.peek().map(|at| self.own[*at]));
            let least = match (a, b) {
                (Some(a), Some(b)) => a.min(b),
                (Some(only), None) | (None, Some(only)) => only,
                (None, None) => return Span { start, len: self.own.len() - start },
            };
            one.next_if(|_| a == Some(least));
            two.next_if(|_| b == Some(least));
            self.own.push(least);
        }
    }
}

impl<R: Real> Detected<R> {
    /// Lists the contacts of a heap, in the order in which fixed pairs would stand.
    pub(super) fn detect_near(
        &mut self,
        model: &Model,
        heap: &Heap,
        placed: &Placed<R>,
        settings: &Settings,
    ) {
        let on_guess = settings.law.on_guess();
        self.lists.clear();
        // What is not of `self.broad`, which takes them in.
        let mut broad = std::mem::take(&mut self.broad);
        broad.find(heap.solid.iter().map(|&geom| {
            let more = if on_guess { self.swept.geom(geom).lane(0) } else { heap.listed[geom] };
            let fixed = self.rests(model, geom);
            Bounds { fixed, ..bounds(model, placed, geom, more) }
        }));
        self.broad = broad;
        self.near.clear();
        for &(a, b) in &self.broad.found {
            let (a, b) = (a as usize, b as usize);
            if let Some(number) = model.number(heap, a, b) {
                self.near.push((number, a as u32, b as u32));
            }
        }
        self.near.sort_unstable();
        self.near.dedup();
        let shared = self.near.len() >= WORTH_SHARING;
        if let Some(pool) = self.pool.clone().filter(|_| shared) {
            return self.meet_shared(model, heap, placed, on_guess, &pool);
        }
        for at in 0..self.near.len() {
            let near = Near { model, heap, placed, swept: on_guess.then_some(&self.swept) };
            let Self { near: list, lists, contacts, grown, .. } = self;
            near.meet(list[at], lists, |contact| push(contacts, grown, contact));
        }
    }

    /// The same over the threads of a pool. What the parts find is put together in their order.
    fn meet_shared(
        &mut self,
        model: &Model,
        heap: &Heap,
        placed: &Placed<R>,
        on_guess: bool,
        pool: &Pool,
    ) {
        let parts = PARTS * pool.threads();
        self.found.resize_with(parts, || Mutex::new(Found::new(model)));
        let Self { near: list, swept, found, lists, contacts, grown, .. } = self;
        let near = Near { model, heap, placed, swept: on_guess.then_some(&*swept) };
        let (list, len) = (&*list, list.len().div_ceil(parts));
        let places = &*found;
        pool.share(parts, &|part| {
            let mut found = lock(&places[part]);
            let Found { lists, contacts } = &mut *found;
            lists.clear();
            contacts.clear();
            for pair in list.iter().skip(part * len).take(len) {
                near.meet(*pair, lists, |contact| contacts.push(contact));
            }
        });
        for found in found {
            let found = inside(found);
            let more = lists.append(&found.lists);
            for mut contact in found.contacts.drain(..) {
                if contact.pair.dofs.start >= lists.fixed {
                    contact.pair.dofs.start += more;
                }
                push(contacts, grown, contact);
            }
        }
    }
}

/// Parts of the work for each thread: some are done sooner than others.
const PARTS: usize = 4;

/// What one part of the near pairs has.
pub(super) struct Found<R: Real> {
    lists: Lists,
    contacts: Vec<Contact<R>>,
}

room!(Found<R>: contacts; lists);

impl<R: Real> Found<R> {
    fn new(model: &Model) -> Self {
        Self { lists: Lists::new(model), contacts: vec![] }
    }
}

/// What the exact test of a near pair reads.
struct Near<'a, R: Real> {
    model: &'a Model,
    heap: &'a Heap,
    placed: &'a Placed<R>,
    /// Of laws that look at the guess.
    swept: Option<&'a Swept<R>>,
}

impl<R: Real> Near<'_, R> {
    /// Gives the contacts of a pair to `take`, its dofs to `lists`.
    fn meet(
        &self,
        (number, a, b): (u64, u32, u32),
        lists: &mut Lists,
        mut take: impl FnMut(Contact<R>),
    ) {
        let Self { model, heap, placed, swept } = *self;
        let mut pair = model.near_pair(heap, number, a as usize, b as usize);
        if far(model, placed, &pair, swept.map(|swept| swept.of(&pair))) {
            return;
        }
        let material = model.material(&pair);
        let listed = material.margin + material.gap;
        let listed = if swept.is_some() { f64::INFINITY } else { listed };
        let bodies = [model.geoms[pair.geom1].body, model.geoms[pair.geom2].body];
        let mut first = true;
        meet(model, placed, &{ pair }, listed, |part, touch| {
            let mask = touch.exists.and(touch.dist.lt(R::of(listed)));
            if mask.any() {
                if std::mem::take(&mut first) {
                    pair.dofs = lists.union(model, bodies);
                }
                take(Contact::of(&pair, part, touch, mask));
            }
        });
    }
}

/// The box that a geom stays in: its own, and `more` on each side.
fn bounds<R: Real>(model: &Model, placed: &Placed<R>, index: usize, more: f64) -> Bounds {
    let (geom, pose) = (&model.geoms[index], &placed.geom[index]);
    let centre = [pose.pos.x, pose.pos.y, pose.pos.z].map(|x| x.lane(0));
    let far = centre.iter().fold(geom.reach, |far, x| far.max(x.abs()));
    let more = more + ROUNDING * geom.reach + UNITS * R::EPSILON * far;
    let size: [f64; 3] = std::array::from_fn(|i| {
        let along = |j: usize| pose.rot[(i, j)].lane(0).abs() * geom.half[j];
        (along(0) + along(1) + along(2)).min(geom.reach) + more
    });
    Bounds {
        low: std::array::from_fn(|k| centre[k] - size[k]),
        high: std::array::from_fn(|k| centre[k] + size[k]),
        geom: index as u32,
        fixed: false,
    }
}
