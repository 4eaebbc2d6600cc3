//! Steps of several sizes over one stretch of time, extrapolated to steps of no size.
//!
//! Of a method of first order the change over a stretch h in n steps is T + e₁ h/n + e₂ (h/n)² + …, so that of
//! two such changes the first term of the error can be taken out, of three the second too, and so on: Aitken
//! and Neville's scheme (Hairer, Wanner, Solving Ordinary Differential Equations II, IV.9, there of
//! the linearly implicit Euler method). The last two results tell the error.

use super::position::advance;
use crate::model::{Body, Model};
use crate::place::Placed;
use crate::real::{value, Real, Value};
use crate::scene::JointType;
use crate::spatial::{rotate, splat, Motion, Quat};
use crate::state::State;

/// Into how many steps a stretch is cut, one way after the other.
pub(crate) const CUTS: [u32; 4] = [1, 2, 3, 4];

/// Working space of stretches.
pub(crate) struct Extrapolation<R: Real> {
    /// Where the period and the stretch begin.
    pub period: State<R>,
    pub from: State<R>,
    /// The changes of tangent coordinates (dq, dv, dw), those of `watch/linearize.rs`: at place 0 the best,
    /// at 1 the one without the first cut.
    table: [Vec<R>; CUTS.len()],
    /// The highest difference of the changes of velocity that the steps make, one after the other.
    jump: Vec<R>,
    /// By body, what a change does to it, and its radius of gyration [m].
    moved: Vec<Motion<R>>,
    levers: Vec<f64>,
}

room!(Extrapolation<R>: period, from, table, jump, moved, levers);

/// The largest change of a body [m], and which body's.
pub(crate) type Largest = (f64, usize);

impl<R: Real> Extrapolation<R> {
    pub fn new(model: &Model<R::Value>) -> Self {
        let change = || vec![R::zero(); 2 * model.nv + model.na];
        Self {
            period: State::new(model),
            from: State::new(model),
            table: std::array::from_fn(|_| change()),
            jump: vec![R::zero(); model.nv],
            moved: vec![Motion::zero(); model.bodies.len()],
            levers: model.bodies.iter().map(gyration::<R>).collect(),
        }
    }

    /// Takes the end of the stretch in `CUTS[nth]` steps.
    pub fn take(&mut self, model: &Model<R::Value>, end: &State<R>, nth: usize) {
        difference(model, &self.from, end, &mut self.table[nth]);
        for place in (0..nth).rev() {
            let ratio = f64::from(CUTS[nth]) / f64::from(CUTS[place]);
            let share = R::of(1.0 / (ratio - 1.0));
            let (coarser, finer) = self.table.split_at_mut(place + 1);
            for (coarse, fine) in coarser[place].iter_mut().zip(&finer[0]) {
                *coarse = *fine + (*fine - *coarse) * share;
            }
        }
    }

    /// The end of the stretch, as good as it is known.
    pub fn store(&self, model: &Model<R::Value>, to: &mut State<R>) {
        let (dq, rest) = self.table[0].split_at(model.nv);
        let (dv, dw) = rest.split_at(model.nv);
        advance(model, &self.from.qpos, dq, R::one(), &mut to.qpos);
        let sum = |to: &mut [R], from: &[R], change: &[R]| {
            to.iter_mut().zip(from.iter().zip(change)).for_each(|(to, (x, d))| *to = *x + *d);
        };
        sum(&mut to.qvel, &self.from.qvel, dv);
        sum(&mut to.act, &self.from.act, dw);
    }

    /// By how much the last two results differ; an error of velocity counts for so long [s].
    pub fn error(&mut self, now: &Now<R>, lasts: f64) -> Largest {
        let nv = now.model.nv;
        let [best, before, ..] = &self.table;
        let (moved, levers) = (&mut self.moved, &self.levers);
        let change = |at: usize| (at..at + nv).map(|k| best[k] - before[k]);
        let position = largest(now, moved, levers, change(0));
        let velocity = largest(now, moved, levers, change(nv));
        worse(position, (velocity.0 * lasts, velocity.1))
    }

    /// Counts the change of velocity that a step makes, the nth of so many and one after the stretch. Of
    /// equal steps of a smooth motion the highest difference is of as high a power of their length; whatever
    /// begins or ends at once within them, or after the last has looked, stands in it undiminished.
    pub fn count(&mut self, nth: u32, of: u32, before: &[R], after: &[R]) {
        let weight =
            R::of(binomial(of, nth) * if (of - nth).is_multiple_of(2) { 1.0 } else { -1.0 });
        if nth == 0 {
            self.jump.fill(R::zero());
        }
        for (jump, (x, y)) in self.jump.iter_mut().zip(before.iter().zip(after)) {
            *jump += weight * (*y - *x);
        }
    }

    /// What that is to a body [m/s].
    pub fn jump(&mut self, now: &Now<R>) -> Largest {
        largest(now, &mut self.moved, &self.levers, self.jump.iter().copied())
    }
}

/// The larger of two.
pub(super) fn worse(one: Largest, two: Largest) -> Largest {
    // What is not a number is the worst of all.
    if one.0 >= two.0 || one.0.is_nan() {
        one
    } else {
        two
    }
}

fn binomial(n: u32, k: u32) -> f64 {
    (1..=k).fold(1.0, |product, i| product * f64::from(n + 1 - i) / f64::from(i))
}

/// Where bodies are, for what a change does to them.
pub(crate) struct Now<'a, R: Real> {
    pub model: &'a Model<R::Value>,
    pub placed: &'a Placed<R>,
}

/// The tangent coordinates of `to`, seen from `from`.
fn difference<R: Real>(model: &Model<R::Value>, from: &State<R>, to: &State<R>, out: &mut [R]) {
    let minus = |out: &mut [R], to: &[R], from: &[R]| {
        out.iter_mut().zip(to.iter().zip(from)).for_each(|(out, (x, y))| *out = *x - *y);
    };
    let (dq, rest) = out.split_at_mut(model.nv);
    let (dv, dw) = rest.split_at_mut(model.nv);
    minus(dv, &to.qvel, &from.qvel);
    minus(dw, &to.act, &from.act);
    let turn = |q: usize, dq: &mut [R]| {
        let (old, new) = (Quat::of(&from.qpos[q..q + 4]), Quat::of(&to.qpos[q..q + 4]));
        dq.copy_from_slice(old.conjugate().mul(&new).log().as_slice());
    };
    for joint in &model.joints {
        let (q, v) = (joint.qpos, joint.dof);
        match joint.kind {
            JointType::Slide | JointType::Hinge => dq[v] = to.qpos[q] - from.qpos[q],
            JointType::Ball => turn(q, &mut dq[v..v + 3]),
            JointType::Free => {
                minus(&mut dq[v..v + 3], &to.qpos[q..q + 3], &from.qpos[q..q + 3]);
                turn(q + 3, &mut dq[v + 3..v + 6]);
            }
        }
    }
}

/// About the mean of its axes.
fn gyration<R: Real>(body: &Body<R::Value>) -> f64 {
    let inertia = value::matrix::<R, _>(&body.inertia);
    let (trace, mass) = (inertia.trace().lane(0), body.mass.get().lane(0));
    if mass > 0.0 {
        (trace / 2.0 / mass).sqrt()
    } else {
        0.0
    }
}

/// What a change of tangent coordinates is to the body that it moves most: that of its centre of mass, and
/// its turn at the radius of gyration.
fn largest<R: Real>(
    now: &Now<R>,
    moved: &mut [Motion<R>],
    levers: &[f64],
    change: impl Iterator<Item = R>,
) -> Largest {
    let Now { model, placed } = now;
    moved.fill(Motion::zero());
    for (dof, x) in change.enumerate() {
        moved[model.dofs[dof].body].add_scaled(&placed.motion[dof], x);
    }
    let mut worst = (0.0, 0);
    for tree in &model.trees {
        for index in tree.bodies.range() {
            let body = &model.bodies[index];
            if body.parent >= tree.bodies.start {
                let parent = moved[body.parent];
                moved[index].add_scaled(&parent, R::one());
            }
            let Motion { ang, lin } = &moved[index];
            let centre = placed.xpos[index] + rotate(&placed.xmat[index], &splat(&body.ipos));
            let way = lin + ang.cross(&(centre - placed.origin[body.tree]));
            let turn = ang.dot(ang) * R::of(levers[index] * levers[index]);
            let square = way.dot(&way) + turn;
            worst = worse(worst, (square.lane(0).sqrt(), index));
        }
    }
    worst
}
