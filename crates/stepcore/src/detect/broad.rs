//! The broad phase of a pile: which boxes overlap.
//!
//! Boxes of about one size are in one grid, whose cells are larger than any of them by at most a factor
//! of two. A box's lowest corner lies in one cell, and the lowest corner of every box that it overlaps
//! lies in one of the cells from one below that cell to the cell of its highest corner. Grids are by
//! powers of two of the boxes' sizes, and a box searches the grid of its size and the coarser ones (a
//! hierarchical grid: Ericson 2005, ch. 7.2). Cells are numbered by a hash, as nothing bounds the
//! world. A grid of few boxes, and boxes without end, are a list that every box is compared with. Boxes
//! that never move are in a tree that is made once.
//!
//! The result is every pair of boxes that overlap, whatever the grids: they change the work and not the
//! answer. The work grows with the number of boxes and of pairs found.

use crate::interrupt::{Meter, TEST};

/// Boxes of one size up to which a list is quicker than a grid.
const LISTED: usize = 32;
/// The values of a double's exponent: one size for each.
const SIZES: usize = 2048;

/// A box with its axes along the world's.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    pub low: [f64; 3],
    pub high: [f64; 3],
    /// The geom that it bounds.
    pub geom: u32,
    /// Nothing moves it: two such boxes never meet.
    pub fixed: bool,
}

impl Bounds {
    /// The two are not proven apart: a NaN overlaps everything.
    pub(super) fn overlaps(&self, other: &Self) -> bool {
        let apart = |k: usize| self.high[k] < other.low[k] || other.high[k] < self.low[k];
        let still = self.fixed && other.fixed;
        !(still || apart(0) || apart(1) || apart(2))
    }

    /// This box lies in another and both or neither are fixed, so the other overlaps all that it
    /// overlaps.
    pub(super) fn within(&self, other: &Self) -> bool {
        let inside = |k: usize| other.low[k] <= self.low[k] && self.high[k] <= other.high[k];
        self.fixed == other.fixed && inside(0) && inside(1) && inside(2)
    }

    fn finite(&self) -> bool {
        self.low.iter().chain(&self.high).all(|x| x.is_finite())
    }

    /// The exponent of the longest edge; None if it is NaN, or too small or large for a cell.
    fn size(&self) -> Option<usize> {
        let edge = |k: usize| self.high[k] - self.low[k];
        let longest = edge(0).max(edge(1)).max(edge(2));
        let size = (longest.to_bits() >> 52) as usize;
        (self.finite() && (1..SIZES - 3).contains(&size)).then_some(size)
    }
}

/// Boxes, their grids, and the pairs that overlap.
#[derive(Default)]
pub struct Broad {
    boxes: Vec<Bounds>,
    /// By size: the number of boxes; then one more than the place of its grid among the grids.
    sizes: Vec<u32>,
    /// Sizes that have a grid, ascending.
    grids: Vec<usize>,
    /// By box: its size; `SIZES` in the list.
    size: Vec<u32>,
    /// By hash of a cell: where its boxes start in `inside`.
    cells: Vec<u32>,
    inside: Vec<u32>,
    listed: Vec<u32>,
    pub found: Overlaps,
}

room!(Broad: boxes, sizes, grids, size, cells, inside, listed, found);

/// Pairs of geoms, the smaller one first; in no order, and possibly repeated.
#[derive(Default)]
pub struct Overlaps {
    pub pairs: Vec<(u32, u32)>,
    /// There are more pairs than the memory holds.
    pub full: bool,
}

room!(Overlaps: pairs, full);

impl Overlaps {
    pub fn clear(&mut self) {
        self.pairs.clear();
        self.full = false;
    }

    pub fn note(&mut self, one: &Bounds, two: &Bounds) {
        if !one.overlaps(two) {
            return;
        }
        let Self { pairs, full } = self;
        *full |= pairs.len() == pairs.capacity() && pairs.try_reserve(1).is_err();
        if !*full {
            pairs.push((one.geom.min(two.geom), one.geom.max(two.geom)));
        }
    }
}

impl Broad {
    /// Finds all pairs of `boxes` that overlap.
    pub fn find(&mut self, boxes: impl Iterator<Item = Bounds>) {
        self.boxes.clear();
        self.boxes.extend(boxes);
        self.sort_by_size();
        self.fill_cells();
        self.found.clear();
        self.compare_with_listed();
        let mut meter = Meter::default();
        for at in 0..self.boxes.len() {
            meter.count(TEST);
            if (self.size[at] as usize) < SIZES {
                self.compare_with_grids(at);
            }
        }
    }

    /// Decides which boxes have a grid, and which are listed.
    fn sort_by_size(&mut self) {
        self.sizes.clear();
        self.sizes.resize(SIZES, 0);
        self.size.clear();
        for bounds in &self.boxes {
            let size = bounds.size();
            size.into_iter().for_each(|size| self.sizes[size] += 1);
            self.size.push(size.unwrap_or(SIZES) as u32);
        }
        self.grids.clear();
        self.grids.extend((0..SIZES).filter(|size| self.sizes[*size] as usize > LISTED));
        self.listed.clear();
        for (at, size) in self.size.iter_mut().enumerate() {
            if *size as usize == SIZES || self.sizes[*size as usize] as usize <= LISTED {
                *size = SIZES as u32;
                self.listed.push(at as u32);
            }
        }
    }

    /// A counting sort of the boxes by the cell of their lowest corner.
    fn fill_cells(&mut self) {
        let count = (2 * self.boxes.len()).next_power_of_two();
        self.cells.clear();
        self.cells.resize(count + 1, 0);
        for at in 0..self.boxes.len() {
            if let Some(cell) = self.cell_of(at) {
                self.cells[cell] += 1;
            }
        }
        let mut start = 0;
        for cell in &mut self.cells {
            start += *cell;
            *cell = start;
        }
        self.inside.clear();
        self.inside.resize(start as usize, 0);
        // From the last box to the first: each cell's place moves down to where the cell starts.
        for at in (0..self.boxes.len()).rev() {
            if let Some(cell) = self.cell_of(at) {
                self.cells[cell] -= 1;
                self.inside[self.cells[cell] as usize] = at as u32;
            }
        }
    }

    fn cell_of(&self, at: usize) -> Option<usize> {
        let size = self.size[at] as usize;
        (size < SIZES).then(|| self.hash(size, self.boxes[at].low.map(|x| place(x, size))))
    }

    /// The number of a cell; different cells may share one.
    fn hash(&self, size: usize, [x, y, z]: [i64; 3]) -> usize {
        let mix = (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
            ^ (y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f)
            ^ (z as u64).wrapping_mul(0x1656_67b1_9e37_79f9)
            ^ (size as u64).wrapping_mul(0x27d4_eb2f_1656_67c5);
        let mix = (mix ^ (mix >> 32)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        (mix >> 32) as usize & (self.cells.len() - 2)
    }

    /// Compares the boxes of the list with one another, along x, and with all that have a grid.
    fn compare_with_listed(&mut self) {
        let Self { boxes, size, listed, found, .. } = self;
        // NaN has no place, and is sorted first.
        let begin = |at: &u32| {
            let bounds = &boxes[*at as usize];
            if bounds.finite() {
                bounds.low[0]
            } else {
                f64::NEG_INFINITY
            }
        };
        listed.sort_unstable_by(|a, b| begin(a).total_cmp(&begin(b)));
        let mut meter = Meter::default();
        for (k, &one) in listed.iter().enumerate() {
            meter.count(boxes.len());
            let one = &boxes[one as usize];
            let lies = one.finite();
            for &two in &listed[k + 1..] {
                let two = &boxes[two as usize];
                if lies && two.low[0] > one.high[0] {
                    break;
                }
                found.note(one, two);
            }
            for (other, _) in boxes.iter().zip(&*size).filter(|(_, s)| **s < SIZES as u32) {
                found.note(one, other);
            }
        }
    }

    /// Compares a box with the others of its grid in its cell and after it, and with all of coarser
    /// grids. For two boxes of one grid, the other's lowest corner lies in a cell from one below this
    /// one's on, so the box whose cell comes first, by z, y and x, finds both.
    fn compare_with_grids(&mut self, at: usize) {
        let (bounds, own) = (self.boxes[at], self.size[at] as usize);
        for grid in (0..self.grids.len()).rev() {
            let size = self.grids[grid];
            if size < own {
                break;
            }
            let cell = bounds.low.map(|x| place(x, size));
            let low = cell.map(|x| x.saturating_sub(1));
            let high = bounds.high.map(|x| place(x, size));
            let same = size == own;
            for z in (if same { cell[2] } else { low[2] })..=high[2] {
                let level = same && z == cell[2];
                for y in (if level { cell[1] } else { low[1] })..=high[1] {
                    let line = level && y == cell[1];
                    for x in (if line { cell[0] } else { low[0] })..=high[0] {
                        let home = line && x == cell[0];
                        self.compare_with_cell(&bounds, self.hash(size, [x, y, z]), |other| {
                            // Another cell with the same number holds this one too.
                            if home {
                                other > at
                            } else {
                                other != at
                            }
                        });
                    }
                }
            }
        }
    }

    fn compare_with_cell(&mut self, one: &Bounds, cell: usize, takes: impl Fn(usize) -> bool) {
        let inside = self.cells[cell] as usize..self.cells[cell + 1] as usize;
        for &other in &self.inside[inside] {
            if takes(other as usize) {
                self.found.note(one, &self.boxes[other as usize]);
            }
        }
    }
}

/// Boxes that never move, as a tree: the two halves of each range of them lie on two sides along the
/// longest edge of the box around all.
#[derive(Default)]
pub struct Fixed {
    /// Unbounded boxes and NaN: in no tree.
    endless: Vec<Bounds>,
    boxes: Vec<Bounds>,
    /// At the middle of each range: the box around it.
    around: Vec<Bounds>,
}

room!(Fixed: endless, boxes, around);

/// Boxes that are compared one by one.
const LEAF: usize = 4;

impl Fixed {
    pub fn of(all: &[Bounds]) -> Self {
        let (mut boxes, endless): (Vec<_>, _) = all.iter().partition(|bounds| bounds.finite());
        let mut around = boxes.clone();
        Self::split(&mut boxes, &mut around);
        Self { endless, boxes, around }
    }

    fn split(boxes: &mut [Bounds], around: &mut [Bounds]) {
        let Some(&first) = boxes.first() else { return };
        let whole = boxes.iter().fold(Bounds { fixed: false, ..first }, |whole, own| Bounds {
            low: crate::real::array::from_fn(|k| whole.low[k].min(own.low[k])),
            high: crate::real::array::from_fn(|k| whole.high[k].max(own.high[k])),
            ..whole
        });
        let middle = boxes.len() / 2;
        around[middle] = whole;
        if boxes.len() <= LEAF {
            return;
        }
        let edge = |k: &usize| whole.high[*k] - whole.low[*k];
        let axis = (0..3).max_by(|a, b| edge(a).total_cmp(&edge(b))).unwrap_or(0);
        let centre = |bounds: &Bounds| 0.5 * bounds.low[axis] + 0.5 * bounds.high[axis];
        boxes.select_nth_unstable_by(middle, |a, b| centre(a).total_cmp(&centre(b)));
        let (before, after) = boxes.split_at_mut(middle);
        let (around_before, around_after) = around.split_at_mut(middle);
        Self::split(before, around_before);
        Self::split(after, around_after);
    }

    /// Passes the fixed boxes that a box overlaps, and some others, to `take`.
    pub fn overlapped(&self, one: &Bounds, mut take: impl FnMut(&Bounds)) {
        if !one.fixed {
            self.endless.iter().for_each(&mut take);
            Self::search(&self.boxes, &self.around, one, &mut take);
        }
    }

    fn search(boxes: &[Bounds], around: &[Bounds], one: &Bounds, take: &mut impl FnMut(&Bounds)) {
        let middle = boxes.len() / 2;
        if around.get(middle).is_none_or(|around| !one.overlaps(around)) {
            return;
        }
        if boxes.len() <= LEAF {
            boxes.iter().for_each(take);
        } else {
            Self::search(&boxes[..middle], &around[..middle], one, take);
            Self::search(&boxes[middle..], &around[middle..], one, take);
        }
    }
}

/// Returns the cell of a coordinate on its axis; a cell is larger than boxes of this size.
fn place(x: f64, size: usize) -> i64 {
    // The reciprocal of 2 to the power of the size's exponent plus one. `floor` is a call.
    let reciprocal = f64::from_bits(((SIZES - 3 - size) as u64) << 52);
    let x = x * reciprocal;
    let whole = x as i64;
    whole.saturating_sub(i64::from((whole as f64) > x))
}
