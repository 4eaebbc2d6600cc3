//! `connect`: a point of one body stays on a point of another. Three equality rows, along x, y, z.

use super::equality::Held;
use crate::model::{Ends, NONE};
use crate::real::{Real, Value};
use crate::solve::{Rows, Situation};
use crate::spatial::{rotate, splat, Motion, V3};

/// The distance between a point of one body and a point of another.
pub(super) struct Apart<R: Real> {
    pub way: V3<R>,
    /// Its acceleration when no dof accelerates.
    pub curving: V3<R>,
}

impl<R: Real> Rows<R> {
    pub(super) fn connect(&mut self, now: &Situation<R>, index: usize, ends: &Ends<R::Value>) {
        let first = self.rows.len();
        let Apart { way, curving } = self.points(now, index, ends);
        let held = [0, 1, 2].map(|k| Held {
            gap: way[k],
            curving: curving[k],
            invweight: ends.invweight[0].get(),
        });
        self.tie(now, index, first, way.dot(&way).sqrt(), &held);
    }

    /// Makes the rows of the points alone.
    pub(super) fn points(
        &mut self,
        now: &Situation<R>,
        index: usize,
        ends: &Ends<R::Value>,
    ) -> Apart<R> {
        let (placed, equality) = (now.placed, &now.model.equalities[index]);
        let [one, two] = ends.bodies;
        let point = |k: usize| {
            let body = ends.bodies[k];
            placed.xpos[body] + rotate(&placed.xmat[body], &splat(&ends.pos[k]))
        };
        let (p1, p2) = (point(0), point(1));
        let first = self.rows.len();
        let along = [V3::x(), V3::y(), V3::z()];
        self.push_relative(now, ([two, one], equality.dofs), Some(&[p2, p1]), &along);
        for row in first..self.rows.len() {
            self.rows[row].lo = R::of(f64::NEG_INFINITY);
            let (ends, mass) = ((ends.bodies, &p1), equality.mass.get());
            self.drop_rounding_of(row, now, ends, mass, Motion::most_at);
        }
        let curving = self.acceleration(now, one, &p1) - self.acceleration(now, two, &p2);
        Apart { way: p1 - p2, curving }
    }

    /// Returns the acceleration of a body point when no dof accelerates: J̇ v.
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
