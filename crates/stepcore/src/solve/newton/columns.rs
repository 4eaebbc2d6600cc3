//! The Hessian of a pile in dense blocks between nodes, and its LDLᵀ column by column.
//!
//! A column gathers D, the terms of its bundles of rows, and then subtracts the terms of every
//! earlier column that reaches it (left-looking: George & Liu 1981, 5.6). So a column depends on
//! those columns alone. If the curvature changed in a few bundles, only the columns of their nodes
//! and the columns that these reach are recomputed, with the same bits as a full factorisation. Of
//! the diagonal blocks only the entries [m][a] with a ≥ m are used.
//!
//! A block of a column is stored pivot by pivot: entry [m][a] couples the column's dof m with the
//! row's dof a, and holds Lᵀ[m][a] once factored. Free bodies make 6 × 6 blocks, for which the
//! loops have constant lengths; no sum is split, so vectorisation does not change the bits.

use super::bundles::Bundles;
use super::free_blocks::{add_outer, add_upper, ActiveRows, Scaled, FREE};
use super::nodes::{Member, NodePair, Nodes};
use crate::interrupt::Meter;
use crate::real::{Mask, Real};

pub(super) struct Columns<R> {
    values: Vec<R>,
    /// Per dof: D and 1/D of LDLᵀ.
    d: Vec<R>,
    inverse: Vec<R>,
    /// The curvature that the factors belong to.
    curve: Vec<R>,
    /// Columns to recompute.
    stale: Vec<bool>,
    /// Per node: the position of its block in the current column.
    place: Vec<usize>,
    /// Scratch: Lᵀ scaled by D; see `bend`; y at another node in the rows of `active`.
    scaled: Vec<R>,
    own: Vec<R>,
    theirs: Vec<R>,
    active: Vec<usize>,
}

room!(Columns<R>: values, d, inverse, curve, stale, place, scaled, own, theirs, active);

/// An island's rows and their curvature.
#[derive(Clone, Copy)]
pub(super) struct Curved<'a, R: Real> {
    pub bundles: &'a Bundles<R>,
    /// As `Rows::y`.
    pub y: &'a [R],
    /// s″, as in `System::curve`.
    pub curve: &'a [R],
}

impl<R: Real> Columns<R> {
    pub fn new() -> Self {
        Self {
            values: Vec::new(),
            d: Vec::new(),
            inverse: Vec::new(),
            curve: Vec::new(),
            stale: Vec::new(),
            place: Vec::new(),
            scaled: Vec::new(),
            own: Vec::new(),
            theirs: Vec::new(),
            active: Vec::new(),
        }
    }

    /// Makes room for a Hessian with these nodes; nothing is factored yet.
    pub fn start(&mut self, nodes: &Nodes) {
        self.values.resize(nodes.numbers, R::zero());
        self.d.resize(nodes.dofs.len(), R::zero());
        self.inverse.resize(nodes.dofs.len(), R::zero());
        self.place.resize(nodes.count(), 0);
        self.stale.clear();
        self.stale.resize(nodes.count(), true);
        self.curve.clear();
    }

    /// Factor D + Σ y s″ yᵀ.
    pub fn factor(&mut self, nodes: &Nodes, d: &[R], curved: Curved<R>) {
        self.mark(nodes, &curved);
        let mut meter = Meter::default();
        for j in 0..nodes.count() {
            if !self.stale[j] {
                continue;
            }
            self.stale[j] = false;
            if let Some(parent) = nodes.order.column(j).first() {
                self.stale[*parent] = true;
            }
            self.open(nodes, j, d);
            for pair in &nodes.pairs[nodes.meets[j]..nodes.meets[j + 1]] {
                meter.count(FREE * FREE);
                self.add(nodes, *pair, &curved);
            }
            for (k, at) in &nodes.left[nodes.left_start[j]..nodes.left_start[j + 1]] {
                meter.count(
                    FREE * (nodes.offsets[nodes.order.start[*k + 1] - 1] - nodes.offsets[*at]),
                );
                self.update(nodes, j, *k, *at);
            }
            self.close(nodes, j);
        }
    }

    /// Marks the nodes of bundles whose curvature differs from the factored one.
    fn mark(&mut self, nodes: &Nodes, curved: &Curved<R>) {
        if self.curve.len() == curved.curve.len() {
            for (b, bundle) in curved.bundles.list.iter().enumerate() {
                if bundle.curve.of(&self.curve) != bundle.curve.of(curved.curve) {
                    for member in nodes.bundles[b].of(&nodes.members) {
                        self.stale[member.node] = true;
                    }
                }
            }
        }
        self.curve.clear();
        self.curve.extend_from_slice(curved.curve);
    }

    /// Set column j to D alone.
    fn open(&mut self, nodes: &Nodes, j: usize, d: &[R]) {
        let (size, start) = (nodes.size(j), nodes.places[j]);
        let mut at = start + size * size;
        self.place[j] = start;
        for row in nodes.order.column(j) {
            self.place[*row] = at;
            at += size * nodes.size(*row);
        }
        self.values[start..at].fill(R::zero());
        for m in 0..size {
            self.values[start + m * size + m] = d[nodes.first[j] + m];
        }
    }

    /// Adds y s″ yᵀ of one bundle to the column of one of its nodes.
    fn add(&mut self, nodes: &Nodes, pair: NodePair, curved: &Curved<R>) {
        if self.add_intervals(nodes, pair, curved) {
            return;
        }
        self.bend(nodes, pair, curved);
        if self.active.is_empty() {
            return;
        }
        let y = curved.y;
        let own = nodes.members[pair.member];
        let size = nodes.size(own.node);
        for member in &nodes.members[pair.member..pair.end] {
            let width = nodes.size(member.node);
            let place = self.place[member.node];
            let target = &mut self.values[place..place + size * width];
            if let (FREE, FREE, Some(run)) = (size, width, member.run) {
                self.theirs.clear();
                for row in &self.active {
                    self.theirs.extend_from_slice(&y[row + run..][..FREE]);
                }
                let lines = Scaled { own: &self.own, theirs: &self.theirs };
                if member.node == own.node {
                    add_upper(target, &lines);
                } else {
                    add_outer(target, &lines);
                }
                continue;
            }
            let entries = &nodes.entries[member.entries..member.entries + width];
            for (own, row) in self.own.chunks_exact(size).zip(&self.active) {
                for (line, own) in target.chunks_exact_mut(width).zip(own) {
                    for (x, e) in line.iter_mut().zip(entries) {
                        *x += *own * y[row + e];
                    }
                }
            }
        }
    }

    /// The same for a bundle of free bodies with intervals only, directly from its y; returns false
    /// for other bundles.
    fn add_intervals(&mut self, nodes: &Nodes, pair: NodePair, curved: &Curved<R>) -> bool {
        let bundle = &curved.bundles.list[pair.bundle];
        let [run] = curved.bundles.runs_of(bundle) else { return false };
        let members = &nodes.members[pair.member..pair.end];
        let free = |member: &Member| nodes.size(member.node) == FREE && member.run.is_some();
        if run.cone.is_some() || !members.iter().all(free) {
            return false;
        }
        let y = &curved.y[bundle.y..][..bundle.rows.len * bundle.dofs.len];
        let curve = run.curve.of(curved.curve);
        let lines = |starts| ActiveRows { y, len: bundle.dofs.len, curve, starts };
        let mut starts = members.iter().map(|member| (member.node, member.run.unwrap_or(0)));
        let Some((node, own)) = starts.next() else { return true };
        let block = |node: usize| self.place[node]..self.place[node] + FREE * FREE;
        add_upper(&mut self.values[block(node)], &lines([own, own]));
        for (node, theirs) in starts {
            add_outer(&mut self.values[block(node)], &lines([own, theirs]));
        }
        true
    }

    /// Sets `own` to s″ y at a node of a bundle, row by row of `active`, which holds the start of
    /// each row's y.
    fn bend(&mut self, nodes: &Nodes, pair: NodePair, curved: &Curved<R>) {
        let bundle = &curved.bundles.list[pair.bundle];
        let member = nodes.members[pair.member];
        let y = curved.y;
        let entries = &nodes.entries[member.entries..][..nodes.size(member.node)];
        self.active.clear();
        self.own.clear();
        for run in curved.bundles.runs_of(bundle) {
            let begin = |row: usize| bundle.y + (row - bundle.rows.start) * bundle.dofs.len;
            let curve = run.curve.of(curved.curve);
            if run.cone.is_some() {
                for (row, curve) in run.rows.range().zip(curve.chunks_exact(run.rows.len)) {
                    let first = self.own.len();
                    self.own.resize(first + entries.len(), R::zero());
                    for (bend, other) in curve.iter().zip(run.rows.range().map(begin)) {
                        for (own, e) in self.own[first..].iter_mut().zip(entries) {
                            *own += *bend * y[other + e];
                        }
                    }
                    self.active.push(begin(row));
                }
                continue;
            }
            for (row, curve) in run.rows.range().map(begin).zip(curve) {
                if curve.gt(R::zero()).none() {
                    continue;
                }
                if let (FREE, Some(run)) = (entries.len(), member.run) {
                    let y = &y[row + run..][..FREE];
                    let own: [R; FREE] = crate::real::array::from_fn(|a| *curve * y[a]);
                    self.own.extend_from_slice(&own);
                } else {
                    self.own.extend(entries.iter().map(|e| *curve * y[row + e]));
                }
                self.active.push(row);
            }
        }
    }

    /// Subtracts the contribution of column k, which reaches column j as its row `at`: L_ik D_k
    /// L_jkᵀ in every row i from j on.
    fn update(&mut self, nodes: &Nodes, j: usize, k: usize, at: usize) {
        let (own, pivots) = (nodes.size(j), nodes.size(k));
        let end = nodes.order.start[k + 1];
        let (before, column) = self.values.split_at_mut(nodes.places[j]);
        let source = &before[nodes.offsets[at]..];
        let d = &self.d[nodes.first[k]..nodes.first[k + 1]];
        self.scaled.clear();
        for (line, d) in source.chunks_exact(own).zip(d) {
            self.scaled.extend(line.iter().map(|l| *l * *d));
        }
        let mut start = 0;
        for row in &nodes.order.rows[at..end] {
            let width = nodes.size(*row);
            let target = self.place[*row] - nodes.places[j];
            let target = &mut column[target..target + own * width];
            let source_block = &source[start..start + pivots * width];
            start += pivots * width;
            if (own, pivots, width) == (FREE, FREE, FREE) {
                take::<R, FREE>(target, source_block, &self.scaled);
                continue;
            }
            for (m, line) in source_block.chunks_exact(width).enumerate() {
                for (b, target) in target.chunks_exact_mut(width).enumerate() {
                    let factor = self.scaled[m * own + b];
                    for (x, l) in target.iter_mut().zip(line) {
                        *x -= factor * *l;
                    }
                }
            }
        }
    }

    /// Factor column j after all subtractions.
    fn close(&mut self, nodes: &Nodes, j: usize) {
        let (size, start, first) = (nodes.size(j), nodes.places[j], nodes.first[j]);
        let (square, mut below) = self.values[start..].split_at_mut(size * size);
        let d = &mut self.d[first..first + size];
        let inverse = &mut self.inverse[first..first + size];
        if size == FREE {
            // The length is a constant.
            factor_square(FREE, square, d, inverse);
        } else {
            factor_square(size, square, d, inverse);
        }
        let inverse = &self.inverse[first..first + size];
        for row in nodes.order.column(j) {
            let width = nodes.size(*row);
            let (block, rest) = below.split_at_mut(size * width);
            below = rest;
            if size == FREE && width == FREE {
                divide_block::<R, FREE>(block, square, inverse);
                continue;
            }
            for b in 0..size {
                let (done, next) = block.split_at_mut((b + 1) * width);
                let line = &done[b * width..];
                for (m, next) in next.chunks_exact_mut(width).enumerate() {
                    let factor = square[b * size + b + 1 + m];
                    for (x, l) in next.iter_mut().zip(line) {
                        *x -= factor * *l;
                    }
                }
            }
            for (line, inverse) in block.chunks_exact_mut(width).zip(inverse) {
                line.iter_mut().for_each(|x| *x *= *inverse);
            }
        }
    }

    /// x ← H⁻¹ x.
    pub fn solve(&self, nodes: &Nodes, x: &mut [R]) {
        for j in 0..nodes.count() {
            let (size, first) = (nodes.size(j), nodes.first[j]);
            let (square, below) = self.values[nodes.places[j]..].split_at(size * size);
            let (own, later) = x[first..].split_at_mut(size);
            for m in 0..size {
                for a in m + 1..size {
                    let taken = square[m * size + a] * own[m];
                    own[a] -= taken;
                }
            }
            let mut at = 0;
            for row in nodes.order.column(j) {
                let width = nodes.size(*row);
                let target = &mut later[nodes.first[*row] - first - size..][..width];
                let block = &below[at..at + size * width];
                at += size * width;
                match target.first_chunk_mut() {
                    Some(target) if width == FREE => forward::<R, FREE>(target, block, own),
                    _ => {
                        for (line, own) in block.chunks_exact(width).zip(&*own) {
                            for (x, l) in target.iter_mut().zip(line) {
                                *x -= *l * *own;
                            }
                        }
                    }
                }
            }
        }
        for (x, inverse) in x.iter_mut().zip(&self.inverse) {
            *x *= *inverse;
        }
        for j in (0..nodes.count()).rev() {
            let (size, first) = (nodes.size(j), nodes.first[j]);
            let (square, below) = self.values[nodes.places[j]..].split_at(size * size);
            let (own, later) = x[first..].split_at_mut(size);
            let mut at = 0;
            for row in nodes.order.column(j) {
                let width = nodes.size(*row);
                let source = &later[nodes.first[*row] - first - size..][..width];
                for own in own.iter_mut() {
                    let mut sum = R::zero();
                    for (l, x) in below[at..at + width].iter().zip(source) {
                        sum += *l * *x;
                    }
                    *own -= sum;
                    at += width;
                }
            }
            for m in (0..size).rev() {
                for a in m + 1..size {
                    let taken = square[m * size + a] * own[a];
                    own[m] -= taken;
                }
            }
        }
    }
}

#[cfg(test)]
impl Columns<f64> {
    /// Returns whether the factors are equal, bit for bit.
    pub fn same_bits(&self, other: &Self) -> bool {
        let same =
            |a: &[f64], b: &[f64]| a.iter().map(|x| x.to_bits()).eq(b.iter().map(|x| x.to_bits()));
        same(&self.values, &other.values) && same(&self.inverse, &other.inverse)
    }
}

/// Factors a diagonal block.
#[inline(always)]
fn factor_square<R: Real>(size: usize, square: &mut [R], d: &mut [R], inverse: &mut [R]) {
    let (square, d, inverse) = (&mut square[..size * size], &mut d[..size], &mut inverse[..size]);
    for m in 0..size {
        let (done, later) = square.split_at_mut((m + 1) * size);
        let line = &mut done[m * size..];
        d[m] = line[m];
        inverse[m] = R::one() / line[m];
        for (b, target) in (m + 1..size).zip(later.chunks_exact_mut(size)) {
            let factor = line[b] * inverse[m];
            for (x, l) in target[b..].iter_mut().zip(&line[b..]) {
                let taken = factor * *l;
                *x -= taken;
            }
        }
        for x in &mut line[m + 1..] {
            *x *= inverse[m];
        }
    }
}

/// target[b] −= Σ scaled[m][b] source[m].
#[inline(always)]
fn take<R: Real, const N: usize>(target: &mut [R], source: &[R], scaled: &[R]) {
    for (b, line) in target.chunks_exact_mut(N).enumerate() {
        let mut sum = [R::zero(); N];
        sum.copy_from_slice(line);
        for (source, scaled) in source.chunks_exact(N).zip(scaled.chunks_exact(N)) {
            let Some(source) = source.first_chunk::<N>() else { continue };
            for a in 0..N {
                sum[a] -= scaled[b] * source[a];
            }
        }
        line.copy_from_slice(&sum);
    }
}

/// block ← D⁻¹ L⁻¹ block, with the factors of the diagonal block.
#[inline(always)]
fn divide_block<R: Real, const N: usize>(block: &mut [R], square: &[R], inverse: &[R]) {
    let square: &[R] = &square[..N * N];
    let block: &mut [R] = &mut block[..N * N];
    let mut lines = [[R::zero(); N]; N];
    for m in 0..N {
        let mut line = [R::zero(); N];
        line.copy_from_slice(&block[m * N..][..N]);
        for b in 0..m {
            let factor = square[b * N + m];
            for a in 0..N {
                line[a] -= factor * lines[b][a];
            }
        }
        lines[m] = line;
    }
    for m in 0..N {
        for a in 0..N {
            block[m * N + a] = lines[m][a] * inverse[m];
        }
    }
}

/// target −= Σ own[m] block[m].
#[inline(always)]
fn forward<R: Real, const N: usize>(target: &mut [R; N], block: &[R], own: &[R]) {
    let mut sum = *target;
    for (line, own) in block.chunks_exact(N).zip(own) {
        let Some(line) = line.first_chunk::<N>() else { continue };
        for a in 0..N {
            sum[a] -= line[a] * *own;
        }
    }
    *target = sum;
}
