//! H = LᵀDL along the trees, without square roots and without fill-in
//! (Featherstone 2008, 6.5). L is unit lower triangular.
//!
//! Factored coordinates u = L v turn a row's Jacobian into y = L⁻ᵀJᵀ, which lives
//! on the same dofs: J v = y·u, and H⁻¹Jᵀλ becomes D⁻¹ y λ.

use super::Placed;
use std::ops::Range;

use crate::interrupt::Meter;
use crate::model::{Model, Span, Tree};
use crate::real::array::from_fn;
use crate::real::Real;
use crate::spatial::{subtract_all, subtract_scaled};

/// This many rows are factored together.
const CHAIN: usize = 4;
/// Rows of at most this many entries are short: see `factor_next`.
const SHORT: usize = 7;

/// Rows that are factored between two checks for an interruption.
const LONG: usize = 64;

/// The factors of one symmetric matrix with the pattern of the mass matrix, or of the metric of
/// `discrete` (`model/coupling.rs`).
pub struct Metric<R: Real> {
    /// L in the layout of `Model::row_dofs`, or of this matrix's pattern; the diagonal places hold D.
    pub l: Vec<R>,
    /// 1 / D, by dof.
    pub inv_d: Vec<R>,
    /// The pattern, packed: each dof's row, and each entry's dof and its row.
    rows: Vec<Span>,
    /// The entries of each row left of the diagonal, without rows in which all of these are zero
    /// throughout.
    left: Vec<Span>,
    /// By dof: the number of dofs of one chain that end with it, up to `CHAIN`.
    chained: Vec<usize>,
    /// All rows are empty left of the diagonal.
    diagonal: bool,
    dofs: Vec<usize>,
    above: Vec<usize>,
}

room!(Metric<R>: l, inv_d, rows, left, chained, diagonal, dofs, above);

impl<R: Real> Metric<R> {
    pub fn new(model: &Model<R::Value>) -> Self {
        let rows = model.dofs.iter().map(|dof| dof.row).collect();
        Self::with_pattern(rows, model.row_dofs.clone())
    }

    /// Creates a metric with the pattern of `discrete`: each dof's row is its closed chain.
    pub fn coupled(model: &Model<R::Value>) -> Self {
        let chain = |k: usize| model.dofs[k].closed.of(&model.dof_lists);
        let dofs: Vec<usize> = (0..model.nv).flat_map(|k| chain(k).iter().rev()).copied().collect();
        let mut start = 0;
        let row = |k: usize| {
            let row = Span { start, len: chain(k).len() };
            start += row.len;
            row
        };
        Self::with_pattern((0..model.nv).map(row).collect(), dofs)
    }

    fn with_pattern(rows: Vec<Span>, dofs: Vec<usize>) -> Self {
        let mut chained = vec![1; rows.len()];
        for k in 1..rows.len() {
            let next = left(rows[k]).of(&dofs) == rows[k - 1].of(&dofs);
            chained[k] = if next { CHAIN.min(chained[k - 1] + 1) } else { 1 };
        }
        Self {
            l: vec![R::one(); dofs.len()],
            inv_d: vec![R::one(); rows.len()],
            above: dofs.iter().map(|k| rows[*k].start).collect(),
            left: rows.iter().map(|row| left(*row)).collect(),
            diagonal: rows.iter().all(|row| row.len == 1),
            chained,
            rows,
            dofs,
        }
    }

    /// Returns the place of each entry of M in this matrix, in the layout of `Model::row_dofs`.
    pub fn places(&self, model: &Model<R::Value>) -> Vec<usize> {
        let rows = model.dofs.iter().enumerate();
        let entries =
            rows.flat_map(|(k, dof)| dof.row.of(&model.row_dofs).iter().map(move |j| (k, *j)));
        entries.filter_map(|(k, j)| self.place(k, j)).collect()
    }

    /// Returns the place of the entry of two dofs; None if the matrix has none.
    #[inline(always)]
    pub fn place(&self, i: usize, j: usize) -> Option<usize> {
        let row = self.rows[i.max(j)];
        if i == j {
            return Some(row.start);
        }
        let at = row.of(&self.dofs).iter().position(|dof| *dof == i.min(j))?;
        Some(row.start + at)
    }

    /// Returns an entry of D.
    pub fn pivot(&self, k: usize) -> R {
        self.l[self.rows[k].start]
    }

    /// Returns a row's entries left of the diagonal, nearest ancestor first.
    #[inline(always)]
    pub fn left_of(&self, k: usize) -> &[R] {
        self.left[k].of(&self.l)
    }

    /// Returns the same with their dofs.
    #[inline(always)]
    pub fn row(&self, k: usize) -> impl Iterator<Item = (R, usize)> + '_ {
        let left = self.left[k];
        left.of(&self.l).iter().copied().zip(left.of(&self.dofs).iter().copied())
    }

    /// Marks these dofs' rows as constant: rows that are zero left of the diagonal are skipped.
    pub(super) fn constant(&mut self, dofs: Range<usize>) {
        for left in &mut self.left[dofs] {
            if left.of(&self.l).iter().all(R::is_zero) {
                left.len = 0;
            }
        }
        self.diagonal = self.left.iter().all(|left| left.len == 0);
    }

    /// Checks that L is the unit matrix.
    #[inline(always)]
    pub(super) fn is_diagonal(&self) -> bool {
        self.diagonal
    }

    /// Copies rows of a matrix of the same layout.
    pub(crate) fn refill(&mut self, dofs: Range<usize>, matrix: &[R]) {
        let Some(last) = dofs.clone().next_back() else { return };
        let own = self.rows[dofs.start].start..self.rows[last].range().end;
        self.l[own.clone()].copy_from_slice(&matrix[own]);
    }

    /// Returns the place at which an entry of another matrix, made symmetric, is added to this pattern,
    /// if there is one, and the part of it that is added: half for each of the two entries of two dofs.
    #[inline(always)]
    pub fn share(&self, i: usize, j: usize, x: R) -> Option<(usize, R)> {
        self.place(i, j).map(|at| (at, if i == j { x } else { R::of(0.5) * x }))
    }

    /// Adds such an entry to a matrix that was copied into `l`.
    #[inline(always)]
    pub fn add(&mut self, i: usize, j: usize, x: R) {
        if let Some((at, x)) = self.share(i, j, x) {
            self.l[at] += x;
        }
    }

    /// Factors the rows `dofs` of a matrix that was copied into `l`: dofs of one chain together, so that
    /// a row above them is read and written once for all of them.
    pub fn factor(&mut self, dofs: Range<usize>) {
        if dofs.len() > LONG {
            return self.factor_interruptibly(dofs);
        }
        self.factor_all(dofs);
    }

    /// Factors many rows in parts, and checks for an interruption between them.
    #[cold]
    fn factor_interruptibly(&mut self, dofs: Range<usize>) {
        let (mut end, mut meter) = (dofs.end, Meter::default());
        while end > dofs.start {
            meter.count(LONG * self.rows[end - 1].len);
            end = self.factor_all(dofs.start.max(end.saturating_sub(LONG))..end);
        }
    }

    /// Factors rows without interruption, and returns the first one.
    #[inline(always)]
    fn factor_all(&mut self, dofs: Range<usize>) -> usize {
        let mut end = dofs.end;
        while end > dofs.start {
            end -= match self.chained[end - 1] {
                1 => self.factor_next::<1>(end),
                2 => self.factor_next::<2>(end),
                3 => self.factor_next::<3>(end),
                // The code for more together would be large.
                _ if R::FILLS && self.rows[end - 3].len <= SHORT => self.factor_next::<3>(end),
                _ => self.factor_chain::<CHAIN>(end),
            };
        }
        end
    }

    /// Factors the last N rows before `end`, each the next one of a chain. A single world's sums are
    /// short, and have a function for each number of dofs that the rows share.
    #[inline(always)]
    fn factor_next<const N: usize>(&mut self, end: usize) -> usize {
        if !R::FILLS {
            return self.factor_chain::<N>(end);
        }
        match self.rows[end - N].len - 1 {
            0 => self.factor_short::<N, 0>(end),
            1 => self.factor_short::<N, 1>(end),
            2 => self.factor_short::<N, 2>(end),
            3 => self.factor_short::<N, 3>(end),
            4 => self.factor_short::<N, 4>(end),
            5 => self.factor_short::<N, 5>(end),
            6 => self.factor_short::<N, 6>(end),
            _ => self.factor_chain::<N>(end),
        }
    }

    /// Does the same for rows that share S dofs.
    #[inline(never)]
    fn factor_short<const N: usize, const S: usize>(&mut self, end: usize) -> usize {
        let start = self.rows[end - N].start;
        let (above, rows) = self.l.split_at_mut(start);
        // Row n has n dofs of the chain before the shared ones.
        let first = |n: usize| n * (S + 1) + n * n.saturating_sub(1) / 2;
        let rows = &mut rows[..first(N)];
        let (mut own, mut shared) = ([[R::zero(); N]; N], [[R::zero(); S]; N]);
        for n in 0..N {
            own[n][..=n].copy_from_slice(&rows[first(n)..][..=n]);
            shared[n].copy_from_slice(&rows[first(n) + n + 1..][..S]);
        }
        let mut inv = [R::zero(); N];
        for n in (0..N).rev() {
            inv[n] = R::one() / own[n][0];
            for at in 1..=n {
                let by = own[n][at] * inv[n];
                for k in at..=n {
                    let taken = by * own[n][k];
                    own[n - at][k - at] -= taken;
                }
                for k in 0..S {
                    let taken = by * shared[n][k];
                    shared[n - at][k] -= taken;
                }
            }
        }
        let to = &self.above[start + 1..][..S];
        for at in 0..S {
            let to = &mut above[to[at]..][..S - at];
            for n in (0..N).rev() {
                let by = shared[n][at] * inv[n];
                for k in at..S {
                    to[k - at] -= by * shared[n][k];
                }
            }
        }
        for n in 0..N {
            let row = &mut rows[first(n)..][..S + n + 1];
            for at in 1..=n {
                row[at] = own[n][at] * inv[n];
            }
            row[0] = own[n][0];
            for k in 0..S {
                row[n + 1 + k] = shared[n][k] * inv[n];
            }
        }
        self.inv_d[end - N..end].copy_from_slice(&inv);
        N
    }

    /// Does the same for any rows.
    #[inline(always)]
    fn factor_chain<const N: usize>(&mut self, end: usize) -> usize {
        let first = self.rows[end - N];
        let start = |n: usize| n * first.len + n * (n - 1) / 2;
        let (above, rows) = self.l.split_at_mut(first.start);
        let inv_d = &mut self.inv_d[end - N..end];
        for n in (0..N).rev() {
            let (before, own) = rows.split_at_mut(start(n));
            let own = &mut own[..first.len + n];
            inv_d[n] = R::one() / own[0];
            for at in 1..=n {
                let by = own[at] * inv_d[n];
                subtract_scaled(&mut before[start(n - at)..], by, &own[at..]);
                own[at] = by;
            }
        }
        for (at, to) in self.above[first.range()].iter().enumerate().skip(1) {
            // The last row first: the sums are the same as with one row after the other.
            let places: [usize; N] = from_fn(|k| start(N - 1 - k) + N - 1 - k + at);
            let by: [R; N] = from_fn(|k| rows[places[k]] * inv_d[N - 1 - k]);
            let len = first.len - at;
            let own: [(R, &[R]); N] = from_fn(|k| (by[k], &rows[places[k]..][..len]));
            subtract_all(&mut above[*to..][..len], own);
            places.into_iter().zip(by).for_each(|(place, by)| rows[place] = by);
        }
        N
    }

    /// u ← L v.
    pub fn to_factored(&self, v: &[R], u: &mut [R]) {
        if self.diagonal {
            return u.copy_from_slice(v);
        }
        for k in 0..v.len() {
            let mut sum = v[k];
            for (l, j) in self.row(k) {
                sum += l * v[j];
            }
            u[k] = sum;
        }
    }

    /// v ← L⁻¹ u.
    pub fn from_factored(&self, u: &[R], v: &mut [R]) {
        if self.diagonal {
            return v.copy_from_slice(u);
        }
        for k in 0..u.len() {
            let mut sum = u[k];
            for (l, j) in self.row(k) {
                sum -= l * v[j];
            }
            v[k] = sum;
        }
    }

    /// Does the same on an ancestor-closed, ascending list of dofs.
    pub fn from_factored_on(&self, dofs: &[usize], u: &[R], v: &mut [R]) {
        for &k in dofs {
            let mut sum = u[k];
            for (l, j) in self.row(k) {
                sum -= l * v[j];
            }
            v[k] = sum;
        }
    }

    /// x ← L⁻ᵀ x on an ancestor-closed, ascending list of dofs.
    #[inline]
    pub fn lift(&self, dofs: &[usize], x: &mut [R]) {
        for &k in dofs.iter().rev() {
            let factor = x[k];
            for (l, j) in self.row(k) {
                x[j] -= l * factor;
            }
        }
    }

    /// Checks that the list is the whole path of its last dof from the root.
    #[inline(always)]
    pub fn is_path(&self, list: &[usize]) -> bool {
        list.last().is_some_and(|last| self.rows[*last].len == list.len())
    }

    /// x ← L⁻ᵀ x for N vectors together, N numbers a dof of a path.
    #[inline(always)]
    pub fn lift_path<const N: usize>(&self, path: &[usize], x: &mut [R]) {
        self.lift_end::<N>(path, &mut x[..N * path.len()], &mut []);
    }

    /// Does the same for the last dofs of a path, whose numbers are `own`; their contributions to the
    /// dofs before them are subtracted from `above`.
    #[inline(always)]
    pub fn lift_end<const N: usize>(&self, end: &[usize], own: &mut [R], above: &mut [R]) {
        let mut rest = own;
        for k in end.iter().rev() {
            let Some((before, x)) = rest.split_last_chunk_mut::<N>() else { return };
            let left = self.left_of(*k);
            let (near, far) = left.split_at(left.len().min(before.len() / N));
            take_off(near, x, before);
            take_off(far, x, above);
            rest = before;
        }
    }

    /// Returns the number of dofs of one chain that end with this one, at most `CHAIN`.
    #[inline(always)]
    pub fn chained(&self, k: usize) -> usize {
        self.chained[k]
    }

    /// x ← Lᵀ x.
    pub fn lower(&self, x: &mut [R]) {
        for k in 0..x.len() {
            let factor = x[k];
            for (l, j) in self.row(k) {
                x[j] += l * factor;
            }
        }
    }

    /// x ← D⁻¹L⁻ᵀ x: converts a force into the change of u that it causes per unit of time.
    pub fn half_solve(&self, x: &mut [R]) {
        self.half_solve_dofs(0..x.len(), x);
    }

    fn half_solve_dofs(&self, dofs: Range<usize>, x: &mut [R]) {
        for k in dofs.rev() {
            let factor = x[k];
            for (l, j) in self.row(k) {
                x[j] -= l * factor;
            }
            x[k] = factor * self.inv_d[k];
        }
    }

    /// x ← H⁻¹ x on the dofs of whole trees.
    pub fn solve_dofs(&self, dofs: Range<usize>, x: &mut [R]) {
        self.half_solve_dofs(dofs.clone(), x);
        for k in dofs {
            let mut sum = x[k];
            for (l, j) in self.row(k) {
                sum -= l * x[j];
            }
            x[k] = sum;
        }
    }

    /// x ← H⁻¹ x.
    pub fn solve(&self, x: &mut [R]) {
        self.solve_dofs(0..x.len(), x);
    }
}

/// Subtracts l · own from the last of `x`, N numbers each, the last first: a row's entries left of the
/// diagonal are in the path's order, the nearest first.
#[inline(always)]
fn take_off<R: Real, const N: usize>(left: &[R], own: &[R; N], x: &mut [R]) {
    let mut rest = x;
    for l in left {
        let Some((before, x)) = rest.split_last_chunk_mut::<N>() else { return };
        *x = from_fn(|i| x[i] - *l * own[i]);
        rest = before;
        // Rows are short: as in `subtract_scaled`.
        std::hint::black_box(());
    }
}

/// Copies M alone, each entry to its place: see `Metric::places`.
pub fn spread<R: Real>(mass: &[R], places: &[usize], out: &mut [R]) {
    out.fill(R::zero());
    for (at, mass) in places.iter().zip(mass) {
        out[*at] = *mass;
    }
}

/// Returns the part of a row left of the diagonal.
fn left(row: Span) -> Span {
    Span { start: row.start + 1, len: row.len - 1 }
}

impl<R: Real> Placed<R> {
    pub(super) fn factor_mass(&mut self, tree: &Tree<R::Value>) {
        if self.effective.is_some() {
            return;
        }
        self.metric.refill(tree.dofs.range(), &self.mass);
        self.metric.factor(tree.dofs.range());
    }

    /// out ← M x.
    pub fn mul_mass(&self, model: &Model<R::Value>, x: &[R], out: &mut [R]) {
        out.fill(R::zero());
        for k in 0..model.nv {
            let row = model.dofs[k].row;
            out[k] += self.mass[row.start] * x[k];
            for at in row.range().skip(1) {
                let j = model.row_dofs[at];
                out[k] += self.mass[at] * x[j];
                out[j] += self.mass[at] * x[k];
            }
        }
    }
}
