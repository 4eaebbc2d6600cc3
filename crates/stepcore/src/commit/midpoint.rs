//! Implicit midpoint: v⁺ = v + dt·a(q_m, v_m), q⁺ = q ⊕ dt·v_m with v_m = (v + v⁺)/2 and
//! q_m = q ⊕ (dt/2)·v_m. Solved to rounding by a Newton-like iteration whose matrix
//! M + dt/2·D + dt²/4·K holds the joint springs, dampers and servos, so that a linear spring of any
//! stiffness converges at once.

use super::next::Iteration;
use super::{advance, Next};
use crate::elements::activation::{self, Activations};
use crate::elements::force::{Group, Moment};
use crate::elements::forces::slopes;
use crate::error::{Fault, Result};
use crate::integrator::Inside;
use crate::model::Model;
use crate::observer::Observer;
use crate::place::spread;
use crate::real::{Mask, Real};
use crate::sim::{At, Sim};
use crate::solve::Choice;

const MOST_ITERATIONS: usize = 200;
/// Iterations after which a correction that no longer shrinks is the rounding of the accelerations:
/// in a long chain they lose digits to the condition of its mass matrix.
const LONG: usize = 20;

/// Iterations after which hard equalities keep their initial impulses: near a position in which
/// they are redundant, these are quotients of small numbers and do not converge. The start of the
/// next step makes up for the rest.
const PATIENCE: usize = 16;

impl<R: Real> Sim<R> {
    /// Makes one step from `next.start` into `next`.
    pub(super) fn midpoint(
        &mut self,
        inside: Inside,
        observer: &mut dyn Observer<R>,
    ) -> Result<()> {
        let model = self.model.clone();
        let (dt, half) = (self.clock.dt, R::of(0.5));
        self.next.qvel.copy_from_slice(&self.next.start);
        let mut open = R::Mask::of(true);
        let mut last = R::of(f64::INFINITY);
        let (mut slope, coarse) = (f64::INFINITY, (1e4 * R::epsilon()).max(R::epsilon().sqrt()));
        let hard = inside == Inside::Equalities && self.settings.law.on_guess();
        let patience = if hard { PATIENCE } else { MOST_ITERATIONS };
        for iteration in 0..MOST_ITERATIONS {
            if iteration == patience {
                self.rows.begin_again(open);
                let Next { start, qvel, .. } = &mut self.next;
                for (v, start) in qvel.iter_mut().zip(start) {
                    *v = R::select(open, *start, *v);
                }
                last = R::of(f64::INFINITY);
            }
            let Next { start, qvel, trial, .. } = &mut self.next;
            for k in 0..model.nv {
                let middle = half * (start[k] + qvel[k]);
                // A finished lane keeps its state: its rows give the same result again.
                let new = R::select(open, middle, trial.qvel[k]);
                trial.qvel[k] = new.with_slopes_of(open.not(), || middle);
            }
            advance(&model, &self.state.qpos, &trial.qvel, half * dt, &mut trial.qpos);
            let act = self.state.activations(self.clock);
            activation::middle(&model, act, &self.inputs, &mut trial.act);
            self.next.held.fill(R::zero());
            let choice = match iteration {
                0 => Choice::First,
                _ if iteration < patience => Choice::Kept,
                _ => Choice::Frozen,
            };
            self.accelerate(At::Stage, inside, 1.0, choice)?;
            let (miss, moves) = self.correct_midpoint(&model, dt, open, inside == Inside::All);
            // Rounding: the correction is below it, or no longer shrinks.
            let small = miss.le(R::of(4.0 * R::epsilon()));
            let least = R::epsilon();
            let (fine, unmoved) =
                if iteration < LONG { (1e4 * least, 4.0 * least) } else { (coarse, 1e4 * least) };
            let stalled = miss.le(R::of(fine)).and(last.le(miss));
            // A servo's joint has the rounding of its forces, however slow it is: a correction that
            // moves nothing, and hardly shrinks, is minimal.
            let still = moves.le(R::of(unmoved)).and((half * last).le(miss));
            let unmeasured = miss.is_finite().not();
            last = R::select(open, miss, last);
            open = open.and(small.or(stalled).or(still).or(unmeasured).not());
            if open.none() {
                let before = std::mem::replace(&mut slope, self.last_slope());
                if slope <= 16.0 * R::epsilon() || (slope <= coarse && before <= slope) {
                    break;
                }
            }
        }
        if open.any() {
            return Err(self.diverged(open, |_| Fault::Midpoint));
        }
        observer.placed(self, At::Stage, 1.0);
        if inside != Inside::Nothing {
            observer.solved(self, At::Stage, 1.0);
        }
        for k in 0..model.nv {
            self.next.mean[k] = half * (self.next.start[k] + self.next.qvel[k]);
        }
        advance(&model, &self.state.qpos, &self.next.mean, dt, &mut self.next.qpos);
        let act = self.state.activations(self.clock);
        let rates = self.placed.act_rates();
        activation::through_middle(&model, act, &self.inputs, rates, &mut self.next.act);
        let Next { trial, centres, act, .. } = &mut self.next;
        activation::centres(&model, &trial.qpos, self.placed.pulls(), centres);
        activation::unwind(&model, centres, act);
        self.velocity.copy_from_slice(&self.next.qvel);
        Ok(())
    }

    /// Returns the last correction's change of derivatives, relative to the largest.
    fn last_slope(&self) -> f64 {
        let most = |list: &[R]| list.iter().map(|x| x.steepness()).fold(0.0, f64::max);
        let change = self.next.iteration.as_ref().map_or(0.0, |space| most(&space.correction));
        if change > 0.0 {
            change / most(&self.next.qvel)
        } else {
            0.0
        }
    }

    /// Returns the change of velocities by forces other than contacts: if contacts cancel it, the
    /// difference is rounding relative to this.
    fn smooth_gain(&self) -> R {
        let smooth =
            if self.rows.pushes.is_empty() { &self.placed.guess } else { &self.next.smooth };
        let free = smooth.iter().zip(&self.placed.u);
        free.fold(R::zero(), |most, (guess, u)| most.max((*guess - *u).abs()))
    }

    /// v⁺ += (M + dt/2·D + dt²/4·K)⁻¹ M (v + dt·a − v⁺); returns the size of the correction relative
    /// to the velocities of the step, and its displacement relative to the largest coordinate.
    fn correct_midpoint(
        &mut self,
        model: &Model<R::Value>,
        dt: R,
        open: R::Mask,
        rows: bool,
    ) -> (R, R) {
        let mut scale = if rows { self.smooth_gain() } else { R::zero() };
        let Next { iteration, trial, start, qvel, ahead, .. } = &mut self.next;
        let Some(Iteration { metric, places, slopes: own, change, correction }) = iteration else {
            return (R::zero(), R::zero());
        };
        for k in 0..model.nv {
            let gained = dt * self.qacc[k];
            change[k] = start[k] + gained - qvel[k];
            scale = scale.max(qvel[k].abs()).max(start[k].abs()).max(gained.abs());
        }
        self.placed.mul_mass(model, change, correction);
        spread(&self.placed.mass, places, &mut metric.l);
        let now = Moment {
            model,
            frames: self.placed.frames(),
            qpos: &trial.qpos,
            qvel: &trial.qvel,
            act: Activations {
                act: &trial.act,
                ahead: *ahead,
                middle: true,
                ..self.state.activations(self.clock)
            },
            inputs: &self.inputs,
        };
        let half = R::of(0.5 * self.clock.seconds);
        own.fill([R::zero(); 2]);
        let quarter = R::of(0.25);
        let implicit =
            |[stiffness, damping]: [R; 2]| half * damping + quarter * dt * dt * stiffness;
        slopes(&now, Group::Passive, &mut |_, i, j, slopes| {
            if i != j {
                return metric.add(i, j, implicit(slopes));
            }
            for (sum, slope) in own[i].iter_mut().zip(slopes) {
                // A sum of one term equals that term: nothing is added to it.
                *sum = match (sum.is_zero(), slope.is_zero()) {
                    (true, _) => slope,
                    (_, true) => *sum,
                    _ => *sum + slope,
                };
            }
        });
        for (k, [stiffness, damping]) in own.iter().enumerate() {
            metric.add(k, k, half * *damping + *stiffness * half * half);
        }
        slopes(&now, Group::Driven, &mut |_, i, j, slopes| metric.add(i, j, implicit(slopes)));
        metric.factor(0..model.nv);
        metric.solve(correction);
        let mut miss = R::zero();
        for k in 0..model.nv {
            let change = correction[k];
            let new = qvel[k] + change;
            let kept = R::select(open, new, qvel[k]);
            // Derivatives continue until they converge as well.
            qvel[k] = kept.with_slopes_of(open.not(), || new);
            miss = R::select(change.is_finite(), miss.max(change.abs()), change);
        }
        // Below this, rounding is no longer proportional.
        let least = R::of(if R::epsilon() > f64::EPSILON { 1e-30 } else { 1e-290 });
        let far = trial.qpos.iter().fold(R::zero(), |far, q| far.max(q.abs()));
        let moves = dt * miss / far.max(least);
        (R::select(scale.gt(R::zero()), miss / scale.max(least), miss), moves)
    }
}
