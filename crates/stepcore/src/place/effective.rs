//! The metric of `discrete`: M̂ = M + dt·D + dt²·K, in which the step solves its rows.
//!
//! Forces of springs, dampers and servos are taken at the end of the step, to first order:
//! f − D (v⁺ − v) − dt K v⁺, and so M̂ (v⁺ − v) = dt (f − dt K v) + Jᵀλ. (MuJoCo documentation,
//! "Numerical integration": its `discrete`.) K and D hold back, `Forces::holding`, so that M̂ is
//! positive definite.

use std::ops::Range;

use super::{spread, Metric, Placed};
use crate::elements::activation::Activations;
use crate::elements::force::{Frames, Moment};
use crate::elements::forces::holding;
use crate::elements::Kind;
use crate::model::transmission::Pulls;
use crate::model::Model;
use crate::real::{Mask, Real, Stage};
use crate::state::Inputs;

/// M̂ and its working data.
pub struct Effective<R: Real> {
    dt: R,
    /// Whether stiffness counts.
    held: bool,
    /// M̂, in the layout of the metric.
    matrix: Vec<R>,
    /// The place of each entry of M in `matrix`.
    places: Vec<usize>,
    /// dt K v, by dof [N or N·m].
    pub(super) shift: Vec<R>,
    /// Dofs whose M̂ a step changes, and which are factored together.
    parts: Vec<Range<usize>>,
    /// By tree: the lanes in which M̂ has slopes of a tendon or an actuator.
    pub(crate) tied: Vec<R::Mask>,
}

room!(Effective<R>: dt, held, matrix, places, shift, parts, tied);

impl<R: Real> Effective<R> {
    pub(crate) fn new(model: &Model<R::Value>, metric: &Metric<R>, dt: R) -> Self {
        let places = metric.places(model);
        let sloped = model.sloped();
        let trees = model.trees.iter().zip(sloped);
        let parts = match model.couples {
            true => std::iter::once(0..model.nv).collect(),
            false => trees
                .filter(|(tree, sloped)| *sloped || !tree.constant)
                .map(|(tree, _)| tree.dofs.range())
                .collect(),
        };
        let zero = R::zero();
        let (matrix, shift) = (vec![zero; metric.l.len()], vec![zero; model.nv]);
        let tied = vec![R::Mask::of(false); model.trees.len()];
        Self { dt, held: true, matrix, places, shift, parts, tied }
    }

    /// Returns M + T D alone, without stiffness, over a time T.
    pub(crate) fn damped(model: &Model<R::Value>, metric: &Metric<R>, time: R) -> Self {
        Self { held: false, ..Self::new(model, metric, time) }
    }

    pub(super) fn set_dt(&mut self, dt: R) {
        self.dt = dt;
    }

    /// Starts with M alone, of all dofs: entries that no step changes stay.
    pub(crate) fn start(&mut self, mass: &[R], metric: &mut Metric<R>) {
        spread(mass, &self.places, &mut self.matrix);
        metric.l.copy_from_slice(&self.matrix);
        metric.factor(0..self.shift.len());
    }

    /// Computes M̂ at a state, and its factors; M is `mass`.
    pub(crate) fn factor(&mut self, now: &Moment<R>, mass: &[R], metric: &mut Metric<R>) {
        self.assemble(now, mass, metric);
        for part in &self.parts {
            metric.refill(part.clone(), &self.matrix);
            metric.factor(part.clone());
        }
    }

    fn assemble(&mut self, now: &Moment<R>, mass: &[R], metric: &Metric<R>) {
        let Self { dt, held, matrix, places, shift, tied, .. } = self;
        let dt = *dt;
        let held = if *held { dt } else { R::zero() };
        spread(mass, places, matrix);
        shift.fill(R::zero());
        tied.fill(R::Mask::of(false));
        holding(now, &mut |element, i, j, [stiffness, damping]| {
            let slope = damping + held * stiffness;
            if let Some((at, x)) = metric.share(i, j, dt * slope) {
                matrix[at] += x;
                shift[i] += dt * stiffness * now.qvel[j];
            }
            if matches!(element.kind, Kind::Actuator | Kind::TendonSpring | Kind::TendonDamper) {
                let tied = &mut tied[now.model.dofs[i].tree];
                *tied = tied.or(slope.abs().gt(R::zero()));
            }
        });
    }

    /// Returns the entry of M̂ of two dofs.
    pub(crate) fn entry(&self, metric: &Metric<R>, i: usize, j: usize) -> R {
        metric.place(i, j).map_or(R::zero(), |at| self.matrix[at])
    }
}

impl<R: Real> Placed<R> {
    /// Computes M̂ and its factors, if rows are solved in it; M must have been computed.
    pub(super) fn weigh_effective(
        &mut self,
        model: &Model<R::Value>,
        qpos: &[R],
        qvel: &[R],
        act: Activations<R>,
        inputs: &Inputs<R>,
    ) {
        let Some(effective) = &mut self.effective else { return };
        let Self { xpos, xmat, origin, motion, actuator, shares, mass, metric, .. } = self;
        R::enter(Stage::Factor);
        let pulls = Pulls { length: &self.tendon_length, arms: &self.tendon_arms };
        let frames = Frames { xpos, xmat, origin, motion, tension: actuator, shares, pulls };
        let now = Moment { model, frames, qpos, qvel, act, inputs };
        effective.factor(&now, mass, metric);
    }
}
