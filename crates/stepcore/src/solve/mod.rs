//! Stage 3, solve: every contact, limit, friction loss and equality as rows of one system, and the
//! impulses that satisfy all of them.

mod active_set;
mod cone;
mod contact_islands;
mod derivative;
mod direct;
pub(crate) mod dofs;
mod dot;
mod edges;
mod free_bodies;
mod islands;
pub(crate) mod law;
mod limits;
mod momentum;
mod newton;
mod one_row;
mod pgs;
mod proximal;
mod relative;
mod residual;
pub(crate) mod rows;
mod saved_solve;
mod situation;
mod solver;
mod square;
#[cfg(test)]
mod tests;

#[cfg(test)]
pub(crate) use contact_islands::ContactIslands;
pub(crate) use derivative::Differentiated;
pub(crate) use direct::{Choice, GROUP};
pub(crate) use limits::Report;
pub(crate) use pgs::Noslip;
pub(crate) use rows::{Anchor, Guessed, CONE};
pub use rows::{Block, Push, Row, Rows, Set};
pub use situation::{Part, Situation};
pub(crate) use solver::{Solve, Solvers, Unconstrained};

use crate::elements::Role;
use crate::real::{Mask, Real};
use crate::spatial::{Motion, V3};
use crate::warm::{Warm, ACCELERATIONS, SLIP, WARM_ROWS};

/// A·m below `SUSPECT` squared roundings may be rounding; relative to the squares of its terms, it
/// is rounding below `ROUNDED`.
const SUSPECT: f64 = 1e8;
const ROUNDED: f64 = 1024.0;

/// Returns where A = J M⁻¹ Jᵀ of a row may be rounding.
#[inline(always)]
fn suspect<R: Real>(a: R, mass: R) -> R::Mask {
    (a * mass).lt(R::of(SUSPECT * R::epsilon() * R::epsilon()))
}

/// Returns where the J of a row with this A, the relative velocity of two bodies' points at `at`, is
/// only rounding from cancellation.
///
/// `size`: the largest possible square of a dof's part, from its motion and the arm to `at`. 1/A of
/// such a row is meaningless: with an equally small regulariser, the row would require a motion at
/// any speed.
fn is_rounding<R: Real>(
    now: &Situation<R>,
    (bodies, at): ([usize; 2], &V3<R>),
    (a, mass): (R, R),
    size: impl Fn(&Motion<R>, &V3<R>) -> R,
) -> R::Mask {
    let suspect = suspect(a, mass);
    if suspect.none() {
        return suspect;
    }
    // A if no term cancelled another.
    let mut terms = R::zero();
    for body in bodies.map(|body| &now.model.bodies[body]) {
        if body.tree == crate::model::NONE {
            continue;
        }
        let arm = at - now.placed.origin[body.tree];
        for &k in body.chain.of(&now.model.dof_lists) {
            terms += now.placed.metric.inv_d[k] * size(&now.placed.motion[k], &arm);
        }
    }
    suspect.and(a.le(R::of(ROUNDED * R::epsilon() * R::epsilon()) * terms))
}

/// Zero in these lanes; slopes stay.
fn without<R: Real>(none: R::Mask, x: R) -> R {
    R::select(none, R::zero(), x).with_slopes_of(none, || x)
}

impl<R: Real> Rows<R> {
    /// Clears the Jacobian of the next row on these dofs.
    #[inline(always)]
    pub(crate) fn clear_scratch(&mut self, dofs: &[usize]) {
        for &k in dofs {
            self.scratch[k] = R::zero();
        }
    }

    /// Turns a row into one that nothing moves (J = 0) where its J is only rounding.
    pub(crate) fn drop_rounding_of(
        &mut self,
        index: usize,
        now: &Situation<R>,
        own: ([usize; 2], &V3<R>),
        mass: R,
        size: impl Fn(&Motion<R>, &V3<R>) -> R,
    ) {
        let row = &self.rows[index];
        let none = is_rounding(now, own, (row.a, mass), size);
        if none.none() {
            return;
        }
        let row = &mut self.rows[index];
        for y in &mut self.y[row.y..row.y + row.dofs.len] {
            *y = without(none, *y);
        }
        row.a = R::select(none, R::zero(), row.a);
        row.velocity = without(none, row.velocity);
    }

    /// Starts every impulse from last step's, matched by slot and feature, except equalities that
    /// the stages of the step held (`inside`). u is unchanged.
    pub fn warm_start(&mut self, warm: &[Warm<R>], inside: bool) {
        let mut at = 0;
        let others = self.blocks.iter().filter(|block| !(inside && block.role == Role::Equality));
        for block in others {
            while at < warm.len() && warm[at].slot < block.kin.start {
                at += 1;
            }
            for warm in warm[at..].iter().take_while(|warm| warm.slot < block.kin.end) {
                let own = warm.feature.le(block.feature).and(warm.feature.ge(block.feature));
                let own = own.and(block.mask);
                for (k, row) in self.rows[block.rows.range()].iter_mut().enumerate() {
                    let start = warm.impulse[k].clamp(row.lo, row.hi);
                    row.impulse = R::select(own, start, row.impulse);
                }
            }
        }
    }

    /// Start Newton from the velocities that follow from `before` (factored) and the accelerations
    /// in `warm`; if there are none, or all are zero, from û. A single row needs no start.
    pub(crate) fn start_along(&mut self, warm: &[Warm<R>], before: &[R], dt: R) {
        self.start.clear();
        if matches!(self.blocks[..], [Block { set: Set::Interval, .. }]) && self.rows.len() == 1 {
            return;
        }
        self.start.extend_from_slice(&self.u);
        let kept = warm.partition_point(|warm| warm.slot < ACCELERATIONS);
        for Warm { slot, impulse, .. } in &warm[kept..] {
            let first = WARM_ROWS * (slot - ACCELERATIONS) as usize;
            let dofs = self.start.iter_mut().zip(before).skip(first);
            let acts = |some: R::Mask, rate: &R| some.or(rate.abs().gt(R::zero()));
            let acts = impulse.iter().take(dofs.len()).fold(R::Mask::of(false), acts);
            for ((u, before), rate) in dofs.zip(impulse) {
                *u = R::select(acts, *before + dt * *rate, *u);
            }
        }
    }

    /// Stores the accelerations since the velocities `before` (factored) after the impulses, in
    /// lanes with rows.
    pub(crate) fn store_accelerations(&self, warm: &mut Vec<Warm<R>>, before: &[R], rate: R) {
        let none = R::Mask::of(false);
        let solved = self.blocks.iter().fold(none, |some, block| some.or(block.mask));
        if solved.none() {
            return;
        }
        let parts = self.u.chunks(WARM_ROWS).zip(before.chunks(WARM_ROWS));
        for (slot, (u, before)) in (ACCELERATIONS..).zip(parts) {
            let mut impulse = [R::zero(); WARM_ROWS];
            for ((to, u), before) in impulse.iter_mut().zip(u).zip(before) {
                let rate = (*u - *before) * rate;
                *to = R::select(solved.and(rate.is_finite()), rate, R::zero());
            }
            warm.push(Warm { slot, feature: R::zero(), impulse });
        }
    }

    /// Returns the impulse of a row from the main solve.
    pub(crate) fn solved(&self, row: usize) -> R {
        self.main.get(row).copied().unwrap_or(self.rows[row].impulse)
    }

    /// Stores every finite impulse for the next step; for equalities that the stages of the step
    /// held (`inside`), the impulses there.
    pub fn store_warm(&self, warm: &mut Vec<Warm<R>>, inside: bool) {
        warm.clear();
        let mut anchors = self.anchors.iter().peekable();
        for (index, block) in self.blocks.iter().enumerate() {
            let mut impulse = [R::zero(); WARM_ROWS];
            for (k, row) in self.rows[block.rows.range()].iter().enumerate() {
                let held = inside && block.role == Role::Equality;
                let own = if held { row.beside } else { self.solved(block.rows.start + k) };
                let kept = block.mask.and(own.is_finite());
                impulse[k] = R::select(kept, own, R::zero());
            }
            if let Some(anchor) = anchors.next_if(|anchor| anchor.block == index) {
                for (to, slip) in impulse[SLIP..].iter_mut().zip(self.held_slip(anchor, block)) {
                    *to = R::select(block.mask.and(slip.is_finite()), slip, R::zero());
                }
            }
            let feature = R::select(block.mask, block.feature, -R::one());
            warm.push(Warm { slot: block.slot, feature, impulse });
        }
    }
}
