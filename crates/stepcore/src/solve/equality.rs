//! `connect`: a point of one body stays on a point of another. Three equality rows.

use super::law::{OnGuess, SolRef};
use super::rows::{Rows, Set, Site, Source};
use crate::model::{Equality, NONE};
use crate::real::{Mask, Real};
use crate::settings::Law;
use crate::spatial::{rotate, splat, V3};

impl<R: Real> Rows<R> {
    pub(super) fn equalities(&mut self, site: &Site<R>) {
        if !site.model.features.equality {
            return;
        }
        for (index, equality) in site.model.equalities.iter().enumerate() {
            if equality.active {
                self.connect(site, index, equality);
            }
        }
    }

    fn connect(&mut self, site: &Site<R>, index: usize, equality: &Equality) {
        let placed = site.placed;
        let point =
            |body: usize, anchor| placed.xpos[body] + rotate(&placed.xmat[body], &splat(anchor));
        let p1 = point(equality.body1, &equality.anchor1);
        let p2 = point(equality.body2, &equality.anchor2);
        let apart = p1 - p2;
        let curving = self.acceleration(site, equality.body1, &p1)
            - self.acceleration(site, equality.body2, &p2);
        let first = self.rows.len();
        for k in 0..3 {
            let mut axis = V3::zeros();
            axis[k] = R::one();
            for &dof in equality.dofs.of(&site.model.dof_lists) {
                self.scratch[dof] = R::zero();
            }
            self.add_jacobian(site, equality.body1, &p1, &axis);
            self.add_jacobian(site, equality.body2, &p2, &-axis);
            let row = self.push_scratch(site, equality.dofs);
            row.lo = R::of(f64::NEG_INFINITY);
            if site.settings.law == Law::SolRef {
                let dt = site.settings.dt;
                let law =
                    SolRef::at(&equality.soft, apart.dot(&apart).sqrt(), dt, site.settings.refsafe);
                law.fill(row, apart[k], R::of(equality.invweight), R::of(dt));
                row.t -= R::of(dt) * curving[k];
            } else {
                OnGuess::new(site.settings).equality(row, apart[k]);
            }
        }
        let block = self.push_block(
            first,
            Set::Interval,
            R::Mask::of(true),
            Source::Equality(index),
            index as u32,
        );
        block.mass = equality.mass;
    }

    /// Acceleration of a body point when no dof accelerates: J̇ v.
    fn acceleration(&self, site: &Site<R>, body: usize, at: &V3<R>) -> V3<R> {
        let tree = site.model.bodies[body].tree;
        if tree == NONE || site.model.trees[tree].slides_only {
            return V3::zeros();
        }
        let arm = at - site.placed.origin[tree];
        let velocity = &site.placed.velocity[body];
        let free = site.placed.free_acceleration(site.model, body);
        free.at(&arm) + velocity.ang.cross(&velocity.at(&arm))
    }
}
