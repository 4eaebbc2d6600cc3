//! The pairs of a heap: found where the boxes of two geoms overlap, in every detection anew.

use super::apart::far;
use super::broad::Bounds;
use super::{meet, Detected};
use crate::model::{Heap, Model, Pair, Span};
use crate::place::Placed;
use crate::real::{Mask, Real};
use crate::room::room;
use crate::settings::Settings;

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
        for at in 0..self.near.len() {
            let (number, a, b) = self.near[at];
            let pair = model.near_pair(heap, number, a as usize, b as usize);
            self.meet_near(model, placed, pair, on_guess);
        }
    }

    fn meet_near(&mut self, model: &Model, placed: &Placed<R>, mut pair: Pair, on_guess: bool) {
        let more = on_guess.then(|| self.swept.of(&pair));
        if far(model, placed, &pair, more) {
            return;
        }
        let material = model.material(&pair);
        let listed = if on_guess { f64::INFINITY } else { material.margin + material.gap };
        let bodies = [model.geoms[pair.geom1].body, model.geoms[pair.geom2].body];
        let before = self.contacts.len();
        meet(model, placed, &{ pair }, listed, |part, touch| {
            let mask = touch.exists.and(touch.dist.lt(R::of(listed)));
            if mask.any() {
                if self.contacts.len() == before {
                    pair.dofs = self.lists.union(model, bodies);
                }
                self.push(&pair, part, touch, mask);
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
