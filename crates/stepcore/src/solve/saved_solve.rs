//! Two solves of one step's rows: the result of the first is kept during the second.

use super::rows::Rows;
use crate::real::Real;

/// A row's numbers of the first solve.
struct Held<R: Real> {
    t: R,
    c: R,
    inv_s: R,
    /// The initial and the final impulse.
    start: R,
    impulse: R,
}

/// The first solve.
pub struct SavedSolve<R: Real> {
    rows: Vec<Held<R>>,
    masks: Vec<R::Mask>,
    u: Vec<R>,
}

room!(SavedSolve<R>: rows, masks, u);

impl<R: Real> SavedSolve<R> {
    pub fn new(nv: usize) -> Self {
        Self { rows: Vec::new(), masks: Vec::new(), u: vec![R::zero(); nv] }
    }
}

impl<R: Real> Rows<R> {
    /// Before the first solve: save the initial impulses.
    pub(crate) fn begin_first(&mut self) {
        self.saved_solve.rows.clear();
        self.saved_solve.rows.extend(self.rows.iter().map(|row| Held {
            t: row.t,
            c: row.c,
            inv_s: row.inv_s,
            start: row.impulse,
            impulse: row.impulse,
        }));
        self.saved_solve.masks.clear();
        self.saved_solve.masks.extend(self.blocks.iter().map(|block| block.mask));
    }

    /// After the first solve: every row restarts, from û = `guess` and from the lasting part of its
    /// impulse of the step before, which excludes impacts.
    pub(crate) fn begin_second(&mut self, dof_lists: &[usize], inv_d: &[R], guess: &[R]) {
        self.saved_solve.u.copy_from_slice(&self.u);
        self.u.copy_from_slice(guess);
        for (row, held) in self.rows.iter_mut().zip(&mut self.saved_solve.rows) {
            held.impulse = row.impulse;
            let lasting = R::select(
                held.start.lt(R::zero()),
                row.impulse.max(held.start).min(R::zero()),
                row.impulse.min(held.start).max(R::zero()),
            );
            row.impulse = lasting;
        }
        for block in &self.blocks {
            for row in &mut self.rows[block.rows.range()] {
                row.impulse = R::select(block.mask, row.impulse, R::zero());
            }
        }
        self.apply_impulses(dof_lists, inv_d);
    }

    /// Returns a row's impulse from the first solve.
    pub(crate) fn first_impulse(&self, row: usize) -> R {
        self.saved_solve.rows[row].impulse
    }

    /// The regulariser acts on the sum of both impulses: J v + c (λ₁ + λ₂) = t. The first solve had
    /// 2c, as both halves of a lasting force are equal.
    pub(crate) fn soften_second(&mut self, row: usize) {
        let given = self.saved_solve.rows[row].impulse;
        let row = &mut self.rows[row];
        let soft = row.c.gt(R::zero());
        let c = R::of(0.5) * row.c;
        row.t = R::select(soft, row.t - c * given, row.t);
        row.inv_s = R::select(soft, (row.a + c).recip_or_zero(), row.inv_s);
        row.c = R::select(soft, c, row.c);
    }

    /// After the second solve: restore the first's rows, with the second's impulse in `beside`.
    pub(crate) fn end_second(&mut self) {
        for (block, mask) in self.blocks.iter_mut().zip(&self.saved_solve.masks) {
            for row in &mut self.rows[block.rows.range()] {
                row.beside += R::select(block.mask, row.impulse, R::zero());
            }
            block.mask = *mask;
        }
        for (row, held) in self.rows.iter_mut().zip(&self.saved_solve.rows) {
            (row.t, row.c, row.inv_s) = (held.t, held.c, held.inv_s);
            row.impulse = held.impulse;
        }
        self.u.copy_from_slice(&self.saved_solve.u);
    }
}
