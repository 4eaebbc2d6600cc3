//! The few rows of each lane, slot by slot.
//!
//! Parallel worlds touch with different rows: a lane has a third or less of the rows that exist in
//! some lane. Its first row goes to the first slot, its second to the second. So the number of
//! slots is the row count of the longest lane, and products, elimination and guesses, whose work
//! grows with its square and cube, skip other lanes' rows. A lane's rows, and every sum over them,
//! keep their order. If that saves little, every row keeps one slot.

use super::super::rows::Rows;
use super::{Island, MOST};
use crate::model::Span;
use crate::real::{Mask, Real, WIDEST};

/// Moving the rows pays if it saves this many products of rows: hopper and ant lie on either side.
const WORTH: usize = 100;

/// The rows of an island, and the dofs that they touch.
pub(super) struct Gathered<R: Real> {
    /// Rows that some lane has, and those lanes.
    pub rows: Vec<usize>,
    pub masks: Vec<R::Mask>,
    /// Whether each lane's rows were moved to its first slots.
    pub moved: bool,
    /// Lanes with a row in the slot, and its places: all places if rows were moved.
    pub slots: Vec<R::Mask>,
    lists: Vec<Span>,
    /// Dofs that some row touches, one place each.
    pub dofs: Vec<usize>,
    places: Vec<usize>,
    /// Per dof: its place, if any.
    place: Vec<usize>,
}

room!(Gathered<R>: rows, masks, moved, slots, lists, dofs, places, place);

impl<R: Real> Gathered<R> {
    pub fn new() -> Self {
        Self {
            rows: Vec::new(),
            masks: Vec::new(),
            moved: false,
            slots: Vec::new(),
            lists: Vec::new(),
            dofs: Vec::new(),
            places: Vec::new(),
            place: Vec::new(),
        }
    }

    /// Gathers the rows of some blocks in the lanes `mine`.
    pub fn take(&mut self, island: Island<R>, rows: &Rows<R>, mine: R::Mask) {
        self.rows.clear();
        self.masks.clear();
        for block in island.blocks.iter().map(|b| &rows.blocks[*b]) {
            let mask = block.mask.and(mine);
            if mask.any() {
                self.rows.extend(block.rows.range());
                self.masks.resize(self.rows.len(), mask);
            }
        }
        self.dofs.clear();
        self.places.clear();
        self.lists.clear();
        self.slots.clear();
        let counts = self.worth_moving();
        self.moved = counts.is_some();
        self.find_places(island, rows);
        match counts {
            None => self.slots.extend_from_slice(&self.masks),
            Some(counts) => {
                let most = counts.into_iter().max().unwrap_or(0);
                let mask = |slot| R::Mask::from_lanes(|lane| slot < counts[lane]);
                self.slots.extend((0..most).map(mask));
            }
        }
    }

    /// Returns the number of rows of each lane, if moving them pays.
    fn worth_moving(&self) -> Option<[usize; WIDEST]> {
        let all = self.rows.len();
        if R::ALONE || all * all < WORTH {
            return None;
        }
        let mut counts = [0; WIDEST];
        each_slot(&self.masks, |_, lane, slot| counts[lane] = slot + 1);
        let most = counts.into_iter().max().unwrap_or(0);
        (all > MOST || all * all >= most * most + WORTH).then_some(counts)
    }

    /// Number the dofs, and express every slot's list in these numbers.
    fn find_places(&mut self, island: Island<R>, rows: &Rows<R>) {
        let Self { rows: list, lists, dofs, places, place, .. } = self;
        place.resize(rows.u.len(), 0);
        let mut last = None;
        for span in list.iter().map(|r| rows.rows[*r].dofs) {
            if last.replace(span) != Some(span) {
                lists.push(Span { start: places.len(), len: span.len });
                for k in span.of(island.dof_lists) {
                    if dofs.get(place[*k]) != Some(k) {
                        place[*k] = dofs.len();
                        dofs.push(*k);
                    }
                    places.push(place[*k]);
                }
            } else if let Some(list) = lists.last().copied() {
                lists.push(list);
            }
        }
        if self.moved {
            // A lane's sums run over its dofs in order, with zeros between them.
            dofs.sort_unstable();
            dofs.iter().enumerate().for_each(|(at, k)| place[*k] = at);
            places.clear();
            places.extend(0..dofs.len());
            lists.fill(Span { start: 0, len: dofs.len() });
        }
    }

    /// Returns the places of a slot's dofs.
    #[inline(always)]
    pub fn places(&self, slot: usize) -> &[usize] {
        self.lists[slot].of(&self.places)
    }

    /// Returns the place of a dof that some row touches.
    #[inline(always)]
    pub fn place(&self, dof: usize) -> usize {
        self.place[dof]
    }
}

/// Calls `each(row, lane, slot)` for every row of every lane.
#[inline(always)]
pub(super) fn each_slot<M: Mask>(masks: &[M], mut each: impl FnMut(usize, usize, usize)) {
    let mut next = [0; WIDEST];
    for (i, mask) in masks.iter().enumerate() {
        for (lane, slot) in next[..M::LANES].iter_mut().enumerate() {
            if mask.lane(lane) {
                each(i, lane, *slot);
                *slot += 1;
            }
        }
    }
}
