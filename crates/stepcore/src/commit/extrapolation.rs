//! Steps of several sizes over one stretch of time, extrapolated to zero step size.
//!
//! With a first-order method the change over a stretch h in n steps is T + e₁ h/n + e₂ (h/n)² + ….
//! Two such changes eliminate the first term of the error, three the second too, and so on: Aitken
//! and Neville's scheme (Hairer, Wanner, Solving Ordinary Differential Equations II, IV.9, there
//! with the linearly implicit Euler method). The last two results estimate the error.

use super::position::advance;
use crate::clock::Clock;
use crate::elements::activation::Activations;
use crate::elements::actuator::{bound, tensions};
use crate::elements::force::Moment;
use crate::model::{Body, Model};
use crate::place::{Effective, Metric, Placed};
use crate::real::{value, Real, Value};
use crate::scene::JointType;
use crate::spatial::{rotate, splat, Motion, Quat};
use crate::state::{Inputs, State};

/// The numbers of steps into which a stretch is cut, in order.
pub(crate) const CUTS: [u32; 4] = [1, 2, 3, 4];

/// Working space of stretches.
pub(crate) struct Extrapolation<R: Real> {
    /// The starts of the period and of the stretch.
    pub period: State<R>,
    pub from: State<R>,
    /// The changes of tangent coordinates (dq, dv, dw), as in `watch/linearize.rs`: at index 0 the
    /// best, at 1 the one without the first cut.
    table: [Vec<R>; CUTS.len()],
    /// The highest difference of the successive steps' changes of velocity.
    jump: Vec<R>,
    /// Per body: its displacement by a change, and its radius of gyration [m].
    moved: Vec<Motion<R>>,
    levers: Vec<f64>,
    settling: Settling<R>,
}

room!(Extrapolation<R>: period, from, table, jump, moved, levers, settling);

/// The time over which the displacement from a velocity error counts [s]. Of 22 scenes and robots at
/// three tolerances, 98 % or more of those with a converged motion meet the tolerance with 0.01 to 0.1
/// s; with 0.03 s all do.
const LASTS: f64 = 0.03;

/// The displacement from a velocity error in the time T [s], as an implicit step of this length
/// computes it: T (M + T D)⁻¹ M δv. Damped motion soon stops; free motion continues. Springs, and the
/// stiffness of servos, do not count: they reverse an error, but it continues as an oscillation, and
/// the errors of all steps add up. An error of activations pulls for as long: T f in addition to M δv.
struct Settling<R: Real> {
    time: R,
    effective: Effective<R>,
    metric: Metric<R>,
    change: Vec<R>,
    way: Vec<R>,
    /// Activations, and the forces of actuators, without the error and with it.
    act: Vec<R>,
    tensions: [Vec<R>; 2],
}

room!(Settling<R>: time, effective, metric, change, way, act, tensions);

impl<R: Real> Settling<R> {
    fn new(placed: &Placed<R>, model: &Model<R::Value>, time: f64) -> Self {
        let (time, mut metric) = (R::of(time), Metric::coupled(model));
        let mut effective = Effective::damped(model, &metric, time);
        effective.start(&placed.mass, &mut metric);
        let zeros = |n| vec![R::zero(); n];
        Self {
            time,
            effective,
            metric,
            change: zeros(model.nv),
            way: zeros(model.nv),
            act: zeros(model.na),
            tensions: core::array::from_fn(|_| zeros(model.actuators.len())),
        }
    }

    /// Returns the displacement from a change of velocities, and of activations.
    fn way(
        &mut self,
        now: &Now<R>,
        velocities: impl Iterator<Item = R>,
        activations: impl Iterator<Item = R>,
    ) -> impl Iterator<Item = R> + '_ {
        self.change.iter_mut().zip(velocities).for_each(|(to, x)| *to = x);
        now.placed.mul_mass(now.model, &self.change, &mut self.way);
        if now.model.na > 0 {
            self.pull(now, activations);
        }
        self.metric.solve(&mut self.way);
        self.way.iter().map(|x| *x * self.time)
    }

    /// Adds the impulse from a change of activations.
    fn pull(&mut self, now: &Now<R>, activations: impl Iterator<Item = R>) {
        let Now { model, placed, inputs, state, clock } = now;
        let (pulls, own) = (placed.pulls(), state.activations(*clock));
        for (to, (act, change)) in self.act.iter_mut().zip(own.act.iter().zip(activations)) {
            *to = *act + change;
        }
        let changed = Activations { act: &self.act, ..own };
        for (act, out) in [own, changed].into_iter().zip(&mut self.tensions) {
            tensions(model, &state.qpos, &state.qvel, act, inputs, pulls, out);
            bound(model, out);
        }
        let [before, after] = &self.tensions;
        for (index, along) in model.along.iter().enumerate() {
            let force = (after[index] - before[index]) * self.time;
            along.arms(model, &state.qpos, pulls, |dof, arm| self.way[dof] += force * arm);
        }
    }
}

/// The largest displacement of a body [m], and the index of the body.
pub(crate) type Largest = (f64, usize);

impl<R: Real> Extrapolation<R> {
    pub fn new(placed: &Placed<R>, model: &Model<R::Value>) -> Self {
        let change = || vec![R::zero(); 2 * model.nv + model.na];
        Self {
            period: State::new(model),
            from: State::new(model),
            table: core::array::from_fn(|_| change()),
            jump: vec![R::zero(); model.nv],
            moved: vec![Motion::zero(); model.bodies.len()],
            levers: model.bodies.iter().map(gyration::<R>).collect(),
            settling: Settling::new(placed, model, LASTS),
        }
    }

    /// Updates the damping of velocities.
    pub fn settle(&mut self, now: &Moment<R>, placed: &Placed<R>) {
        let Settling { effective, metric, .. } = &mut self.settling;
        effective.factor(now, &placed.mass, metric);
    }

    /// Stores the end of the stretch in `CUTS[nth]` steps.
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

    /// Writes the best estimate of the end of the stretch.
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

    /// Returns the difference of the last two results [m].
    pub fn error(&mut self, now: &Now<R>) -> Largest {
        let nv = now.model.nv;
        let Self { table: [best, before, ..], moved, levers, settling, .. } = self;
        let change = |at: usize| (at..at + nv).map(|k| best[k] - before[k]);
        let position = largest(now, moved, levers, change(0));
        let activations = (2 * nv..best.len()).map(|k| best[k] - before[k]);
        let velocity = largest(now, moved, levers, settling.way(now, change(nv), activations));
        worse(position, velocity)
    }

    /// Adds the change of velocity of a step, the nth of `of` and one after the stretch. With equal
    /// steps of a smooth motion the highest difference falls with as high a power of their length;
    /// a sudden start or end within them, or after the last evaluation, remains in it undiminished.
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

    /// Returns the displacement from `jump` [m].
    pub fn jump(&mut self, now: &Now<R>) -> Largest {
        let Self { jump, moved, levers, settling, .. } = self;
        let none = settling.act.len();
        let none = std::iter::repeat_n(R::zero(), none);
        largest(now, moved, levers, settling.way(now, jump.iter().copied(), none))
    }
}

/// Returns the larger of two.
pub(super) fn worse(one: Largest, two: Largest) -> Largest {
    // A number that is not finite is the worst of all.
    if one.0 >= two.0 || one.0.is_nan() {
        one
    } else {
        two
    }
}

fn binomial(n: u32, k: u32) -> f64 {
    (1..=k).fold(1.0, |product, i| product * f64::from(n + 1 - i) / f64::from(i))
}

/// The placement and forces of bodies, for the effect of a change.
pub(crate) struct Now<'a, R: Real> {
    pub model: &'a Model<R::Value>,
    pub placed: &'a Placed<R>,
    pub inputs: &'a Inputs<R>,
    pub state: &'a State<R>,
    pub clock: Clock<R>,
}

/// Returns the tangent coordinates of `to` relative to `from`.
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

/// Returns the radius of gyration about the mean of the axes.
fn gyration<R: Real>(body: &Body<R::Value>) -> f64 {
    let inertia = value::matrix::<R, _>(&body.inertia);
    let (trace, mass) = (inertia.trace().lane(0), body.mass.get().lane(0));
    if mass > 0.0 {
        (trace / 2.0 / mass).sqrt()
    } else {
        0.0
    }
}

/// Returns the largest effect of a change of tangent coordinates on a body: the displacement of its
/// centre of mass, and its turn at the radius of gyration.
fn largest<R: Real>(
    now: &Now<R>,
    moved: &mut [Motion<R>],
    levers: &[f64],
    change: impl Iterator<Item = R>,
) -> Largest {
    let Now { model, placed, .. } = now;
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
