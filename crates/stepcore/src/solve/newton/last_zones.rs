//! The first step of an island: by the zones in which the last step left its rows.
//!
//! The impulses that rows start from tell which of them pressed and which were at a bound, and from
//! step to step few change. The law at the velocities that these impulses make tells less: where c
//! is small, w/c magnifies what little has changed, so that among tumbling capsules one row in
//! seven appears on the wrong side. So the first direction leads to the minimum that the
//! cost would have with these zones. A block whose impulses are all zero, such as a new contact's,
//! and a cone, whose zones bend, are taken by their laws. The line search is that of every step,
//! and where the direction leads up nothing moves, and the iteration begins as ever.

use super::bundles::Problem;
use super::system::System;
use crate::real::{Mask, Real};
use crate::solve::rows::{Row, Set};

impl<R: Real> System<R> {
    /// With the laws at u at hand: impulses, curvature and gradient in the zones of the impulses that
    /// rows start from, in lanes of `todo`. Lanes in which that is another zone for some row.
    pub(super) fn take_last_zones(&mut self, problem: Problem<R>, todo: R::Mask) -> R::Mask {
        let Problem { rows, blocks, bundles, .. } = problem;
        let (mut other_zones, mut at, mut curve) = (R::Mask::of(false), 0, 0);
        for block in blocks.iter().map(|b| &rows.blocks[*b]) {
            let own = &rows.rows[block.rows.range()];
            let (row, bend) = (at..at + own.len(), curve..curve + block.curves());
            (at, curve) = (row.end, bend.end);
            if block.set != Set::Interval {
                continue;
            }
            let pressed = |row: &Row<R>| row.impulse.abs().gt(R::zero());
            let pressed = own.iter().fold(R::Mask::of(false), |some, row| some.or(pressed(row)));
            let todo = todo.and(block.mask).and(pressed);
            let numbers = self.curve[bend].iter_mut().zip(&mut self.impulse[row.clone()]);
            let given = self.w[row.clone()].iter().zip(&bundles.inv_c[row]);
            for ((row, (curve, impulse)), (w, inv_c)) in own.iter().zip(numbers).zip(given) {
                let active = row.impulse.gt(row.lo).and(row.impulse.lt(row.hi));
                let bend = R::select(active, *inv_c, R::zero());
                let same = bend.le(*curve).and(bend.ge(*curve));
                let other = todo.and(same.not());
                let new = R::select(active, -*w * *inv_c, row.impulse);
                *curve = R::select(other, bend, *curve);
                *impulse = R::select(other, new, *impulse);
                other_zones = other_zones.or(other);
            }
        }
        if other_zones.any() {
            self.changed.fill(true);
            self.slope(problem);
        }
        other_zones
    }
}
