//! Which dofs an island's rows couple.
//!
//! Two dofs are coupled when some row touches both. Eliminating from the last dof
//! to the first, as along the trees, fills nothing where rows touch one chain only.
//! The pattern depends on which rows exist and is kept while that stays the same;
//! an entry that a lane does not need is a zero that changes none of its bits.

use super::nodes::Nodes;
use super::order::ones;
use crate::model::Span;
use crate::solve::dofs::distinct;
use crate::solve::free::Free;
use std::ops::Range;

/// Which dofs an island's rows couple. Indices are local: places in `dofs`.
#[derive(Default)]
pub(super) struct Pattern {
    /// The dof list of each bundle: what the pattern was made for.
    key: Vec<Span>,
    /// Dofs that some row touches, ascending.
    pub dofs: Vec<usize>,
    pub bundles: Vec<Listed>,
    pub lists: Vec<usize>,
    /// Of bundles that need it: where in the matrix each pair of the list stands, row by row.
    pub places: Vec<usize>,
    /// Row i holds the entries `start[i]..start[i + 1]`, in the columns `cols` ≤ i, ascending.
    pub start: Vec<usize>,
    pub cols: Vec<usize>,
    /// By column: (row, entry) of what stands below, last row first.
    pub below_start: Vec<usize>,
    pub below: Vec<(usize, usize)>,
    /// Of a heap, in the place of all but `key` and `dofs`.
    pub nodes: Nodes,
    pub heap: bool,
    /// Scratch: bits by row; local index by dof; place by column.
    bits: Vec<u64>,
    local: Vec<usize>,
}

/// A bundle's dofs.
#[derive(Clone, Copy)]
pub(super) struct Listed {
    /// In `Pattern::lists`.
    pub list: Span,
    /// The first of its `places`; none where every row of the matrix begins with the list up to it,
    /// as along a chain.
    pub places: Option<usize>,
}

room!(Pattern: key, dofs, bundles, lists, places, start, cols, below_start, below, bits, local, nodes, heap);

impl Pattern {
    /// Makes the pattern of bundles on these dofs, unless it is the one at hand.
    /// `class`: scratch of `Nodes::fit`, a number for each dof.
    pub fn fit(
        &mut self,
        dof_lists: &[usize],
        heap: bool,
        keys: impl Iterator<Item = Span> + Clone,
        class: &mut [usize],
    ) {
        self.heap = heap;
        if heap {
            self.key.clear();
            self.key.extend(keys);
            self.nodes.fit(dof_lists, &self.key, class);
            return;
        }
        if keys.clone().eq(self.key.iter().copied()) {
            return;
        }
        self.key.clear();
        self.key.extend(keys);
        self.number(dof_lists, class.len());
        self.fill();
        self.list_below();
        self.place();
    }

    /// Local numbers of the dofs, and every bundle's list in them.
    fn number(&mut self, dof_lists: &[usize], nv: usize) {
        let lists = self.key.iter().map(|span| span.of(dof_lists));
        distinct(lists, nv, &mut self.dofs, &mut self.local);
        self.lists.clear();
        self.bundles.clear();
        for span in &self.key {
            let list = Span { start: self.lists.len(), len: span.len };
            self.lists.extend(span.of(dof_lists).iter().map(|k| self.local[*k]));
            self.bundles.push(Listed { list, places: None });
        }
    }

    /// Symbolic elimination: row k's columns reach every row that they name.
    fn fill(&mut self) {
        let n = self.dofs.len();
        let words = n.div_ceil(64);
        self.bits.clear();
        self.bits.resize((n + 1) * words, 0);
        let (rows, so_far) = self.bits.split_at_mut(n * words);
        for Listed { list, .. } in &self.bundles {
            so_far.fill(0);
            for i in list.of(&self.lists) {
                so_far[i / 64] |= 1 << (i % 64);
                for (row, so_far) in rows[i * words..].iter_mut().zip(&*so_far) {
                    *row |= so_far;
                }
            }
        }
        for k in (0..n).rev() {
            let (above, row) = self.bits.split_at_mut(k * words);
            let row = &row[..words];
            for i in ones(row).take_while(|i| *i < k) {
                let target = &mut above[i * words..(i + 1) * words];
                for (t, r) in target.iter_mut().zip(row) {
                    *t |= r;
                }
                // Only columns up to i.
                target[i / 64] &= u64::MAX >> (63 - i % 64);
                target[i / 64 + 1..].fill(0);
            }
        }
        self.start.clear();
        self.cols.clear();
        for i in 0..n {
            self.start.push(self.cols.len());
            self.cols.extend(ones(&self.bits[i * words..(i + 1) * words]));
        }
        self.start.push(self.cols.len());
    }

    /// Column lists.
    fn list_below(&mut self) {
        let n = self.dofs.len();
        self.below_start.clear();
        self.below_start.resize(n + 1, 0);
        for i in 0..n {
            for j in &self.cols[self.start[i]..self.start[i + 1] - 1] {
                self.below_start[j + 1] += 1;
            }
        }
        for j in 0..n {
            self.below_start[j + 1] += self.below_start[j];
        }
        self.below.clear();
        self.below.resize(self.cols.len() - n, (0, 0));
        let next = &mut self.local;
        next.clear();
        next.extend_from_slice(&self.below_start[..n]);
        for k in (0..n).rev() {
            for at in self.start[k]..self.start[k + 1] - 1 {
                let slot = &mut next[self.cols[at]];
                self.below[*slot] = (k, at);
                *slot += 1;
            }
        }
    }

    /// The place of every pair of every list, where it does not follow from the list alone.
    fn place(&mut self) {
        let Self { bundles, lists, places, start, cols, local, .. } = self;
        places.clear();
        local.clear();
        local.resize(self.dofs.len(), 0);
        for Listed { list, places: first, .. } in bundles {
            let list = list.of(lists);
            let size = |i: usize| start[i + 1] - start[i];
            if list.iter().enumerate().all(|(at, i)| size(*i) == at + 1) {
                continue;
            }
            *first = Some(places.len());
            for (at, i) in list.iter().enumerate() {
                for place in start[*i]..start[i + 1] {
                    local[cols[place]] = place;
                }
                places.extend(list[..=at].iter().map(|j| local[*j]));
            }
        }
    }

    /// The dofs by their local numbers.
    pub fn dofs(&self) -> &[usize] {
        if self.heap {
            &self.nodes.dofs
        } else {
            &self.dofs
        }
    }

    /// A bundle's dofs in local numbers.
    pub fn list(&self, bundle: usize) -> &[usize] {
        if self.heap {
            return self.nodes.local(bundle);
        }
        self.bundles[bundle].list.of(&self.lists)
    }

    /// Of a heap: the bundle's dofs, where they are those of free bodies.
    #[inline(always)]
    pub fn free(&self, bundle: usize) -> Option<&Free> {
        if self.heap {
            self.nodes.free[bundle].as_ref()
        } else {
            None
        }
    }

    /// Where a row of the matrix stands.
    pub fn row(&self, i: usize) -> Range<usize> {
        self.start[i]..self.start[i + 1]
    }
}
