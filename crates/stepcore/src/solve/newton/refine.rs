//! The last digits: impulses and velocities that are consistent.
//!
//! −w/c magnifies the rounding of w if c is small. So the pair (λ, u) is refined with the last
//! factors, within their zones: e is the law's impulse at this u minus λ; Hδ = Σ y e, Δλ = e − s″
//! y·δ. If e is within the tolerance there is nothing to refine, and one refinement suffices unless
//! c is tiny.
//!
//! Then u = û + D⁻¹ Σ yλ. But if rows that press on a body hardly move it, such as a wheel between
//! the floor and its axle, c is so small that opposed rows (the edges of a pyramid) carry loads far
//! larger than the forces that move it: their sum is only rounding. Newton's u does not come from
//! that sum. It is kept there, and moved by δ, which includes the error of the equation of motion:
//! Hδ = Σ y (λ + e) − D(u − û).

use super::bundles::{Bundles, Problem, Run};
use super::system::{padded, System};
use crate::real::{Mask, Real};
use crate::solve::cone::project_some;
use crate::solve::limits::Limits;
use crate::solve::rows::{CONE, NARROW};

/// The largest number of refinements.
const REFINEMENTS: usize = 3;
/// A correction of at most this part of the tolerance is skipped: Newton's steps end far within it,
/// and the default tolerance leaves digits to spare.
const SPARE: f64 = 1e-3;
/// Impulses cancel if their separate effects are this many times the motion. It exceeds a load on a
/// body under hundreds of others, and costs three digits.
const CANCELLED: f64 = 1024.0;

impl<R: Real> System<R> {
    /// Set impulses by their laws.
    pub fn follow_laws(&mut self, bundles: &Bundles<R>) {
        if self.moved {
            self.laws(bundles, R::Mask::of(false));
        }
    }

    /// The same refined, with u set to their effect. `open`: unfinished lanes, which keep Newton's
    /// u: as laws are stiff, the u of their impulses may be farther off than the start.
    pub fn polish(&mut self, problem: Problem<R>, open: R::Mask, limits: Limits) {
        self.follow_laws(problem.bundles);
        let kept = self.cancelled(problem).or(open);
        self.follow(problem, kept);
        let enough = R::of(SPARE * limits.tolerance);
        for _ in 0..REFINEMENTS {
            if self.fresh.none() {
                break;
            }
            self.find_slacks(problem);
            let (most, energy) = self.errors(problem);
            let done = self.fresh.and(most.le(enough * enough));
            let left = (energy * self.floor.recip_or_zero()).sqrt();
            self.decrement = R::select(done, left, self.decrement);
            self.fresh = self.fresh.and(done.not());
            if self.fresh.none() {
                break;
            }
            self.step.fill(R::zero());
            problem.gather(&self.rate, R::one(), &mut self.step, &mut self.local);
            self.add_unbalanced(problem, kept);
            // Σ y e is the remaining gradient: with δ it gives the decrement.
            self.gradient.copy_from_slice(&self.step);
            self.solve(problem.pattern);
            let fall =
                self.gradient.iter().zip(&self.step).fold(R::zero(), |sum, (g, p)| sum + *g * *p);
            let left = (fall * self.floor.recip_or_zero()).max(R::zero()).sqrt();
            self.decrement = R::select(self.fresh, left, self.decrement);
            self.refine(problem);
            self.move_kept(kept);
            self.follow(problem, kept);
            self.fresh = self.fresh.and(left.gt(R::of(R::epsilon())));
        }
    }

    /// Sets `rate` to e by row. Returns the largest e²A/m, the square of a speed like the residual's,
    /// and Σ e²A. A row at a bound stays there: rounding/c must not flip it out of its zone.
    fn errors(&mut self, problem: Problem<R>) -> (R, R) {
        let bundles = problem.bundles;
        for run in &bundles.runs {
            let own = run.rows.range();
            if let Some(cone) = run.cone {
                let w = &self.w[own.clone()];
                let law = if own.len() <= NARROW {
                    let impulse = bundles.cones[cone].law::<NARROW>(padded(w)).0;
                    padded::<R, CONE>(&impulse)
                } else {
                    bundles.cones[cone].law::<CONE>(padded(w)).0
                };
                for (at, law) in own.zip(law) {
                    self.rate[at] = law - self.impulse[at];
                }
                continue;
            }
            for (at, curve) in own.zip(run.curve.of(&self.curve)) {
                let free = -self.w[at] * bundles.inv_c[at];
                let active = curve.gt(R::zero());
                self.rate[at] = R::select(active, free - self.impulse[at], R::zero());
            }
        }
        let (mut most, mut energy) = (R::zero(), R::zero());
        for (e, (row, block)) in self.rate.iter().zip(problem.every()) {
            let speed = *e * *e * (row.a * (R::one() / block.mass));
            most = R::select(block.mask, most.max(speed), most);
            energy = R::select(block.mask, energy + *e * *e * row.a, energy);
        }
        (most, energy)
    }

    /// Set impulses to λ + e − s″ y·δ, within the sets.
    fn refine(&mut self, problem: Problem<R>) {
        problem.dots(&self.step, &mut self.w, &mut self.local);
        for run in &problem.bundles.runs {
            match run.cone {
                None => self.refine_intervals(problem, run),
                Some(cone) => self.refine_cone(problem, run, problem.bundles.cones[cone].mu),
            }
        }
    }

    fn refine_intervals(&mut self, problem: Problem<R>, run: &Run) {
        let bundles = problem.bundles;
        for (at, curve) in run.rows.range().zip(run.curve.of(&self.curve)) {
            let mask = bundles.mask[at].and(self.fresh);
            let new = self.impulse[at] + (self.rate[at] - *curve * self.w[at]);
            let new = new.clamp(bundles.lo[at], bundles.hi[at]);
            self.impulse[at] = R::select(mask, new, self.impulse[at]);
        }
    }

    fn refine_cone(&mut self, problem: Problem<R>, run: &Run, mu: R) {
        let own = run.rows.range();
        let mask = problem.bundles.mask[run.rows.start].and(self.fresh);
        let v = &self.w[own.clone()];
        let mut new: [R; CONE] = padded(&self.impulse[own.clone()]);
        for (i, curve) in run.curve.of(&self.curve).chunks_exact(own.len()).enumerate() {
            let mut taken = curve[0] * v[0];
            for (curve, v) in curve.iter().zip(v).skip(1) {
                taken += *curve * *v;
            }
            new[i] += self.rate[run.rows.start + i] - taken;
        }
        let new = project_some(mu, new, own.len());
        for (x, new) in self.impulse[own].iter_mut().zip(new) {
            *x = R::select(mask, new, *x);
        }
    }

    /// Returns lanes whose impulses cancel: Σ λ²A against the energy of the motion along the rows.
    fn cancelled(&self, problem: Problem<R>) -> R::Mask {
        let mut apart = R::zero();
        for (impulse, (row, block)) in self.impulse.iter().zip(problem.every()) {
            let energy = apart + *impulse * *impulse * row.a;
            apart = R::select(block.mask, energy, apart);
        }
        let mut motion = self.scale;
        for ((u, guess), d) in self.u.iter().zip(&self.guess).zip(&self.d) {
            motion += *d * (*u - *guess) * (*u - *guess);
        }
        apart.gt(R::of(CANCELLED * CANCELLED) * motion)
    }

    /// step += Σ yλ − D(u − û), in lanes whose u does not make it 0.
    fn add_unbalanced(&mut self, problem: Problem<R>, kept: R::Mask) {
        if kept.none() {
            return;
        }
        self.gradient.fill(R::zero());
        problem.gather(&self.impulse, R::one(), &mut self.gradient, &mut self.local);
        for (at, step) in self.step.iter_mut().enumerate() {
            let missing = self.gradient[at] - self.d[at] * (self.u[at] - self.guess[at]);
            *step = R::select(kept, *step + missing, *step);
        }
    }

    /// Adds δ to u in lanes that keep u.
    fn move_kept(&mut self, kept: R::Mask) {
        let mask = kept.and(self.fresh);
        for (u, step) in self.u.iter_mut().zip(&self.step) {
            *u = R::select(mask, *u + *step, *u);
        }
    }

    /// u = û + D⁻¹ Σ yλ, except in lanes that keep u.
    fn follow(&mut self, problem: Problem<R>, kept: R::Mask) {
        self.gradient.fill(R::zero());
        problem.gather(&self.impulse, R::one(), &mut self.gradient, &mut self.local);
        for (((u, guess), f), inv) in
            self.u.iter_mut().zip(&self.guess).zip(&self.gradient).zip(&self.inv_d)
        {
            *u = R::select(kept, *u, *guess + *f * *inv);
        }
    }
}
