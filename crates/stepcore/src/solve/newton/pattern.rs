//! Which dofs an island's rows couple.
//!
//! Two dofs are coupled when some row touches both. Elimination from the last dof to the first, as
//! along the trees, makes a tree of them: the parent of a dof is the last of the earlier dofs
//! coupled with it at its turn (Liu 1990). A row of the matrix holds the numbers along its dof's
//! path from the root, so that the row of a dof on the path aligns with the start of it. If rows
//! touch one chain only, there is no fill-in.
//! The pattern depends on which rows exist and is kept while they stay the same; an entry that a
//! lane does not need is a zero that changes none of its bits.

use super::nodes::Nodes;
use crate::model::Span;
use crate::solve::dofs::distinct;
use crate::solve::free_bodies::FreeBodies;
use crate::spatial::WIDE;

/// Which dofs an island's rows couple. Indices are local: places in `dofs`.
#[derive(Default)]
pub(super) struct Pattern {
    /// The dof list of each bundle: the input of the pattern.
    key: Vec<Span>,
    /// Dofs that some row touches, ascending.
    pub dofs: Vec<usize>,
    pub bundles: Vec<Listed>,
    /// The dofs of each bundle, with the last repeated up to a whole number of registers.
    pub lists: Vec<usize>,
    /// For bundles that need it: the place in the matrix of each pair of the list, row by row.
    pub places: Vec<usize>,
    /// Per dof: the start of its row, and the number of dofs before it on its path.
    pub start: Vec<usize>,
    pub depth: Vec<usize>,
    /// Numbers of the matrix; a row has room for a multiple of `WIDE`.
    pub size: usize,
    /// Per entry: its dof.
    pub path: Vec<usize>,
    /// Per dof: the dofs on whose paths it is, the last first.
    pub below_start: Vec<usize>,
    pub below: Vec<usize>,
    /// For a pile, replaces everything but `key` and `dofs`.
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
    /// The first of its `places`; None if the list is the path of its last dof.
    pub places: Option<usize>,
}

room!(Pattern: key, dofs, bundles, lists, places, start, depth, size, path, below_start, below, bits, local, nodes, heap);

impl Pattern {
    /// Computes the pattern of bundles on these dofs, unless it is up to date. `class`: scratch of
    /// `Nodes::fit`, a number for each dof.
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
        if keys.clone().eq(self.key.iter().copied()) && self.is_of(dof_lists) {
            return;
        }
        self.key.clear();
        self.key.extend(keys);
        self.number(dof_lists, class.len());
        self.fill();
        self.list_below();
        self.place();
    }

    /// Returns whether these spans still hold the dofs of the pattern: pairs that are found step by
    /// step have other lists in each.
    fn is_of(&self, dof_lists: &[usize]) -> bool {
        let own = |listed: &Listed| listed.list.of(&self.lists).iter().map(|k| self.dofs[*k]);
        let mut every = self.key.iter().zip(&self.bundles);
        self.key.len() == self.bundles.len()
            && every.all(|(span, listed)| span.of(dof_lists).iter().copied().eq(own(listed)))
    }

    /// Number the dofs, and convert every bundle's list.
    fn number(&mut self, dof_lists: &[usize], nv: usize) {
        let lists = self.key.iter().map(|span| span.of(dof_lists));
        distinct(lists, nv, &mut self.dofs, &mut self.local);
        self.lists.clear();
        self.bundles.clear();
        for span in &self.key {
            let list = Span { start: self.lists.len(), len: span.len };
            self.lists.extend(span.of(dof_lists).iter().map(|k| self.local[*k]));
            let last = self.lists.last().copied().unwrap_or(0);
            self.lists.resize(list.start + span.len.next_multiple_of(WIDE), last);
            self.bundles.push(Listed { list, places: None });
        }
    }

    /// Finds the paths: the dofs that a row couples reach its parent.
    fn fill(&mut self) {
        const NONE: usize = usize::MAX;
        let n = self.dofs.len();
        let words = n.div_ceil(64);
        self.bits.clear();
        self.bits.resize(n * words, 0);
        for Listed { list, .. } in &self.bundles {
            // Each dof of a list is linked with the one before it, and through that with the others.
            for pair in list.of(&self.lists).windows(2) {
                self.bits[pair[1] * words + pair[0] / 64] |= 1 << (pair[0] % 64);
            }
        }
        let parents = &mut self.local;
        parents.clear();
        parents.resize(n, NONE);
        for k in (0..n).rev() {
            let (above, row) = self.bits.split_at_mut(k * words);
            let row = &mut row[..words];
            let Some(word) = row.iter().rposition(|word| *word != 0) else { continue };
            let parent = 64 * word + 63 - row[word].leading_zeros() as usize;
            parents[k] = parent;
            row[parent / 64] &= !(1 << (parent % 64));
            for (to, from) in above[parent * words..].iter_mut().zip(row) {
                *to |= *from;
            }
        }
        self.start.clear();
        self.depth.clear();
        self.path.clear();
        for (k, parent) in parents.iter().enumerate() {
            let start = self.path.len();
            self.start.push(start);
            if *parent == NONE {
                self.depth.push(0);
            } else {
                let (above, depth) = (self.start[*parent], self.depth[*parent] + 1);
                self.path.extend_from_within(above..above + depth);
                self.depth.push(depth);
            }
            self.path.push(k);
            self.path.resize(start + (self.depth[k] + 1).next_multiple_of(WIDE), k);
        }
        self.size = self.path.len();
    }

    /// Lists the dofs whose paths go through each dof.
    fn list_below(&mut self) {
        let Self { start, depth, path, below_start, below, local: next, .. } = self;
        let n = self.dofs.len();
        below_start.clear();
        below_start.resize(n + 1, 0);
        let before = |k: usize| start[k]..start[k] + depth[k];
        for k in 0..n {
            path[before(k)].iter().for_each(|j| below_start[j + 1] += 1);
        }
        for j in 0..n {
            below_start[j + 1] += below_start[j];
        }
        below.clear();
        below.resize(below_start[n], 0);
        next.clear();
        next.extend_from_slice(&below_start[..n]);
        for k in (0..n).rev() {
            for j in &path[before(k)] {
                below[next[*j]] = k;
                next[*j] += 1;
            }
        }
    }

    /// Finds the place of every pair of every list, unless it follows from the list alone.
    fn place(&mut self) {
        let Self { bundles, lists, places, start, depth, .. } = self;
        places.clear();
        for Listed { list, places: first, .. } in bundles {
            let list = list.of(lists);
            if list.iter().enumerate().all(|(at, i)| depth[*i] == at) {
                continue;
            }
            *first = Some(places.len());
            for (at, i) in list.iter().enumerate() {
                places.extend(list[..=at].iter().map(|j| start[*i] + depth[*j]));
            }
        }
    }

    /// Returns the dofs by their local numbers.
    pub fn dofs(&self) -> &[usize] {
        if self.heap {
            &self.nodes.dofs
        } else {
            &self.dofs
        }
    }

    /// Returns a bundle's dofs in local numbers.
    pub fn list(&self, bundle: usize) -> &[usize] {
        if self.heap {
            return self.nodes.local(bundle);
        }
        self.bundles[bundle].list.of(&self.lists)
    }

    /// The same, with the last dof repeated up to a whole number of registers; unpadded in a pile.
    pub fn padded(&self, bundle: usize) -> &[usize] {
        if self.heap {
            return self.nodes.local(bundle);
        }
        let Span { start, len } = self.bundles[bundle].list;
        &self.lists[start..start + len.next_multiple_of(WIDE)]
    }

    /// In a pile: returns the bundle's dofs, if they belong to free bodies.
    #[inline(always)]
    pub fn free(&self, bundle: usize) -> Option<&FreeBodies> {
        if self.heap {
            self.nodes.free[bundle].as_ref()
        } else {
            None
        }
    }
}
