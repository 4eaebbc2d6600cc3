//! Stage 3, solve: every contact, limit, friction loss and connection as rows of one
//! system, and the impulses on which they all agree.

mod alone;
mod cone;
mod derivative;
mod dot;
mod exact;
mod few;
mod implicit;
mod islands;
pub(crate) mod law;
mod limits;
mod momentum;
mod newton;
mod pgs;
mod residual;
mod rows;
mod solver;
#[cfg(test)]
mod tests;

pub(crate) use derivative::Differentiated;
pub(crate) use limits::Report;
pub(crate) use rows::CONE;
pub use rows::{Block, Push, Row, Rows, Set, Situation};
pub(crate) use solver::{Solve, Solvers, Unconstrained};

use crate::model::{Model, Span};
use crate::real::{Mask, Real};
use crate::spatial::{Force, V3};
use crate::state::{Warm, WARM_ROWS};

impl<R: Real> Rows<R> {
    /// Sets `scratch` to the Jacobian of the relative velocity of two body points at
    /// `at` (body 2 minus body 1) along `direction`, on the union `dofs` of their chains.
    pub(crate) fn relative_jacobian(
        &mut self,
        now: &Situation<R>,
        bodies: [usize; 2],
        dofs: Span,
        at: &V3<R>,
        direction: &V3<R>,
    ) {
        self.clear_scratch(dofs.of(&now.model.dof_lists));
        self.add_jacobian(now, bodies[0], at, &-direction);
        self.add_jacobian(now, bodies[1], at, direction);
    }

    /// The Jacobian of the next row is zero on these dofs.
    #[inline(always)]
    pub(crate) fn clear_scratch(&mut self, dofs: &[usize]) {
        for &k in dofs {
            self.scratch[k] = R::zero();
        }
    }

    /// Adds the Jacobian of one body point's velocity along `direction`.
    pub(crate) fn add_jacobian(
        &mut self,
        now: &Situation<R>,
        body: usize,
        at: &V3<R>,
        direction: &V3<R>,
    ) {
        let body = &now.model.bodies[body];
        if body.tree == crate::model::NONE {
            return;
        }
        let arm = at - now.placed.origin[body.tree];
        let wrench = Force { ang: arm.cross(direction), lin: *direction };
        for &k in body.chain.of(&now.model.dof_lists) {
            self.scratch[k] += now.placed.motion[k].dot(&wrench);
        }
    }

    /// Starts every impulse from the last step's, found by slot.
    pub fn warm_start(&mut self, model: &Model, inv_d: &[R], warm: &[Warm<R>]) {
        let mut at = 0;
        for block in &self.blocks {
            while at < warm.len() && warm[at].slot < block.slot {
                at += 1;
            }
            if at < warm.len() && warm[at].slot == block.slot {
                for (k, row) in self.rows[block.rows.range()].iter_mut().enumerate() {
                    let start = warm[at].impulse[k].clamp(row.lo, row.hi);
                    row.impulse = R::select(block.mask, start, R::zero());
                }
            }
        }
        self.apply_impulses(model, inv_d);
    }

    /// Keeps every impulse for the next step, but for what is no number.
    pub fn store_warm(&self, warm: &mut Vec<Warm<R>>) {
        warm.clear();
        for block in &self.blocks {
            let mut impulse = [R::zero(); WARM_ROWS];
            for (k, row) in self.rows[block.rows.range()].iter().enumerate() {
                let kept = block.mask.and(row.impulse.is_finite());
                impulse[k] = R::select(kept, row.impulse, R::zero());
            }
            warm.push(Warm { slot: block.slot, impulse });
        }
    }
}
