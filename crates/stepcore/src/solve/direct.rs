//! Equalities alone, solved directly: (A + c) λ = t − J û by LDLᵀ in the order of the rows.
//!
//! A row that the rows before it fix already leaves a pivot of rounding, and takes no impulse: what
//! holds twice holds. No order of rows is looked for, so that lanes do the same operations.

use super::rows::Rows;
use crate::real::{Mask, Real};
use crate::room::room;

/// Of more rows the sweeps are cheaper.
pub(super) const MOST: usize = 96;
/// A pivot of no more than so many roundings of the largest A of its group is none.
const ROUNDINGS: f64 = 4096.0;
/// Nor one of no more than this share of it, where an iteration has to come to rest: close to a
/// position in which rows say the same, the force is a quotient of two small numbers.
const ITERATED: f64 = 1e-5;

/// Rows of one block that have a unit in common: the three ways of a point, or of turning.
pub(crate) const GROUP: usize = 3;

/// How rows are chosen that others fix already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choice {
    /// By their pivots.
    Now,
    /// By their pivots, for an iteration.
    First,
    /// As the last time.
    Kept,
    /// No solution: the impulses of `recall`.
    Frozen,
}

/// The method's memory: a matrix, row by row.
pub struct Direct<R: Real> {
    l: Vec<R>,
    inv: Vec<R>,
    /// Rows that have a pivot.
    counts: Vec<R::Mask>,
    x: Vec<R>,
    /// The impulses where an iteration began.
    begun: Vec<R>,
    /// D⁻¹ y of one row, by dof.
    z: Vec<R>,
}

room!(Direct<R>: l, inv, counts, x, begun, z;);

impl<R: Real> Direct<R> {
    pub fn new(nv: usize) -> Self {
        Self {
            l: Vec::new(),
            inv: Vec::new(),
            counts: Vec::new(),
            x: Vec::new(),
            begun: Vec::new(),
            z: vec![R::zero(); nv],
        }
    }
}

impl<R: Real> Rows<R> {
    /// Whether all rows are equalities, and few enough. `u` must hold û.
    pub(crate) fn solve_direct(
        &mut self,
        dof_lists: &[usize],
        inv_d: &[R],
        choice: Choice,
    ) -> bool {
        let n = self.rows.len();
        if n > MOST {
            return false;
        }
        if choice == Choice::Frozen {
            self.kick_direct(dof_lists, inv_d);
            return true;
        }
        let Self { rows, blocks, y, direct, u, .. } = self;
        let Direct { l, inv, counts, x, z, .. } = direct;
        l.clear();
        l.resize(n * n, R::zero());
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
            for j in 0..=i {
                let other = &rows[j];
                let mut a = R::zero();
                for (k, y) in other.dofs.of(dof_lists).iter().zip(&y[other.y..]) {
                    a += *y * z[*k];
                }
                l[i * n + j] = a;
            }
            // L[i, j] · D[j] by forward substitution; then the pivot.
            let whole = own.a + own.c;
            let mut pivot = whole;
            for j in 0..i {
                let mut sum = l[i * n + j];
                for k in 0..j {
                    sum -= l[i * n + k] * l[j * n + k];
                }
                l[i * n + j] = sum;
                // Rows j keep L[j, k]; row i keeps L[i, k]·D[k] until it is done.
            }
            for j in 0..i {
                let scaled = l[i * n + j];
                let share = scaled * inv[j];
                pivot -= scaled * share;
                x[i] = x[i] - share * x[j];
                l[i * n + j] = share;
            }
            if choice != Choice::Kept {
                // Beside the largest of its group: where nothing moves along one of its axes,
                // that row's own A is small as well.
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
            l[i * n + i] = R::one();
        }
        for i in (0..n).rev() {
            let mut sum = x[i] * inv[i];
            for j in i + 1..n {
                sum -= l[j * n + i] * x[j];
            }
            // A row without a pivot takes nothing, whatever those after it take.
            x[i] = R::select(counts[i], sum, R::zero());
        }
        if choice == Choice::First {
            direct.begun.clone_from(&direct.x);
        }
        self.kick_direct(dof_lists, inv_d);
        true
    }

    /// In the lanes of `open` an iteration goes on with the impulses of its beginning.
    pub(crate) fn recall(&mut self, open: R::Mask) {
        for (x, begun) in self.direct.x.iter_mut().zip(&self.direct.begun) {
            *x = R::select(open, *begun, *x);
        }
    }

    /// Gives every row its impulse.
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
