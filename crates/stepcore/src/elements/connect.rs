//! `connect`: a point of one body stays on a point of another. Three equality rows.

use super::constraint::{Constraint, Makings};
use super::{Element, Kind};
use crate::model::{Equality, Model, NONE};
use crate::real::{Mask, Real};
use crate::settings::Law;
use crate::solve::law::{least_softness, OnGuess, SolRef};
use crate::solve::{Part, Rows, Set, Situation};
use crate::spatial::{rotate, splat, Motion, V3};

pub(super) struct Connect;

impl Constraint for Connect {
    const MOST_ROWS: usize = 3;

    fn any(model: &Model) -> bool {
        !model.equalities.is_empty()
    }

    fn make<R: Real>(makings: &mut Makings<R>, rows: &mut Rows<R>) {
        let now = makings.now;
        if !now.model.features.equality {
            return;
        }
        for (index, equality) in now.model.equalities.iter().enumerate() {
            let rests = |body: usize| now.rests(now.model.bodies[body].tree);
            if equality.active && !(rests(equality.body1) && rests(equality.body2)) {
                rows.connect(now, index, equality);
            }
        }
    }
}

impl<R: Real> Rows<R> {
    fn connect(&mut self, now: &Situation<R>, index: usize, equality: &Equality) {
        let placed = now.placed;
        let point =
            |body: usize, anchor| placed.xpos[body] + rotate(&placed.xmat[body], &splat(anchor));
        let p1 = point(equality.body1, &equality.anchor1);
        let p2 = point(equality.body2, &equality.anchor2);
        let apart = p1 - p2;
        let curving = self.acceleration(now, equality.body1, &p1)
            - self.acceleration(now, equality.body2, &p2);
        let first = self.rows.len();
        for k in 0..3 {
            let mut axis = V3::zeros();
            axis[k] = R::one();
            self.clear_scratch(equality.dofs.of(now.dof_lists));
            self.add_jacobian(now, equality.body1, &p1, &axis);
            self.add_jacobian(now, equality.body2, &p2, &-axis);
            self.push_scratch(now, equality.dofs).lo = R::of(f64::NEG_INFINITY);
            let bodies = [equality.body1, equality.body2];
            self.drop_rounding(now, bodies, &p1, equality.mass, Motion::most_at);
        }
        let (dt, law) = (now.settings.dt, OnGuess::new(now));
        let least = least_softness(&self.rows[first..], equality.mass);
        let soft =
            || SolRef::at(&equality.soft, apart.dot(&apart).sqrt(), dt, now.settings.refsafe);
        let soft = (now.settings.law == Law::SolRef).then(soft);
        for (k, row) in self.rows[first..].iter_mut().enumerate() {
            if let Some(law) = &soft {
                law.fill(row, apart[k], R::of(equality.invweight), least, R::of(dt));
                row.t -= R::of(dt) * curving[k];
            } else {
                law.equality(row, apart[k]);
                if now.part == Part::Stage {
                    row.t = row.velocity - R::of(dt) * curving[k];
                }
            }
        }
        if now.part == Part::End && now.settings.connects_inside() {
            for at in first..self.rows.len() {
                self.rows[at].t = self.dot(now.dof_lists, &self.rows[at], &now.placed.guess);
            }
        }
        let element = Element::whole(Kind::Connect, index);
        self.push_block(first, Set::Interval, R::Mask::of(true), now, element, equality.mass);
    }

    /// Acceleration of a body point when no dof accelerates: J̇ v.
    fn acceleration(&self, now: &Situation<R>, body: usize, at: &V3<R>) -> V3<R> {
        let tree = now.model.bodies[body].tree;
        if tree == NONE || now.model.trees[tree].slides_only {
            return V3::zeros();
        }
        let arm = at - now.placed.origin[tree];
        let velocity = &now.placed.velocity[body];
        let free = now.placed.free_acceleration(now.model, body);
        free.at(&arm) + velocity.ang.cross(&velocity.at(&arm))
    }
}
