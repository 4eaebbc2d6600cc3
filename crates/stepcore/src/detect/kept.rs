//! The near pairs of a heap, kept for as long as they hold.
//!
//! The broad phase looks at boxes that are a little larger than they need be. While every box stays
//! within the larger one, no two overlap but those found then (Verlet 1967 kept such lists of
//! molecules), and a detection asks of these alone which overlap now. So the pairs that are tested
//! exactly are those that a search in every detection would find, in the same order.

use super::broad::{Bounds, Broad};
use crate::error::{Error, Result};
use crate::model::{Heap, Model, Pair, Span};
use crate::room::{can_be_had, room};

/// Of a geom's reach: by how much its box is larger on each side.
const SPARE: f64 = 1.0 / 32.0;
/// Where things move so fast that a list served once, so many searches keep to the boxes at hand.
const PLAIN: u32 = 8;
/// Bytes of a near pair in these lists and of its contacts, and so many pairs that need no asking.
const NEAR: usize = 1000;
const FEW: usize = 50_000;

/// What the spans of rows point into: the model's lists, in a heap followed by the dofs of each
/// two bodies that are near.
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

/// Pairs that are near, and the boxes that say for how long.
#[derive(Default)]
pub(super) struct Kept {
    /// By place in `Heap::solid`: the boxes at hand, and those within which the pairs hold.
    boxes: Vec<Bounds>,
    spare: Vec<Bounds>,
    /// By geom: its place there.
    places: Vec<u32>,
    broad: Broad,
    /// Numbers and geoms of the pairs.
    numbers: Vec<(u64, u32, u32)>,
    pub pairs: Vec<Pair>,
    /// The last search has served another detection since.
    pub served: bool,
    /// So many searches to come keep to the boxes at hand.
    plain: u32,
    /// So many pairs were found to fit into the memory.
    fitting: usize,
}

room!(Kept: boxes, spare, places, numbers, pairs; broad);

impl Kept {
    /// Takes the boxes of all solid geoms, in their order, and brings the pairs up to date; refuses
    /// more pairs than the memory holds.
    pub fn refresh(
        &mut self,
        model: &Model,
        heap: &Heap,
        lists: &mut Lists,
        boxes: impl Iterator<Item = Bounds>,
    ) -> Result<()> {
        self.boxes.clear();
        self.boxes.extend(boxes);
        let holds = |(now, spare): (&Bounds, &Bounds)| now.within(spare);
        if self.spare.len() == self.boxes.len() && self.boxes.iter().zip(&self.spare).all(holds) {
            self.served = true;
            return Ok(());
        }
        self.widen(model);
        self.broad.find(self.spare.iter().copied());
        self.numbers.clear();
        lists.clear();
        self.pairs.clear();
        let near = self.broad.found.pairs.len();
        let fits = near <= self.fitting.max(FEW) || can_be_had(near.saturating_mul(NEAR));
        if self.broad.found.full || !fits {
            // The next detection searches anew.
            self.spare.clear();
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
        for &(number, a, b) in &self.numbers {
            let mut pair = model.near_pair(heap, number, a as usize, b as usize);
            let bodies = [pair.geom1, pair.geom2].map(|geom| model.geoms[geom].body);
            pair.dofs = lists.union(model, bodies);
            self.pairs.push(pair);
        }
        Ok(())
    }

    /// Makes the boxes within which a search is to hold.
    fn widen(&mut self, model: &Model) {
        if self.places.is_empty() {
            self.places.resize(model.geoms.len(), 0);
            for (place, bounds) in (0..).zip(&self.boxes) {
                self.places[bounds.geom as usize] = place;
            }
        }
        let fast = !self.served && !self.spare.is_empty() && self.plain == 0;
        self.plain = if fast { PLAIN } else { self.plain.saturating_sub(1) };
        self.served = false;
        self.spare.clear();
        for bounds in &self.boxes {
            let more =
                if self.plain > 0 { 0.0 } else { SPARE * model.geoms[bounds.geom as usize].reach };
            self.spare.push(bounds.widened(more));
        }
    }

    /// The boxes of a pair overlap now.
    #[inline(always)]
    pub fn overlap(&self, pair: &Pair) -> bool {
        let [one, two] = [pair.geom1, pair.geom2].map(|geom| self.places[geom] as usize);
        self.boxes[one].overlaps(&self.boxes[two])
    }
}
