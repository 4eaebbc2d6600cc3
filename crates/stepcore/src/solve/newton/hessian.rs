//! The Hessian D + Σ y s″ yᵀ of one island: its pattern, and LᵀDL without square roots.
//!
//! Two dofs are coupled when some row touches both. Eliminating from the last dof
//! to the first, as along the trees, fills nothing where rows touch one chain only.
//! The pattern depends on which rows exist and is kept while that stays the same;
//! an entry that a lane does not need is a zero that changes none of its bits.

use super::bundles::{Bundle, Problem};
use super::nodes::Nodes;
use super::order::ones;
use crate::model::Span;
use crate::real::{Mask, Real};
use crate::solve::dofs::distinct;
use crate::solve::free::Free;
use crate::solve::rows::NARROW;

/// Which dofs an island's rows couple. Indices are local: places in `dofs`.
#[derive(Default)]
pub(super) struct Pattern {
    /// The dof list of each bundle: what the pattern was made for.
    key: Vec<Span>,
    /// Dofs that some row touches, ascending.
    dofs: Vec<usize>,
    /// By bundle: its list in `lists`, and the first of its entries in `places`.
    bundles: Vec<(Span, usize)>,
    lists: Vec<usize>,
    /// Where in the matrix each pair of a list stands, later dof first.
    places: Vec<usize>,
    /// Row i holds the entries `start[i]..start[i + 1]`, in the columns `cols` < i, ascending.
    start: Vec<usize>,
    cols: Vec<usize>,
    /// By column: (row, entry) of what stands below, last row first.
    below_start: Vec<usize>,
    below: Vec<(usize, usize)>,
    /// Of a heap, in the place of all but `key` and `dofs`.
    pub nodes: Nodes,
    pub heap: bool,
    /// Scratch: bits by row; local index by dof; place by column.
    bits: Vec<u64>,
    local: Vec<usize>,
}

room!(Pattern: key, dofs, bundles, lists, places, start, cols, below_start, below, nodes, heap,
    bits, local);

impl Pattern {
    /// Makes the pattern of these bundles, unless it is the one at hand.
    /// `class`: scratch of `Nodes::fit`, a number for each dof.
    pub fn fit(
        &mut self,
        dof_lists: &[usize],
        heap: bool,
        bundles: &[Bundle],
        class: &mut [usize],
    ) {
        let keys = bundles.iter().map(|bundle| bundle.dofs);
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
        self.place();
    }

    /// Local numbers of the dofs, and every bundle's list in them.
    fn number(&mut self, dof_lists: &[usize], nv: usize) {
        let lists = self.key.iter().map(|span| span.of(dof_lists));
        distinct(lists, nv, &mut self.dofs, &mut self.local);
        self.lists.clear();
        self.bundles.clear();
        let mut places = 0;
        for span in &self.key {
            let list = Span { start: self.lists.len(), len: span.len };
            self.lists.extend(span.of(dof_lists).iter().map(|k| self.local[*k]));
            self.bundles.push((list, places));
            places += span.len * span.len.saturating_sub(1) / 2;
        }
        self.places.clear();
        self.places.resize(places, 0);
    }

    /// Symbolic elimination: row k's columns reach every row that they name.
    fn fill(&mut self) {
        let n = self.dofs.len();
        let words = n.div_ceil(64);
        self.bits.clear();
        self.bits.resize(n * words, 0);
        for (list, _) in &self.bundles {
            let list = list.of(&self.lists);
            for (at, i) in list.iter().enumerate() {
                for j in &list[..at] {
                    self.bits[i * words + j / 64] |= 1 << (j % 64);
                }
            }
        }
        for k in (0..n).rev() {
            let (above, row) = self.bits.split_at_mut(k * words);
            let row = &row[..words];
            for i in ones(row) {
                let target = &mut above[i * words..(i + 1) * words];
                for (t, r) in target.iter_mut().zip(row) {
                    *t |= r;
                }
                // Only columns before i.
                target[i / 64] &= (1u64 << (i % 64)) - 1;
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

    /// Column lists, and the place of every pair of every list.
    fn place(&mut self) {
        let n = self.dofs.len();
        self.below_start.clear();
        self.below_start.resize(n + 1, 0);
        for j in &self.cols {
            self.below_start[j + 1] += 1;
        }
        for j in 0..n {
            self.below_start[j + 1] += self.below_start[j];
        }
        self.below.clear();
        self.below.resize(self.cols.len(), (0, 0));
        let next = &mut self.local;
        next.clear();
        next.extend_from_slice(&self.below_start[..n]);
        for k in (0..n).rev() {
            for at in self.start[k]..self.start[k + 1] {
                let slot = &mut next[self.cols[at]];
                self.below[*slot] = (k, at);
                *slot += 1;
            }
        }
        // From here `local` holds, for one row at a time, the place of each column.
        next.clear();
        next.resize(n, 0);
        for (list, first) in &self.bundles {
            let list = list.of(&self.lists);
            let mut at = *first;
            for (len, i) in list.iter().enumerate() {
                for place in self.start[*i]..self.start[i + 1] {
                    next[self.cols[place]] = place;
                }
                for j in &list[..len] {
                    self.places[at] = next[*j];
                    at += 1;
                }
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
        self.bundles[bundle].0.of(&self.lists)
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
}

/// Numbers on a pattern: the matrix, then its factors.
pub(super) struct Hessian<R> {
    entries: Vec<R>,
    diagonal: Vec<R>,
    inverse: Vec<R>,
    work: Vec<R>,
    /// Scratch: the lower half of what one bundle's dofs have, row by row; s″ y of a row.
    part: Vec<R>,
    bent: Vec<R>,
}

room!(Hessian<R>: entries, diagonal, inverse, work, part, bent);

impl<R: Real> Hessian<R> {
    pub fn new() -> Self {
        Self {
            entries: Vec::new(),
            diagonal: Vec::new(),
            inverse: Vec::new(),
            work: Vec::new(),
            part: Vec::new(),
            bent: Vec::new(),
        }
    }

    /// Makes H = D + Σ y s″ yᵀ of the curvature s″ and its factors.
    pub fn make(&mut self, problem: Problem<R>, d: &[R], curve: &[R]) {
        self.reset(problem.pattern, d);
        for (b, bundle) in problem.bundles.list.iter().enumerate() {
            // Rows at a bound, and cones that are open, have none.
            let bends = |curve: &R| curve.abs().gt(R::zero()).any();
            if !bundle.curve.of(curve).iter().any(bends) {
                continue;
            }
            self.open(problem.pattern, b);
            for run in problem.bundles.runs_of(bundle) {
                let len = bundle.dofs.len;
                let from = bundle.y + (run.rows.start - bundle.rows.start) * len;
                let y = &problem.rows.y[from..from + run.rows.len * len];
                let mask = &problem.bundles.mask[run.rows.range()];
                let curve = run.curve.of(curve);
                if run.cone.is_some() {
                    self.add_cone(len, y, curve, mask[0]);
                    continue;
                }
                for ((y, curve), mask) in y.chunks_exact(len.max(1)).zip(curve).zip(mask) {
                    if curve.gt(R::zero()).any() {
                        self.bent.clear();
                        self.bent.extend(y.iter().map(|y| *curve * *y));
                        self.add(y, *mask);
                    }
                }
            }
            self.close(problem.pattern, b);
        }
        self.factor(problem.pattern);
    }

    /// A cone's rows, by its curvature row by row.
    fn add_cone(&mut self, len: usize, y: &[R], curve: &[R], mask: R::Mask) {
        if curve.len() == NARROW * NARROW {
            return self.add_narrow(len, y, curve, mask);
        }
        let y = || y.chunks_exact(len.max(1));
        let rows = y().len();
        for (left, curve) in y().zip(curve.chunks_exact(rows)) {
            self.bent.clear();
            self.bent.resize(len, R::zero());
            for (y, curve) in y().zip(curve) {
                for (bent, y) in self.bent.iter_mut().zip(y) {
                    *bent += *curve * *y;
                }
            }
            self.add(left, mask);
        }
    }

    /// The same of a normal and two tangents, in one go.
    fn add_narrow(&mut self, len: usize, y: &[R], curve: &[R], mask: R::Mask) {
        let (a, rest) = y.split_at(len);
        let (b, c) = rest.split_at(len);
        self.bent.clear();
        for curve in curve.chunks_exact(NARROW) {
            let along = a.iter().zip(b).zip(c);
            let bent = |((a, b), c): ((&R, &R), &R)| {
                R::zero() + curve[0] * *a + curve[1] * *b + curve[2] * *c
            };
            self.bent.extend(along.map(bent));
        }
        let (x, rest) = self.bent.split_at(len);
        let (y, z) = rest.split_at(len);
        let (whole, mut part) = (mask.all(), self.part.as_mut_slice());
        for at in 0..len {
            let (own, later) = part.split_at_mut(at + 1);
            part = later;
            let (a, b, c) = (a[at], b[at], c[at]);
            for (((own, x), y), z) in own.iter_mut().zip(x).zip(y).zip(z) {
                let new = *own + a * *x + b * *y + c * *z;
                *own = if whole { new } else { R::select(mask, new, *own) };
            }
        }
    }

    /// D alone.
    fn reset(&mut self, pattern: &Pattern, d: &[R]) {
        self.entries.clear();
        self.entries.resize(pattern.cols.len(), R::zero());
        self.diagonal.clear();
        self.diagonal.extend_from_slice(d);
        for list in [&mut self.work, &mut self.inverse] {
            list.clear();
            list.resize(d.len(), R::zero());
        }
    }

    /// What a bundle's dofs have so far, side by side in `part`.
    fn open(&mut self, pattern: &Pattern, bundle: usize) {
        let Self { part, entries, diagonal, .. } = self;
        let (list, first) = pattern.bundles[bundle];
        let mut places = &pattern.places[first..];
        part.clear();
        for (at, i) in list.of(&pattern.lists).iter().enumerate() {
            let (own, later) = places.split_at(at);
            places = later;
            part.extend(own.iter().map(|place| entries[*place]));
            part.push(diagonal[*i]);
        }
    }

    /// Adds left · bentᵀ, whose sum over a block's rows is symmetric, to `part`.
    #[inline(always)]
    fn add(&mut self, left: &[R], mask: R::Mask) {
        let mut rest = self.part.as_mut_slice();
        for (at, left) in left.iter().enumerate() {
            let (own, later) = rest.split_at_mut(at + 1);
            rest = later;
            if mask.all() {
                for (x, bent) in own.iter_mut().zip(&self.bent) {
                    *x += *left * *bent;
                }
                continue;
            }
            for (x, bent) in own.iter_mut().zip(&self.bent) {
                *x = R::select(mask, *x + *left * *bent, *x);
            }
        }
    }

    /// Puts `part` back.
    fn close(&mut self, pattern: &Pattern, bundle: usize) {
        let Self { part, entries, diagonal, .. } = self;
        let (list, first) = pattern.bundles[bundle];
        let (mut places, mut part) = (&pattern.places[first..], part.as_slice());
        for (at, i) in list.of(&pattern.lists).iter().enumerate() {
            let (own, later) = places.split_at(at);
            let (new, rest) = part.split_at(at + 1);
            (places, part) = (later, rest);
            for (place, x) in own.iter().zip(new) {
                entries[*place] = *x;
            }
            diagonal[*i] = new[at];
        }
    }

    /// H = LᵀDL; the entries become L, the diagonal D.
    fn factor(&mut self, pattern: &Pattern) {
        let Self { entries, diagonal, inverse, work, .. } = self;
        for i in (0..diagonal.len()).rev() {
            let own = pattern.start[i]..pattern.start[i + 1];
            let cols = &pattern.cols[own.clone()];
            for (j, x) in cols.iter().zip(&entries[own.clone()]) {
                work[*j] = *x;
            }
            let mut d = diagonal[i];
            for (k, at) in &pattern.below[pattern.below_start[i]..pattern.below_start[i + 1]] {
                let l = entries[*at];
                let a = l * diagonal[*k];
                d -= a * l;
                let before = pattern.start[*k]..*at;
                for (j, l) in pattern.cols[before.clone()].iter().zip(&entries[before]) {
                    work[*j] -= a * *l;
                }
            }
            diagonal[i] = d;
            let inv = R::one() / d;
            inverse[i] = inv;
            for (j, x) in cols.iter().zip(&mut entries[own]) {
                *x = work[*j] * inv;
            }
        }
    }

    /// x ← H⁻¹ x.
    pub fn solve(&self, pattern: &Pattern, x: &mut [R]) {
        for k in (0..x.len()).rev() {
            let own = pattern.start[k]..pattern.start[k + 1];
            let factor = x[k];
            for (j, l) in pattern.cols[own.clone()].iter().zip(&self.entries[own]) {
                x[*j] -= *l * factor;
            }
            x[k] = factor * self.inverse[k];
        }
        for k in 0..x.len() {
            let own = pattern.start[k]..pattern.start[k + 1];
            let mut rest = x[k];
            for (j, l) in pattern.cols[own.clone()].iter().zip(&self.entries[own]) {
                rest -= *l * x[*j];
            }
            x[k] = rest;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::newton::bundles::Bundles;
    use crate::solve::tests::{pack, Problem as Given, Random};

    #[test]
    fn factors_solve_what_was_built() {
        let mut random = Random::new(3);
        for _ in 0..50 {
            let nv = 2 + random.below(9);
            let ones = vec![1.0; nv];
            let mut given = Given::new(&ones, &ones);
            let count = 1 + random.below(6);
            for _ in 0..count {
                given.limit(&ones, 0.0, 1.0);
            }
            let mut rows = pack::<f64>(&[given]);
            // Every block on its own random list of dofs.
            let mut lists = Vec::new();
            rows.y.clear();
            for row in &mut rows.rows {
                let own: Vec<usize> = (0..nv).filter(|_| random.next() > 0.0).collect();
                row.dofs = Span { start: lists.len(), len: own.len() };
                row.y = rows.y.len();
                rows.y.extend(own.iter().map(|_| random.next()));
                lists.extend(own);
            }
            let blocks: Vec<usize> = (0..count).collect();
            let mut bundles = Bundles::new();
            bundles.take(&blocks, &rows);
            let mut pattern = Pattern::default();
            pattern.fit(&lists, false, &bundles.list, &mut vec![0; nv]);
            let problem =
                Problem { pattern: &pattern, bundles: &bundles, rows: &rows, blocks: &blocks };
            let n = pattern.dofs.len();
            let x: Vec<f64> = (0..n).map(|_| random.next()).collect();
            let mut b: Vec<f64> = x.iter().map(|x| 0.5 * x).collect();
            let mut along = vec![0.0; count];
            problem.dots(&x, &mut along);
            problem.gather(&along, 3.0, &mut b);
            let mut hessian = Hessian::new();
            hessian.make(problem, &vec![0.5; n], &vec![3.0; count]);
            hessian.solve(&pattern, &mut b);
            for (a, b) in x.iter().zip(&b) {
                assert!((a - b).abs() < 1e-12);
            }
        }
    }
}
