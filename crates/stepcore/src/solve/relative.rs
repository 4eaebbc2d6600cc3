//! Rows of the relative motion of two bodies, several directions at a time.
//!
//! A contact's normal and tangents share bodies, points and dofs: each dof's motion, each entry of
//! the factors and each place in a list is read once for all of them. The numbers equal the results
//! of one row after another (`Rows::push_scratch`), bit for bit.

use super::rows::Rows;
use super::situation::Situation;
use super::{is_rounding, without};
use crate::model::{Model, Pair, Span, NONE};
use crate::place::Metric;
use crate::real::{Constant, Mask, Real};
use crate::scene::JointType;
use crate::spatial::{Motion, V3};

/// Dofs of a free body.
pub(super) const SIX: usize = 6;

/// One of the two bodies: the forces whose power is its part of each row's velocity, number by number.
struct Side<'a, R: Real, const N: usize> {
    chain: &'a [usize],
    ang: [[R; N]; 3],
    lin: [[R; N]; 3],
}

impl<'a, R: Real, const N: usize> Side<'a, R, N> {
    /// None if nothing moves the body.
    pub fn of(now: &Situation<'a, R>, body: usize, at: &V3<R>, along: [V3<R>; N]) -> Option<Self> {
        let body = &now.model.bodies[body];
        if body.tree == NONE {
            return None;
        }
        let arm = at - now.placed.origin[body.tree];
        let torques = along.map(|d| arm.cross(&d));
        let numbers = |of: &[V3<R>; N]| crate::real::array::from_fn(|k| of.map(|v| v[k]));
        let chain = body.chain.of(&now.model.dof_lists);
        Some(Self { chain, ang: numbers(&torques), lin: numbers(&along) })
    }

    /// The same for the body's rotation about some axes.
    fn turning(now: &Situation<'a, R>, body: usize, about: [V3<R>; N]) -> Option<Self> {
        let body = &now.model.bodies[body];
        if body.tree == NONE {
            return None;
        }
        let ang = crate::real::array::from_fn(|k| about.map(|axis| axis[k]));
        let chain = body.chain.of(&now.model.dof_lists);
        Some(Self { chain, ang, lin: [[R::zero(); N]; 3] })
    }

    /// Returns J of one dof in each direction.
    #[inline(always)]
    fn of_dof(&self, now: &Situation<R>, k: usize) -> [R; N] {
        let Motion { ang, lin } = &now.placed.motion[k];
        let mut j = [R::zero(); N];
        for i in 0..N {
            let turn = ang.x * self.ang[0][i] + ang.y * self.ang[1][i] + ang.z * self.ang[2][i];
            let slide = lin.x * self.lin[0][i] + lin.y * self.lin[1][i] + lin.z * self.lin[2][i];
            j[i] += turn + slide;
        }
        j
    }

    /// The same for all dofs of a free joint, which moves along the world's axes and turns about
    /// the body's. The omitted terms are products with 0, added to numbers that are never −0.
    #[inline(always)]
    fn of_free_joint(&self, now: &Situation<R>, first: usize) -> [[R; N]; SIX] {
        let mut x = [[R::zero(); N]; SIX];
        for k in 0..3 {
            let axis = &now.placed.motion[first + 3 + k].ang;
            for i in 0..N {
                let [a, b, c] = self.ang.map(|ang| ang[i]);
                x[k][i] += self.lin[k][i];
                x[3 + k][i] += axis.x * a + axis.y * b + axis.z * c;
            }
        }
        x
    }

    /// Returns whether the dofs that move the body start with this one.
    pub fn begins(&self, first: usize) -> bool {
        self.chain.first() == Some(&first)
    }

    /// The same for six consecutive dofs.
    #[inline(always)]
    pub fn of_six(&self, now: &Situation<R>, first: usize) -> [[R; N]; SIX] {
        let joint = now.model.dofs[first].joint;
        if now.model.joints[joint].kind == JointType::Free {
            return self.of_free_joint(now, first);
        }
        crate::real::array::from_fn(|k| self.of_dof(now, first + k))
    }
}

impl<R: Real> Rows<R> {
    /// Pushes the rows of the relative velocity of two body points, each at its `at` (body 2 minus
    /// body 1), along up to three directions; without `at`, of the angular velocity about them.
    /// `dofs`: the union of the bodies' chains.
    pub(crate) fn push_relative(
        &mut self,
        now: &Situation<R>,
        (bodies, dofs): ([usize; 2], Span),
        at: Option<&[V3<R>; 2]>,
        along: &[V3<R>],
    ) {
        let own = (bodies, dofs);
        match *along {
            [a] => self.push_some(now, own, at, ([a], 1)),
            [a, b] => self.push_some(now, own, at, ([a, b], 2)),
            // Four numbers fill a register; lanes fill registers already.
            [a, b, c] if R::FILLS => self.push_some(now, own, at, ([a, b, c, V3::zeros()], 3)),
            [a, b, c] => self.push_some(now, own, at, ([a, b, c], 3)),
            _ => {}
        }
    }

    /// The same along the first `count` of N directions.
    fn push_some<const N: usize>(
        &mut self,
        now: &Situation<R>,
        (bodies, dofs): ([usize; 2], Span),
        at: Option<&[V3<R>; 2]>,
        (along, count): ([V3<R>; N], usize),
    ) {
        let side = |which: usize, along| match at {
            Some(at) => Side::of(now, bodies[which], &at[which], along),
            None => Side::turning(now, bodies[which], along),
        };
        let sides = &[side(0, along.map(|d| -d)), side(1, along)];
        let start = self.y.len();
        self.y.resize(start + count * dofs.len, R::zero());
        let list = dofs.of(now.dof_lists);
        let sums = if all_free(now.model, list, sides) {
            self.lift_free(now, list, sides, (start, count))
        } else {
            let together = at.is_none_or(|at| at[0] == at[1]);
            self.lift_any(now, list, (sides, together), (start, count))
        };
        for i in 0..count {
            self.push_row(dofs, start + i * dofs.len, sums.a[i], sums.velocity[i]);
        }
    }

    /// Computes y of the first `count` directions from `start` on; returns A and J v of each.
    fn lift_any<const N: usize>(
        &mut self,
        now: &Situation<R>,
        list: &[usize],
        (sides, together): (&[Option<Side<R, N>>; 2], bool),
        (start, count): (usize, usize),
    ) -> Sums<R, N> {
        self.lift_sides(now, list, sides, together);
        let mut sums = Sums::none();
        let lifted = || self.scratch.chunks_exact(N);
        for (&k, y) in list.iter().zip(lifted()) {
            let Some(y) = y.first_chunk() else { break };
            sums.add(y, now.placed.metric.inv_d[k], now.placed.u[k]);
        }
        let rows = self.y[start..start + count * list.len()].chunks_exact_mut(list.len().max(1));
        for (i, row) in rows.enumerate() {
            row.iter_mut().zip(lifted()).for_each(|(out, y)| *out = y[i]);
        }
        sums
    }

    /// Sets the first of `scratch`, N numbers for each dof of the list, to y of all directions.
    /// `together`: both points coincide, so that a dof that moves both bodies does not separate them.
    #[inline(always)]
    fn lift_sides<const N: usize>(
        &mut self,
        now: &Situation<R>,
        list: &[usize],
        sides: &[Option<Side<R, N>>; 2],
        together: bool,
    ) {
        let metric = &now.placed.metric;
        let chains = sides.each_ref().map(|side| side.as_ref().map_or(&[][..], |side| side.chain));
        // These functions would be large for other numbers.
        let branches = if R::FILLS { Branches::of(list, chains) } else { None };
        match branches
            .filter(|_| chains.iter().all(|chain| chain.is_empty() || metric.is_path(chain)))
        {
            Some(branches) => self.lift_branches(now, &branches, sides, together),
            None => self.lift_listed(now, list, sides),
        }
    }

    /// The same for bodies whose dofs are one chain after the other: number by number in the list's
    /// order, without the shared dofs if they move nothing.
    #[inline(always)]
    fn lift_branches<const N: usize>(
        &mut self,
        now: &Situation<R>,
        Branches { shared, ends }: &Branches,
        sides: &[Option<Side<R, N>>; 2],
        together: bool,
    ) {
        let metric = &now.placed.metric;
        let count = shared.len() + ends[0].1.len() + ends[1].1.len();
        let (both, rest) = self.scratch[..count * N].split_at_mut(shared.len() * N);
        let (first, second) = rest.split_at_mut(ends[0].1.len() * N);
        for (&k, x) in shared.iter().zip(both.chunks_exact_mut(N)) {
            x.fill(R::zero());
            for side in sides.iter().flatten().filter(|_| !together) {
                x.iter_mut().zip(side.of_dof(now, k)).for_each(|(x, j)| *x += j);
            }
        }
        for ((which, end), own) in ends.iter().zip([&mut *first, &mut *second]) {
            let Some(side) = &sides[*which] else { continue };
            for (&k, x) in end.iter().zip(own.chunks_exact_mut(N)) {
                x.copy_from_slice(&side.of_dof(now, k));
            }
        }
        metric.lift_end::<N>(ends[1].1, second, both);
        metric.lift_end::<N>(ends[0].1, first, both);
        metric.lift_path::<N>(shared, both);
    }

    /// The same for any list.
    #[inline(always)]
    fn lift_listed<const N: usize>(
        &mut self,
        now: &Situation<R>,
        list: &[usize],
        sides: &[Option<Side<R, N>>; 2],
    ) {
        let (metric, scratch) = (&now.placed.metric, &mut self.scratch);
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
        metric.lift_each::<N>(list, scratch);
        // Lists ascend: no place is read after it was written.
        for (at, k) in list.iter().enumerate() {
            scratch.copy_within(k * N..(k + 1) * N, at * N);
        }
    }

    /// Computes the y of the four edges J_n ± μ J_t of a contact; returns their start, A and J v of
    /// the normal and two tangents, and A of the edges.
    pub(super) fn lift_pyramid(
        &mut self,
        now: &Situation<R>,
        (bodies, pair): ([usize; 2], &Pair<R>),
        at: &[V3<R>; 2],
        [n, a, b]: &[V3<R>; 3],
        mu: R,
    ) -> (usize, Sums<R, 4>, [R; 4]) {
        let along = [*n, *a, *b, V3::zeros()];
        let sides = [
            Side::of(now, bodies[0], &at[0], along.map(|d| -d)),
            Side::of(now, bodies[1], &at[1], along),
        ];
        let (list, start) = (pair.dofs.of(now.dof_lists), self.y.len());
        self.lift_sides(now, list, &sides, at[0] == at[1]);
        self.y.resize(start + 4 * list.len(), R::zero());
        let (ways, edges) = self.edges_of_ways(now, list, start, mu);
        let none = crate::real::array::from_fn::<_, 3>(|i| {
            let most =
                |motion: &Motion<R>, arm: &V3<R>| motion.most_at(arm) * along[i].dot(&along[i]);
            is_rounding(now, (bodies, &at[0]), (ways.a[i], pair.mass), most)
        });
        if !none.iter().any(|none| none.any()) {
            return (start, ways, edges);
        }
        for y in self.scratch.chunks_exact_mut(4).take(list.len()) {
            y.iter_mut().zip(none).for_each(|(y, none)| *y = without(none, *y));
        }
        let (ways, edges) = self.edges_of_ways(now, list, start, mu);
        (start, ways, edges)
    }

    /// Writes edges from `start` on, from the normal and two tangents whose y are side by side in
    /// `scratch`; returns the sums of these, and A of the edges.
    #[inline(always)]
    fn edges_of_ways(
        &mut self,
        now: &Situation<R>,
        list: &[usize],
        start: usize,
        mu: R,
    ) -> (Sums<R, 4>, [R; 4]) {
        let (one, two) = self.y[start..].split_at_mut(2 * list.len());
        let (up, down) = one.split_at_mut(list.len());
        let (left, right) = two.split_at_mut(list.len());
        let out = up.iter_mut().zip(down).zip(left.iter_mut().zip(right));
        let (mut ways, mut edges) = (Sums::<R, 4>::none(), Sums::<R, 4>::none());
        for ((&k, y), out) in list.iter().zip(self.scratch.chunks_exact(4)).zip(out) {
            let Some(y @ &[n, a, b, _]) = y.first_chunk() else { break };
            let (inv_d, u) = (now.placed.metric.inv_d[k], now.placed.u[k]);
            ways.add(y, inv_d, u);
            let (p, q) = (mu * a, mu * b);
            let line = [n + p, n - p, n + q, n - q];
            edges.add(&line, inv_d, u);
            let ((up, down), (left, right)) = out;
            [*up, *down, *left, *right] = line;
        }
        (ways, edges.a)
    }

    /// The same for free bodies.
    fn lift_free<const N: usize>(
        &mut self,
        now: &Situation<R>,
        list: &[usize],
        sides: &[Option<Side<R, N>>; 2],
        (start, count): (usize, usize),
    ) -> Sums<R, N> {
        let mut sums = Sums::none();
        for from in (0..list.len()).step_by(SIX) {
            let first = list[from];
            let mine = sides.iter().flatten().find(|side| side.begins(first));
            let Some(side) = mine else { continue };
            let mut x = side.of_six(now, first);
            now.placed.metric.lift_six(first, &mut x);
            for k in 0..SIX {
                sums.add(&x[k], now.placed.metric.inv_d[first + k], now.placed.u[first + k]);
                for i in 0..count {
                    self.y[start + i * list.len() + from + k] = x[k][i];
                }
            }
        }
        sums
    }

    /// Removes the rows from `first` on, which share their dofs and are last; the edges pushed next
    /// are made of their y.
    pub(crate) fn take_ways(&mut self, first: usize) {
        let start = self.rows[first].y;
        self.ways.clear();
        self.ways.extend_from_slice(&self.y[start..]);
        self.y.truncate(start);
        self.rows.truncate(first);
    }

    /// Push two rows whose y are y(0) ± k · y(way) of the removed rows, whose J v are `one` and
    /// `two`: edges of a pyramid.
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

    /// Pushes the first of the removed rows again.
    pub(crate) fn push_normal(&mut self, dofs: Span, a: R, velocity: R) {
        let start = self.y.len();
        self.y.extend_from_slice(&self.ways[..dofs.len]);
        self.push_row(dofs, start, a, velocity);
    }
}

/// The dofs of two chains, from a list that contains no others.
struct Branches<'a> {
    /// Dofs at the start of both chains.
    shared: &'a [usize],
    /// The remaining dofs of each chain, in the list's order, and which of the two it is.
    ends: [(usize, &'a [usize]); 2],
}

impl<'a> Branches<'a> {
    /// None if the list has other dofs too, or if the chains interleave.
    #[inline(always)]
    fn of(list: &'a [usize], [one, two]: [&'a [usize]; 2]) -> Option<Self> {
        let count = one.iter().zip(two).take_while(|(one, two)| one == two).count();
        let mut ends = [(0, &one[count..]), (1, &two[count..])];
        if ends[1].1.first() < ends[0].1.first() {
            ends.swap(0, 1);
        }
        let [(_, first), (_, second)] = ends;
        let whole = list.len() == count + first.len() + second.len();
        let apart = first.last() < second.first();
        (whole && (apart || second.is_empty())).then_some(Self { shared: &list[..count], ends })
    }
}

/// A = J M⁻¹ Jᵀ and J v of N rows.
pub(super) struct Sums<R: Real, const N: usize> {
    pub a: [R; N],
    pub velocity: [R; N],
}

impl<R: Real, const N: usize> Sums<R, N> {
    fn none() -> Self {
        Self { a: [R::zero(); N], velocity: [R::zero(); N] }
    }

    /// Adds a dof's part of the sums.
    #[inline(always)]
    fn add(&mut self, y: &[R; N], inv_d: R, u: R) {
        for i in 0..N {
            self.a[i] += y[i] * y[i] * inv_d;
            self.velocity[i] += y[i] * u;
        }
    }
}

/// Returns whether the list is of one or two free bodies, whose inertias are independent.
fn all_free<R: Real, const N: usize>(
    model: &Model<R::Value>,
    list: &[usize],
    sides: &[Option<Side<R, N>>; 2],
) -> bool {
    let bodies = || sides.iter().flatten();
    let apart = list.len() == bodies().count() * SIX && !model.couples;
    apart && bodies().all(|side| is_free(model, side.chain))
}

/// Returns whether one free body has these dofs.
pub(super) fn is_free<N: Constant>(model: &Model<N>, chain: &[usize]) -> bool {
    let [first, .., last] = chain else { return false };
    chain.len() == SIX && *last == first + SIX - 1 && model.dofs[*first].row.len == 1
}

impl<R: Real> Metric<R> {
    /// x ← L⁻ᵀ x for N vectors side by side, on an ancestor-closed, ascending list of dofs.
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

    /// Two free bodies whose centres of mass are off their origins.
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

    /// Several vectors over a list, or over a free body's six dofs, are lifted as if one by one.
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
        let mut six: [[f64; 3]; 6] = crate::real::array::from_fn(|k| given[6 + k]);
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
