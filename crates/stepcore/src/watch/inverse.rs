//! Inverse dynamics: the forces that give an acceleration.

use crate::error::{Error, Result};
use crate::real::{Mask, Real};
use crate::settings::Law;
use crate::sim::Sim;

impl<R: Real> Sim<R> {
    /// The generalised forces that must be applied, in all, for the acceleration `qacc` at the
    /// present state: M qacc + bias − passive − Jᵀf, where f are the constraint forces of a motion
    /// with that acceleration. Call `forward` first. MuJoCo's `mj_inverse`.
    pub fn inverse(&self, qacc: &[f64], lane: usize) -> Result<Vec<f64>> {
        if self.settings.law != Law::SolRef {
            let limit = "'solref' for inverse dynamics: the rows of other laws have no force that \
                         follows from the acceleration";
            return Err(Error::value("law", self.settings.law.name(), limit));
        }
        let nv = self.model.nv;
        let velocity: Vec<R> =
            (0..nv).map(|k| self.state.qvel[k] + self.clock.dt * R::of(qacc[k])).collect();
        let mut u = velocity.clone();
        self.placed.metric.to_factored(&velocity, &mut u);
        let lists = self.detected.dof_lists(&self.model);
        let Some(impulses) = self.rows.impulses_at(lists, &u) else {
            let limit = "more than 0 of every row for inverse dynamics (solimp below 1)";
            return Err(Error::value("regulariser of a row", 0, limit));
        };
        let mut held = vec![R::zero(); nv];
        for block in self.rows.blocks.iter().filter(|block| block.mask.lane(lane)) {
            for at in block.rows.range() {
                let row = &self.rows.rows[at];
                for (k, y) in row.dofs.of(lists).iter().zip(&self.rows.y[row.y..]) {
                    held[*k] += *y * impulses[at];
                }
            }
        }
        for push in &self.rows.pushes {
            for (k, y) in push.dofs.of(lists).iter().zip(&self.rows.y[push.y..]) {
                held[*k] += *y * push.impulse;
            }
        }
        self.placed.metric.lower(&mut held);
        let mass = self.mass_matrix(lane)?;
        let force = |k: usize| {
            let row = &mass[k * nv..(k + 1) * nv];
            let inertial: f64 = row.iter().zip(qacc).map(|(m, a)| m * a).sum();
            let smooth = self.placed.bias[k].lane(lane) - self.placed.passive[k].lane(lane);
            inertial + smooth - held[k].lane(lane) / self.clock.seconds
        };
        Ok((0..nv).map(force).collect())
    }
}
