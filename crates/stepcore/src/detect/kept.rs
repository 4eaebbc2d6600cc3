//! The near pairs of a pile, kept for as long as they are valid.
//!
//! The broad phase searches boxes that are a little larger than necessary. While every box stays within
//! its larger one, no pairs overlap but those found then (Verlet 1967 kept such lists of molecules),
//! and a detection checks only these for overlap now. So the pairs that are tested exactly are those
//! that a search in every detection would find, in the same order.

use super::broad::{Bounds, Broad, Fixed};
use crate::error::{Error, Result};
use crate::interrupt::{Meter, TEST};
use crate::model::{DynamicPairs, Model, Pair, Span};
use crate::real::array::from_fn;
use crate::real::Constant;
use crate::room::can_be_had;

/// Margin of a box on each side, as a part of its geom's reach.
const SPARE: f64 = 1.0 / 32.0;
/// A box also extends ahead by the motion of this many detections, up to its geom's reach. With an arm
/// in a kitchen of 240 geoms all pairs are searched for in one detection of 30, not in every one.
const AHEAD: f64 = 8.0;
/// If things move so fast that a list served once, this many searches use the present boxes.
const PLAIN: u32 = 8;
/// If fewer than one in this many of the boxes that may move have left theirs, the others keep their
/// pairs.
const MANY_LEFT: usize = 4;
/// Bytes of a near pair in these lists and of its contacts, and the number of pairs that needs no check.
const NEAR: usize = 1000;
const FEW: usize = 50_000;

/// The lists that the spans of rows point into: the model's, in a pile followed by the dofs of each two
/// bodies that are near.
pub(crate) struct Lists {
    /// Empty if no pair is found live.
    own: Vec<usize>,
    /// The length of the model's part.
    fixed: usize,
}

room!(Lists: own, fixed);

impl Lists {
    pub fn new<N: Constant>(model: &Model<N>) -> Self {
        let own = if model.dynamic_pairs.is_some() { model.dof_lists.clone() } else { vec![] };
        Self { fixed: own.len(), own }
    }

    pub fn of<'a, N: Constant>(&'a self, model: &'a Model<N>) -> &'a [usize] {
        if model.dynamic_pairs.is_some() {
            &self.own
        } else {
            &model.dof_lists
        }
    }

    fn clear(&mut self) {
        self.own.truncate(self.fixed);
    }

    /// The dofs that move either body, ascending.
    fn union<N: Constant>(&mut self, model: &Model<N>, bodies: [usize; 2]) -> Span {
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

/// Pairs that are near, and the boxes that limit how long they are valid.
#[derive(Default)]
pub(super) struct Kept {
    /// By place in `DynamicPairs::solid`: the present boxes; for those that may move also the boxes
    /// within which the pairs are valid.
    boxes: Vec<Bounds>,
    spare: Vec<Bounds>,
    /// Movement of each movable box before the last detection, and before the one before it.
    moved: Vec<[[f64; 3]; 2]>,
    /// The law under which the boxes of fixed geoms were made reads the guess.
    guessed: bool,
    fixed: Fixed,
    /// Places of boxes that have left theirs, ascending.
    left: Vec<u32>,
    /// By geom: its place in `DynamicPairs::solid`.
    places: Vec<u32>,
    broad: Broad,
    /// Numbers and geoms of the pairs, and of the pairs before.
    numbers: Vec<(u64, u32, u32)>,
    before: Vec<(u64, u32, u32)>,
    pub pairs: Vec<Pair>,
    /// The last search has served another detection since.
    pub served: bool,
    /// This many further searches use the present boxes.
    plain: u32,
    /// This many pairs were found to fit into the memory.
    fitting: usize,
}

room!(Kept: boxes, spare, moved, guessed, fixed, left, places, broad, numbers, before, pairs, served,
    plain, fitting);

/// Returns a box in which its geom is to stay for a while. It extends ahead as far as both last moves
/// agree: one of them alone may be a jump.
fn widened<N: Constant>(model: &Model<N>, bounds: &Bounds, moved: &[[f64; 3]; 2]) -> Bounds {
    let reach = model.geoms[bounds.geom as usize].reach.lane(0);
    let [last, before] = moved;
    let ahead: [f64; 3] = from_fn(|k| {
        let way = AHEAD * last[k].abs().min(before[k].abs());
        let part = last[k] / before[k];
        let steady = part > 0.5 && part < 2.0 && way <= reach;
        if steady {
            way.copysign(last[k])
        } else {
            0.0
        }
    });
    Bounds {
        low: from_fn(|k| bounds.low[k] - SPARE * reach + ahead[k].min(0.0)),
        high: from_fn(|k| bounds.high[k] + SPARE * reach + ahead[k].max(0.0)),
        ..*bounds
    }
}

impl Kept {
    /// Takes the boxes of all solid geoms, made by `bounds`, and brings the pairs up to date; more pairs
    /// than the memory holds are an error.
    pub fn refresh<N: Constant>(
        &mut self,
        model: &Model<N>,
        heap: &DynamicPairs,
        lists: &mut Lists,
        guessed: bool,
        bounds: impl Fn(usize) -> Bounds,
    ) -> Result<()> {
        self.take_boxes(model, heap, guessed, bounds);
        let moving = &self.boxes[..heap.moving];
        self.left.clear();
        if self.spare.len() == heap.moving {
            let places = (0..).zip(moving.iter().zip(&self.spare));
            self.left
                .extend(places.filter(|(_, (now, spare))| !now.within(spare)).map(|own| own.0));
            if self.left.is_empty() {
                self.served = true;
                return Ok(());
            }
        }
        let few_left = !self.left.is_empty() && self.left.len() <= heap.moving / MANY_LEFT;
        std::mem::swap(&mut self.numbers, &mut self.before);
        self.numbers.clear();
        self.numbers.reserve(self.before.capacity());
        if few_left {
            self.search_again(model);
        } else {
            self.widen(model, heap);
            self.left.clear();
            self.left.extend(0..heap.moving as u32);
            self.broad.find(self.spare.iter().copied());
        }
        let found = &mut self.broad.found;
        for &place in &self.left {
            let own = &self.spare[place as usize];
            self.fixed.overlapped(own, |other| found.note(own, other));
        }
        self.number(model, heap)?;
        if self.numbers == self.before {
            return Ok(());
        }
        lists.clear();
        self.pairs.clear();
        let mut meter = Meter::default();
        for &(number, a, b) in &self.numbers {
            meter.count(TEST);
            let mut pair = model.near_pair(heap, number, a as usize, b as usize);
            let bodies = [pair.geom1, pair.geom2].map(|geom| model.geoms[geom].body);
            pair.dofs = lists.union(model, bodies);
            self.pairs.push(pair);
        }
        Ok(())
    }

    /// Takes the present boxes; fixed geoms' boxes are made once.
    fn take_boxes<N: Constant>(
        &mut self,
        model: &Model<N>,
        heap: &DynamicPairs,
        guessed: bool,
        bounds: impl Fn(usize) -> Bounds,
    ) {
        let all = heap.solid.iter().map(|&geom| bounds(geom));
        if self.boxes.len() == heap.solid.len() && self.guessed == guessed {
            let moving = self.boxes[..heap.moving].iter_mut().zip(&mut self.moved);
            for ((own, moved), now) in moving.zip(all) {
                *moved = [from_fn(|k| now.low[k] - own.low[k]), moved[0]];
                *own = now;
            }
            return;
        }
        self.guessed = guessed;
        self.boxes.clear();
        self.boxes.extend(all);
        self.fixed = Fixed::of(&self.boxes[heap.moving..]);
        self.spare.clear();
        self.moved.clear();
        self.moved.resize(heap.moving, [[0.0; 3]; 2]);
        self.places.resize(model.geoms.len(), 0);
        for (place, bounds) in (0..).zip(&self.boxes) {
            self.places[bounds.geom as usize] = place;
        }
    }

    /// Keeps the pairs of boxes that stay within theirs, and finds the pairs of the others.
    fn search_again<N: Constant>(&mut self, model: &Model<N>) {
        let Self { boxes, spare, moved, left, places, broad, numbers, before, served, .. } = self;
        *served = true;
        for &place in &*left {
            let place = place as usize;
            spare[place] = widened(model, &boxes[place], &moved[place]);
        }
        let leaves = |geom: u32| left.binary_search(&places[geom as usize]).is_ok();
        numbers.extend(before.iter().filter(|(_, a, b)| !leaves(*a) && !leaves(*b)));
        broad.found.clear();
        let mut meter = Meter::default();
        for &place in &*left {
            meter.count(spare.len());
            let own = &spare[place as usize];
            let others = spare.iter().filter(|other| other.geom != own.geom);
            others.for_each(|other| broad.found.note(own, other));
        }
    }

    /// Numbers the pairs found; more than the memory holds is an error, and a new search follows.
    fn number<N: Constant>(&mut self, model: &Model<N>, heap: &DynamicPairs) -> Result<()> {
        let near = self.broad.found.pairs.len() + self.numbers.len();
        let fits = near <= self.fitting.max(FEW) || can_be_had(near.saturating_mul(NEAR));
        if self.broad.found.full || !fits {
            self.spare.clear();
            self.numbers.clear();
            self.pairs.clear();
            return Err(Error::value(
                "near pairs of geoms",
                near,
                "as many as the memory can hold",
            ));
        }
        self.fitting = self.fitting.max(near);
        for &(a, b) in &self.broad.found.pairs {
            if let Some(number) = model.number(heap, a as usize, b as usize) {
                self.numbers.push((number, a, b));
            }
        }
        self.numbers.sort_unstable();
        self.numbers.dedup();
        Ok(())
    }

    /// Makes the boxes within which a search is valid.
    fn widen<N: Constant>(&mut self, model: &Model<N>, heap: &DynamicPairs) {
        let fast = !self.served && !self.spare.is_empty() && self.plain == 0;
        self.plain = if fast { PLAIN } else { self.plain.saturating_sub(1) };
        self.served = false;
        self.spare.clear();
        for (bounds, moved) in self.boxes[..heap.moving].iter().zip(&self.moved) {
            let wide = if self.plain > 0 { *bounds } else { widened(model, bounds, moved) };
            self.spare.push(wide);
        }
    }

    /// Checks whether the boxes of a pair overlap now.
    #[inline(always)]
    pub fn overlap(&self, pair: &Pair) -> bool {
        let [one, two] = [pair.geom1, pair.geom2].map(|geom| self.places[geom] as usize);
        self.boxes[one].overlaps(&self.boxes[two])
    }
}
