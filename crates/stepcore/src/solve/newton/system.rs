//! What Newton's method holds of one island, and the laws of its rows.

use super::columns::Columns;
use super::hessian::{Hessian, Pattern};
use super::penalty::{interval, Cone};
use crate::real::{Mask, Real};
use crate::room::room;
use crate::solve::rows::{Rows, Set, CONE, NARROW};
use std::ops::Range;

/// What the method holds of an island. "By row" counts the rows of the blocks at
/// hand one after another; "by dof" is local, as in `Pattern::dofs`.
pub(super) struct System<R: Real> {
    /// By row: 1/c; w = y·u − t; how fast w changes along the step (`finish` keeps what is left
    /// of the impulses there); the impulse.
    pub(super) inv_c: Vec<R>,
    pub(super) w: Vec<R>,
    pub(super) rate: Vec<R>,
    pub(super) impulse: Vec<R>,
    /// By row: its row of the block's curvature s″, as long as the block has rows; of an interval
    /// one number.
    pub(super) curve: Vec<R>,
    /// By block; only convex cones use theirs.
    pub(super) cones: Vec<Cone<R>>,
    /// By dof.
    pub(super) guess: Vec<R>,
    pub(super) u: Vec<R>,
    pub(super) d: Vec<R>,
    pub(super) inv_d: Vec<R>,
    pub(super) gradient: Vec<R>,
    pub(super) step: Vec<R>,
    /// s″ y of a cone's row.
    pub(super) bent: Vec<R>,
    pub(super) hessian: Hessian<R>,
    /// The same of a heap.
    pub(super) columns: Columns<R>,
    /// By block: its first entry of `curve`.
    pub(super) starts: Vec<usize>,
    /// Lanes whose factors belong to the curvature at hand.
    pub(super) fresh: R::Mask,
    /// Newton's decrement relative to `floor`, the energy of the motion that the rows see.
    pub(super) decrement: R,
    pub(super) floor: R,
    /// u has moved since the impulses were computed, in some lane.
    pub(super) moved: bool,
}

room!(System<R>: inv_c, w, rate, impulse, curve, cones, guess, u, d, inv_d, gradient, step,
    bent, starts; hessian, columns);

impl<R: Real> System<R> {
    pub fn new() -> Self {
        Self {
            inv_c: Vec::new(),
            w: Vec::new(),
            rate: Vec::new(),
            impulse: Vec::new(),
            curve: Vec::new(),
            cones: Vec::new(),
            guess: Vec::new(),
            u: Vec::new(),
            d: Vec::new(),
            inv_d: Vec::new(),
            gradient: Vec::new(),
            step: Vec::new(),
            bent: Vec::new(),
            hessian: Hessian::new(),
            columns: Columns::new(),
            starts: Vec::new(),
            fresh: R::Mask::of(false),
            decrement: R::zero(),
            floor: R::zero(),
            moved: false,
        }
    }

    /// Takes an island in; starts from u or from û, whichever costs less.
    pub fn start(
        &mut self,
        pattern: &Pattern,
        blocks: &[usize],
        inv_d: &[R],
        guess: &[R],
        rows: &Rows<R>,
    ) {
        let take = |out: &mut Vec<R>, from: &[R]| {
            out.clear();
            out.extend(pattern.dofs().iter().map(|k| from[*k]));
        };
        take(&mut self.guess, guess);
        take(&mut self.u, &rows.u);
        take(&mut self.inv_d, inv_d);
        self.d.clear();
        self.d.extend(self.inv_d.iter().map(|inv| R::one() / *inv));
        self.inv_c.clear();
        self.cones.clear();
        self.starts.clear();
        for block in blocks.iter().map(|b| &rows.blocks[*b]) {
            let own = &rows.rows[block.rows.range()];
            self.inv_c.extend(own.iter().map(|row| row.c.recip_or_zero()));
            self.cones
                .push(Cone::new(if block.set == Set::Interval { &[] } else { own }, block.mu));
        }
        let count = self.inv_c.len();
        let mut entries = 0;
        for block in blocks {
            self.starts.push(entries);
            entries += rows.blocks[*block].curves();
        }
        for list in [&mut self.w, &mut self.rate, &mut self.impulse] {
            list.clear();
            list.resize(count, R::zero());
        }
        self.curve.clear();
        self.curve.resize(entries, R::zero());
        for list in [&mut self.gradient, &mut self.step] {
            list.clear();
            list.resize(pattern.dofs().len(), R::zero());
        }
        if pattern.heap {
            self.columns.start(&pattern.nodes);
        }
        if self.u != self.guess {
            let warm = self.cost(pattern, blocks, rows);
            std::mem::swap(&mut self.u, &mut self.guess);
            let cold = self.cost(pattern, blocks, rows);
            std::mem::swap(&mut self.u, &mut self.guess);
            for (u, guess) in self.u.iter_mut().zip(&self.guess) {
                *u = R::select(warm.le(cold), *u, *guess);
            }
        }
    }

    /// ½ (u − û)ᵀD(u − û) + Σ s at u; the first part is 0 at û.
    fn cost(&mut self, pattern: &Pattern, blocks: &[usize], rows: &Rows<R>) -> R {
        let half = R::of(0.5);
        let mut cost = R::zero();
        for ((u, guess), d) in self.u.iter().zip(&self.guess).zip(&self.d) {
            cost += half * *d * (*u - *guess) * (*u - *guess);
        }
        self.laws(pattern, blocks, rows, R::Mask::of(false));
        let mut at = 0;
        for block in blocks.iter().map(|b| &rows.blocks[*b]) {
            for row in &rows.rows[block.rows.range()] {
                let s = -self.impulse[at] * (self.w[at] + half * row.c * self.impulse[at]);
                cost = R::select(block.mask, cost + s, cost);
                at += 1;
            }
        }
        cost
    }

    /// Every row's w and impulse at u; in lanes of `bend` also the curvature.
    /// Returns the lanes where some curvature changed, and the energy that the
    /// velocities of the rows stand for (what rounding is measured by).
    pub(super) fn laws(
        &mut self,
        pattern: &Pattern,
        blocks: &[usize],
        rows: &Rows<R>,
        bend: R::Mask,
    ) -> (R::Mask, R) {
        let (mut changed, mut scale) = (R::Mask::of(false), R::zero());
        let (mut at, mut start) = (0, 0);
        for (b, block) in blocks.iter().map(|b| &rows.blocks[*b]).enumerate() {
            let list = pattern.list(b);
            let first = at;
            let curves = start..start + block.curves();
            start = curves.end;
            let bend = bend.and(block.mask);
            let own = &rows.rows[block.rows.range()];
            for row in own {
                let velocity = pattern.dot(b, &rows.y[row.y..row.y + list.len()], &self.u);
                self.w[at] = velocity - row.t;
                let energy = scale + (velocity * velocity + row.t * row.t) * row.inv_s;
                scale = R::select(block.mask, energy, scale);
                if block.set == Set::Interval {
                    let (impulse, curve) = interval(row, self.inv_c[at], self.w[at]);
                    let bent = curves.start + at - first;
                    let old = self.curve[bent];
                    // At a bound the impulse is constant: another one is the other bound.
                    let jump = impulse - self.impulse[at];
                    let slides = curve.gt(R::zero()).or(jump.abs().le(R::zero()));
                    let same = curve.le(old).and(curve.ge(old)).and(slides);
                    self.impulse[at] = impulse;
                    changed = changed.or(bend.and(same.not()));
                    self.curve[bent] = R::select(bend, curve, old);
                }
                at += 1;
            }
            if block.set == Set::Interval {
                continue;
            }
            let new = if own.len() <= NARROW {
                self.bend_cone::<NARROW>(b, first..at, curves, bend)
            } else {
                self.bend_cone::<CONE>(b, first..at, curves, bend)
            };
            changed = changed.or(new);
        }
        (changed, scale)
    }

    /// The impulses of a cone's rows at their w, and in lanes of `bend` their curvature; the lanes
    /// where that changed.
    fn bend_cone<const N: usize>(
        &mut self,
        cone: usize,
        own: Range<usize>,
        curves: Range<usize>,
        bend: R::Mask,
    ) -> R::Mask {
        let mut changed = R::Mask::of(false);
        let (impulse, curve) = self.cones[cone].law::<N>(padded(&self.w[own.clone()]));
        let len = own.len();
        self.impulse[own].copy_from_slice(&impulse[..len]);
        for (row, new) in self.curve[curves].chunks_exact_mut(len).zip(&curve) {
            for (old, new) in row.iter_mut().zip(new) {
                changed = changed.or(bend.and(new.le(*old).and(new.ge(*old)).not()));
                *old = R::select(bend, *new, *old);
            }
        }
        changed
    }

    /// out += sign · Σ y x, x by row.
    pub(super) fn gather(
        pattern: &Pattern,
        blocks: &[usize],
        rows: &Rows<R>,
        x: &[R],
        sign: R,
        out: &mut [R],
    ) {
        let mut at = 0;
        for (b, block) in blocks.iter().map(|b| &rows.blocks[*b]).enumerate() {
            let list = pattern.list(b);
            for row in &rows.rows[block.rows.range()] {
                let x = sign * x[at];
                if let Some(free) = pattern.free(b) {
                    // A heap is one world.
                    free.add(&rows.y[row.y..row.y + list.len()], x, out);
                    at += 1;
                    continue;
                }
                for (k, y) in list.iter().zip(&rows.y[row.y..row.y + list.len()]) {
                    out[*k] = R::select(block.mask, out[*k] + *y * x, out[*k]);
                }
                at += 1;
            }
        }
    }
}

/// A cone's numbers, 0 for the rows that it does not have.
pub(super) fn padded<R: Real, const N: usize>(x: &[R]) -> [R; N] {
    assert!(x.len() <= N);
    core::array::from_fn(|i| x.get(i).copied().unwrap_or_else(R::zero))
}
