//! The first step of an island: the zones of its rows at the end of the last step.
//!
//! Last step's impulses show which rows were active and which were at a bound, and few rows change
//! from step to step. The law at the velocities that these impulses cause is less reliable: if c is
//! small, w/c magnifies small changes, so that among tumbling capsules one row in seven appears on
//! the wrong side. So the first direction leads to the minimum of the cost with these zones. The
//! laws are used for a block whose impulses are all zero, such as a new contact, and for a cone,
//! whose zones are curved. The line search is the usual one; if the direction leads up, nothing
//! moves, and the iteration starts as usual.

use super::bundles::Problem;
use super::system::System;
use crate::real::{Mask, Real};
use crate::solve::rows::{Row, Set};

impl<R: Real> System<R> {
    /// With the laws at u computed: sets impulses, curvature and gradient to the zones of the initial
    /// impulses, in lanes of `todo`. Returns the lanes in which the zone of some row differs.
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
