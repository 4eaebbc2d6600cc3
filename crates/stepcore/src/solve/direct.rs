//! Equalities alone, solved directly: (A + c) λ = t − J û by LDLᵀ in the order of the rows.
//!
//! A row that earlier rows already determine leaves a pivot of rounding, and takes no impulse:
//! redundant constraints stay satisfied. Rows are not reordered, so that lanes do the same work.
//!
//! A row of L starts at the first row with which it shares a dof, directly or through the rows
//! between (the envelope of A, which elimination does not leave). If the loops of a chain share
//! bodies with their neighbours only, the cost is linear in the number of loops.

use super::rows::{Row, Rows};
use crate::real::{Mask, Real};

/// The most products of an elimination; larger systems go to the sweeps. 384 rows that all touch
/// each other reach this limit, and take 10 ms.
const MOST: usize = 384 * 384 * 384 / 6;
/// A pivot of at most this many roundings of the largest A of its group counts as zero.
const ROUNDINGS: f64 = 4096.0;
/// If an iteration must converge, so does a pivot of at most this share of the largest A: near a
/// position in which rows are redundant, the force is a quotient of two small numbers.
const ITERATED: f64 = 1e-5;

/// The most rows of one block with the same unit: the three directions of a point, or of a rotation.
pub(crate) const GROUP: usize = 3;

/// How the rows are chosen that others determine already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choice {
    /// Chosen by their pivots.
    Now,
    /// By their pivots, at the start of an iteration.
    First,
    /// The same as last time.
    Kept,
    /// No solution: the impulses of `recall`.
    Frozen,
}

/// The method's memory.
pub struct Direct<R: Real> {
    envelope: Envelope,
    /// L within the envelope, row by row, without its diagonal of ones.
    l: Vec<R>,
    inv: Vec<R>,
    /// Lanes in which the row has a pivot.
    counts: Vec<R::Mask>,
    x: Vec<R>,
    /// The impulses at the start of an iteration.
    begun: Vec<R>,
    /// D⁻¹ y of one row, by dof.
    z: Vec<R>,
}

room!(Direct<R>: envelope, l, inv, counts, x, begun, z);

impl<R: Real> Direct<R> {
    pub fn new(nv: usize) -> Self {
        Self {
            envelope: Envelope::new(nv),
            l: Vec::new(),
            inv: Vec::new(),
            counts: Vec::new(),
            x: Vec::new(),
            begun: Vec::new(),
            z: vec![R::zero(); nv],
        }
    }
}

/// The starts of the rows of L.
struct Envelope {
    /// Per row: the first column of L that may be nonzero, and its index in `l`.
    first: Vec<usize>,
    start: Vec<usize>,
    /// Per column: one past the last row that starts there or before.
    ends: Vec<usize>,
    /// Per dof: the first row that touches it.
    touched: Vec<usize>,
}

room!(Envelope: first, start, ends, touched);

impl Envelope {
    fn new(nv: usize) -> Self {
        let touched = vec![usize::MAX; nv];
        Self { first: Vec::new(), start: Vec::new(), ends: Vec::new(), touched }
    }

    /// Finds the envelope of these rows; returns false if elimination needs more than `MOST` products.
    fn find<R: Real>(&mut self, rows: &[Row<R>], dof_lists: &[usize]) -> bool {
        self.first.clear();
        self.start.clear();
        self.start.push(0);
        self.ends.clear();
        self.touched.fill(usize::MAX);
        let mut work = 0;
        for (i, row) in rows.iter().enumerate() {
            let mut first = i;
            for k in row.dofs.of(dof_lists) {
                self.touched[*k] = self.touched[*k].min(i);
                first = first.min(self.touched[*k]);
            }
            let wide = i - first;
            work += wide * (wide + 1) / 2;
            if work > MOST {
                return false;
            }
            self.first.push(first);
            self.start.push(self.start[i] + wide);
            self.ends.push(i + 1);
        }
        for (i, first) in self.first.iter().enumerate() {
            self.ends[*first] = i + 1;
        }
        for i in 1..rows.len() {
            self.ends[i] = self.ends[i].max(self.ends[i - 1]);
        }
        true
    }

    fn len(&self) -> usize {
        self.start.last().copied().unwrap_or(0)
    }

    /// Returns the entries of a row.
    fn row(&self, i: usize) -> std::ops::Range<usize> {
        self.start[i]..self.start[i + 1]
    }
}

impl<R: Real> Rows<R> {
    /// Solves if all rows are equalities, and few enough; returns whether they are. `u` must hold û.
    pub(crate) fn solve_direct(
        &mut self,
        dof_lists: &[usize],
        inv_d: &[R],
        choice: Choice,
    ) -> bool {
        let n = self.rows.len();
        if !self.direct.envelope.find(&self.rows, dof_lists) {
            return false;
        }
        if choice == Choice::Frozen {
            self.kick_direct(dof_lists, inv_d);
            return true;
        }
        let Self { rows, blocks, y, direct, u, .. } = self;
        let Direct { envelope, l, inv, counts, x, z, .. } = direct;
        l.clear();
        l.resize(envelope.len(), R::zero());
        inv.clear();
        let rounding = ROUNDINGS * R::epsilon();
        let least = R::of(if choice == Choice::Now { rounding } else { rounding.max(ITERATED) });
        if choice != Choice::Kept {
            counts.clear();
        }
        x.clear();
        let mut block = 0;
        for i in 0..n {
            z.fill(R::zero());
            let own = &rows[i];
            let dofs = own.dofs.of(dof_lists);
            let mut short = own.t;
            for (k, y) in dofs.iter().zip(&y[own.y..]) {
                z[*k] = *y * inv_d[*k];
                short -= *y * u[*k];
            }
            x.push(short);
            let first = envelope.first[i];
            let (before, mine) = l.split_at_mut(envelope.start[i]);
            let mine = &mut mine[..i - first];
            for (own, other) in mine.iter_mut().zip(&rows[first..]) {
                for (k, y) in other.dofs.of(dof_lists).iter().zip(&y[other.y..]) {
                    *own += *y * z[*k];
                }
            }
            // L[i, j] · D[j] by forward substitution; then the pivot.
            let whole = own.a + own.c;
            let mut pivot = whole;
            for j in first..i {
                let both = first.max(envelope.first[j]);
                let mut sum = mine[j - first];
                let other = &before[envelope.row(j)][both - envelope.first[j]..];
                for (own, other) in mine[both - first..].iter().zip(other) {
                    sum -= *own * *other;
                }
                mine[j - first] = sum;
                // Rows j hold L[j, k]; row i holds L[i, k]·D[k] until it is done.
            }
            for (j, own) in (first..i).zip(mine) {
                let scaled = *own;
                let share = scaled * inv[j];
                pivot -= scaled * share;
                x[i] = x[i] - share * x[j];
                *own = share;
            }
            if choice != Choice::Kept {
                // Compared with the largest A of its group: if nothing moves along one of its axes,
                // that row's A is small as well.
                while blocks[block].rows.range().end <= i {
                    block += 1;
                }
                let span = blocks[block].rows.range();
                let first = i - (i - span.start) % GROUP;
                let own = &rows[first..(first + GROUP).min(span.end)];
                let most = own.iter().fold(whole, |most, row| most.max(row.a + row.c));
                counts.push((least * most).lt(pivot).and(blocks[block].mask));
            }
            inv.push(R::select(counts[i], pivot.recip_or_zero(), R::zero()));
        }
        for i in (0..n).rev() {
            let mut sum = x[i] * inv[i];
            for j in i + 1..envelope.ends[i] {
                if let Some(column) = i.checked_sub(envelope.first[j]) {
                    sum -= l[envelope.start[j] + column] * x[j];
                }
            }
            // A row without a pivot takes no impulse, whatever later rows take.
            x[i] = R::select(counts[i], sum, R::zero());
        }
        if choice == Choice::First {
            direct.begun.clone_from(&direct.x);
        }
        self.kick_direct(dof_lists, inv_d);
        true
    }

    /// In the lanes of `open`, continue an iteration with its initial impulses.
    pub(crate) fn begin_again(&mut self, open: R::Mask) {
        for (x, begun) in self.direct.x.iter_mut().zip(&self.direct.begun) {
            *x = R::select(open, *begun, *x);
        }
    }

    /// Sets the impulse of every row.
    fn kick_direct(&mut self, dof_lists: &[usize], inv_d: &[R]) {
        let Self { rows, y, direct, u, .. } = self;
        for (row, impulse) in rows.iter_mut().zip(&direct.x) {
            row.impulse = *impulse;
            let dofs = row.dofs.of(dof_lists);
            let own = &y[row.y..row.y + dofs.len()];
            for (k, y) in dofs.iter().zip(own) {
                u[*k] += inv_d[*k] * *y * *impulse;
            }
        }
    }
}
