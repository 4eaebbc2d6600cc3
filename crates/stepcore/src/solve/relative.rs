//! Rows of how two bodies move against each other, several directions at a time.
//!
//! A contact's normal and tangents share bodies, points and dofs: each dof's motion, each entry of
//! the factors and each place in a list is read once for all of them. The numbers are those of one
//! row after another (`Rows::push_scratch`), bit for bit.

use super::rows::{Rows, Situation};
use crate::model::{Model, Span, NONE};
use crate::place::Metric;
use crate::real::Real;
use crate::scene::JointType;
use crate::spatial::{Force, V3};

/// The most directions at a time.
pub(super) const WIDE: usize = 3;
/// Dofs of a free body.
pub(super) const SIX: usize = 6;

/// One of the two bodies: the forces whose power is its part of each row's velocity.
struct Side<'a, R: Real, const N: usize> {
    chain: &'a [usize],
    along: [Force<R>; N],
}

impl<'a, R: Real, const N: usize> Side<'a, R, N> {
    /// None: nothing moves the body.
    pub fn of(now: &Situation<'a, R>, body: usize, at: &V3<R>, along: [V3<R>; N]) -> Option<Self> {
        let body = &now.model.bodies[body];
        if body.tree == NONE {
            return None;
        }
        let arm = at - now.placed.origin[body.tree];
        let along = along.map(|d| Force { ang: arm.cross(&d), lin: d });
        Some(Self { chain: body.chain.of(&now.model.dof_lists), along })
    }

    /// J of one dof in each direction.
    #[inline(always)]
    fn of_dof(&self, now: &Situation<R>, k: usize) -> [R; N] {
        let motion = &now.placed.motion[k];
        let mut j = [R::zero(); N];
        for (j, along) in j.iter_mut().zip(&self.along) {
            *j += motion.dot(along);
        }
        j
    }

    /// The same of all dofs of a free joint, which moves along the world's axes and turns about the
    /// body's. What is left out is products with 0, which are added to numbers that are no −0.
    #[inline(always)]
    fn of_free_joint(&self, now: &Situation<R>, first: usize) -> [[R; N]; SIX] {
        let mut x = [[R::zero(); N]; SIX];
        for (i, along) in self.along.iter().enumerate() {
            for k in 0..3 {
                x[k][i] += along.lin[k];
                x[3 + k][i] += now.placed.motion[first + 3 + k].ang.dot(&along.ang);
            }
        }
        x
    }

    /// The dofs that move the body begin with this one.
    pub fn begins(&self, first: usize) -> bool {
        self.chain.first() == Some(&first)
    }

    /// The same of six dofs one after another.
    #[inline(always)]
    pub fn of_six(&self, now: &Situation<R>, first: usize) -> [[R; N]; SIX] {
        let joint = now.model.dofs[first].joint;
        if now.model.joints[joint].kind == JointType::Free {
            return self.of_free_joint(now, first);
        }
        core::array::from_fn(|k| self.of_dof(now, first + k))
    }
}

impl<R: Real> Rows<R> {
    /// Pushes the rows of the relative velocity of two body points, each at its `at` (body 2 minus
    /// body 1), along N directions, on the union `dofs` of their chains.
    pub(crate) fn push_relative<const N: usize>(
        &mut self,
        now: &Situation<R>,
        bodies: [usize; 2],
        dofs: Span,
        at: &[V3<R>; 2],
        along: &[V3<R>; N],
    ) {
        let sides = [
            Side::of(now, bodies[0], &at[0], along.map(|d| -d)),
            Side::of(now, bodies[1], &at[1], *along),
        ];
        let start = self.y.len();
        self.y.resize(start + N * dofs.len, R::zero());
        let list = dofs.of(now.dof_lists);
        let sums = if all_free(now.model, list, &sides) {
            self.lift_free(now, list, &sides, start)
        } else {
            self.lift_any(now, list, &sides, start)
        };
        for (i, (a, velocity)) in sums.into_iter().enumerate() {
            self.push_row(dofs, start + i * dofs.len, a, velocity);
        }
    }

    /// y of all directions from `start` on; A and J v of each.
    fn lift_any<const N: usize>(
        &mut self,
        now: &Situation<R>,
        list: &[usize],
        sides: &[Option<Side<R, N>>; 2],
        start: usize,
    ) -> [(R, R); N] {
        // By dof N numbers, of which the rest of `scratch` has room.
        let scratch = &mut self.scratch;
        for k in list {
            scratch[k * N..(k + 1) * N].fill(R::zero());
        }
        for side in sides.iter().flatten() {
            for &k in side.chain {
                let j = side.of_dof(now, k);
                for (x, j) in scratch[k * N..(k + 1) * N].iter_mut().zip(j) {
                    *x += j;
                }
            }
        }
        now.placed.metric.lift_each::<N>(list, scratch);
        let mut sums = [(R::zero(), R::zero()); N];
        for (at, &k) in list.iter().enumerate() {
            let (inv_d, u) = (now.placed.metric.inv_d[k], now.placed.u[k]);
            for (i, (a, velocity)) in sums.iter_mut().enumerate() {
                let y = self.scratch[k * N + i];
                *a += y * y * inv_d;
                *velocity += y * u;
                self.y[start + i * list.len() + at] = y;
            }
        }
        sums
    }

    /// The same of free bodies.
    fn lift_free<const N: usize>(
        &mut self,
        now: &Situation<R>,
        list: &[usize],
        sides: &[Option<Side<R, N>>; 2],
        start: usize,
    ) -> [(R, R); N] {
        let mut sums = [(R::zero(), R::zero()); N];
        for from in (0..list.len()).step_by(SIX) {
            let first = list[from];
            let mine = sides.iter().flatten().find(|side| side.begins(first));
            let Some(side) = mine else { continue };
            let mut x = side.of_six(now, first);
            now.placed.metric.lift_six(first, &mut x);
            let inv_d = &now.placed.metric.inv_d[first..first + SIX];
            let u = &now.placed.u[first..first + SIX];
            for (i, (a, velocity)) in sums.iter_mut().enumerate() {
                let out = &mut self.y[start + i * list.len() + from..][..SIX];
                for k in 0..SIX {
                    let y = x[k][i];
                    *a += y * y * inv_d[k];
                    *velocity += y * u[k];
                    out[k] = y;
                }
            }
        }
        sums
    }

    /// Takes the rows from `first` on, which share their dofs and stand last, back; the edges that
    /// are pushed next are made of their y.
    pub(crate) fn take_ways(&mut self, first: usize) {
        let start = self.rows[first].y;
        self.ways.clear();
        self.ways.extend_from_slice(&self.y[start..]);
        self.y.truncate(start);
        self.rows.truncate(first);
    }

    /// Pushes two rows whose y are y(0) ± k · y(way) of the rows that were taken back, whose J v
    /// are `one` and `two`: edges of a pyramid.
    pub(crate) fn push_edges(
        &mut self,
        now: &Situation<R>,
        dofs: Span,
        way: usize,
        (one, two): (R, R),
        k: R,
    ) {
        let (list, start, len) = (dofs.of(now.dof_lists), self.y.len(), dofs.len);
        let (normal, tangent) = self.ways.split_at_mut(way * len);
        let (normal, tangent) = (&normal[..len], &mut tangent[..len]);
        tangent.iter_mut().for_each(|y| *y = k * *y);
        let along = || normal.iter().zip(&*tangent);
        self.y.extend(along().map(|(normal, by)| *normal + *by));
        self.y.extend(along().map(|(normal, by)| *normal - *by));
        let (plus, minus) = self.y[start..].split_at(len);
        let (mut a, mut b) = (R::zero(), R::zero());
        for ((up, down), dof) in plus.iter().zip(minus).zip(list) {
            let inv_d = now.placed.metric.inv_d[*dof];
            a += *up * *up * inv_d;
            b += *down * *down * inv_d;
        }
        self.push_row(dofs, start, a, one + k * two);
        self.push_row(dofs, start + len, b, one - k * two);
    }

    /// Pushes the first of the rows that were taken back again.
    pub(crate) fn push_normal(&mut self, dofs: Span, a: R, velocity: R) {
        let start = self.y.len();
        self.y.extend_from_slice(&self.ways[..dofs.len]);
        self.push_row(dofs, start, a, velocity);
    }
}

/// The list is that of one or two free bodies, whose inertias nothing ties together.
fn all_free<R: Real, const N: usize>(
    model: &Model,
    list: &[usize],
    sides: &[Option<Side<R, N>>; 2],
) -> bool {
    let bodies = || sides.iter().flatten();
    let apart = list.len() == bodies().count() * SIX && !model.couples;
    apart && bodies().all(|side| is_free(model, side.chain))
}

/// The dofs are those of one free body.
pub(super) fn is_free(model: &Model, chain: &[usize]) -> bool {
    let [first, .., last] = chain else { return false };
    chain.len() == SIX && *last == first + SIX - 1 && model.dofs[*first].row.len == 1
}

impl<R: Real> Metric<R> {
    /// x ← L⁻ᵀ x of N vectors side by side, on an ancestor-closed, ascending list of dofs.
    #[inline(always)]
    fn lift_each<const N: usize>(&self, dofs: &[usize], x: &mut [R]) {
        for &k in dofs.iter().rev() {
            let mut factor = [R::zero(); N];
            factor.copy_from_slice(&x[k * N..(k + 1) * N]);
            for (l, j) in self.row(k) {
                for (x, factor) in x[j * N..(j + 1) * N].iter_mut().zip(factor) {
                    *x -= l * factor;
                }
            }
        }
    }

    /// The same on the six dofs of a free body.
    #[inline(always)]
    pub(super) fn lift_six<const N: usize>(&self, first: usize, x: &mut [[R; N]; SIX]) {
        for k in (1..SIX).rev() {
            // Nearest ancestor first.
            let (above, own) = x.split_at_mut(k);
            for (l, x) in self.left_of(first + k).iter().zip(above.iter_mut().rev()) {
                for i in 0..N {
                    let taken = *l * own[0][i];
                    x[i] -= taken;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Body, Geom, Joint, JointType, Scene};
    use crate::settings::Settings;
    use crate::sim::Sim;
    use crate::solve::tests::Random;
    use std::sync::Arc;

    /// Two free bodies, whose mass is beside their origin.
    fn two_bodies() -> Sim<f64> {
        let mut scene = Scene::default();
        for k in 0..2 {
            let pos = [0.3 * f64::from(k), 0.1, 0.2];
            scene.bodies.push(Body { pos, ..Body::default() });
            let body = scene.bodies.len() - 1;
            scene.joints.push(Joint { body, kind: JointType::Free, ..Joint::default() });
            let geom =
                Geom { body, size: [0.1, 0.0, 0.0], pos: [0.05, 0.02, 0.01], ..Geom::default() };
            scene.geoms.push(geom);
        }
        let mut sim =
            Sim::new(Arc::new(Model::compile(&scene).unwrap()), Settings::default()).unwrap();
        sim.forward().unwrap();
        sim
    }

    /// Several vectors at once, over a list or over a free body's six dofs, are one after another.
    #[test]
    fn vectors_are_lifted_as_one_is() {
        let sim = two_bodies();
        let metric = &sim.placed.metric;
        let mut random = Random::new(4);
        let given: Vec<[f64; 3]> = (0..12).map(|_| [0; 3].map(|_| random.next())).collect();
        let list: Vec<usize> = (6..12).collect();
        assert!(is_free(&sim.model, &list) && !is_free(&sim.model, &list[1..]));
        let mut each: Vec<f64> = given.iter().flatten().copied().collect();
        metric.lift_each::<3>(&list, &mut each);
        let mut six: [[f64; 3]; 6] = core::array::from_fn(|k| given[6 + k]);
        metric.lift_six(6, &mut six);
        for i in 0..3 {
            let mut one: Vec<f64> = given.iter().map(|x| x[i]).collect();
            metric.lift(&list, &mut one);
            assert!((6..12).any(|k| one[k] != given[k][i]));
            for k in 6..12 {
                assert_eq!([each[3 * k + i], six[k - 6][i]], [one[k]; 2]);
            }
        }
    }
}
