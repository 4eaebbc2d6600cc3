//! The iteration and its line search.

use super::bundles::{Bundles, Problem, Run};
use super::columns::Curved;
use super::pattern::Pattern;
use super::penalty::{interval, Line};
use super::system::System;
use crate::interrupt::checkpoint;
use crate::real::{Count, Mask, Real};
use crate::solve::limits::{Limits, Report};

/// Scales for the stopping criteria of an iteration.
pub(super) struct Scale<R: Real> {
    /// The least mass of a block.
    pub lightest: R,
    /// A step that lowers the cost by less is the last; 0: no such limit.
    pub least_gain: R,
    pub rows: Count,
}

/// A step of at most this many roundings is rounding.
const ROUNDING: f64 = 4.0;
/// A decrease below this fraction of the motion's energy, in roundings, may be rounding.
const STAGNANT: f64 = 1e-4;
/// The line search ends when the slope has fallen by this factor (a fifth fewer evaluations than at
/// 1e-4, and as many steps, on five robots in contact).
const FLAT: f64 = 1e-2;
/// Iterations between two checkpoints.
const ITERATIONS: u32 = 8;
/// Limit of the line search's evaluations.
const TRIALS: usize = 60;

impl<R: Real> System<R> {
    /// Iterates. A lane stops when its gradient or its step is rounding, its residual is within the
    /// tolerance, its last step was exact, or its gain is below the requested one. Returns the
    /// unfinished lanes. `begun`: laws and slope, if they are computed already.
    pub fn minimise(
        &mut self,
        problem: Problem<R>,
        (mut todo, mut begun): (R::Mask, Option<(R, R)>),
        limits: Limits,
        Scale { lightest, least_gain, rows }: Scale<R>,
        report: &mut Report<R>,
    ) -> R::Mask {
        let zero = R::zero();
        let mut full = R::Mask::of(false);
        let (mut done, mut last) = (Count::ZERO, R::of(f64::INFINITY));
        self.decrement = zero;
        self.fresh = full;
        let tiny = |factor: f64| R::of(factor * factor * R::epsilon() * R::epsilon());
        let bound = R::of(limits.tolerance * limits.tolerance) * lightest;
        for iteration in 0..limits.sweeps {
            self.moved = false;
            let slope = if let Some(begun) = begun.take() {
                begun
            } else {
                let changed = self.laws(problem.bundles, todo);
                self.fresh = self.fresh.and(changed.not());
                let exact = full.and(changed.not());
                self.decrement = R::select(todo.and(exact), zero, self.decrement);
                todo = todo.and(exact.not());
                if todo.none() {
                    break;
                }
                self.slope(problem)
            };
            let (size, moved) = slope;
            // A lane that is not finite, such as an exploding run, cannot recover.
            todo = todo.and(size.lt(R::of(f64::INFINITY)));
            // |g| in D⁻¹ bounds the residual's energy, and the remaining step.
            let floor = moved + self.scale;
            let part = |x: R| (x * floor.recip_or_zero()).max(zero).sqrt();
            self.decrement = R::select(todo, part(size), self.decrement);
            todo = todo.and(size.le(bound.max(tiny(1.0) * moved)).not());
            if todo.none() {
                break;
            }
            let first = iteration == 0;
            let guessed =
                if first { self.take_last_zones(problem, todo) } else { R::Mask::of(false) };
            self.direction(problem);
            self.fresh = self.fresh.or(todo);
            let (mut fall, mut length) = (zero, zero);
            for ((g, p), d) in self.gradient.iter().zip(&self.step).zip(&self.d) {
                fall -= *g * *p;
                length += *d * *p * *p;
            }
            // Among cones Newton may converge slowly: only a step that no longer falls is rounding.
            let stuck = fall.ge(last).and(fall.lt(R::of(STAGNANT) * R::of(R::epsilon()) * floor));
            let small = length.le(tiny(ROUNDING) * floor).and(guessed.not());
            problem.dots(&self.step, &mut self.rate, &mut self.local);
            self.line_up(problem.bundles);
            let mut down = todo;
            if guessed.any() {
                // The current gradient is the one of the guessed zones.
                let slope = self.energy_along().0 + self.bend_at(problem.bundles, zero).0;
                fall = R::select(guessed, -slope, fall);
                down = todo.and(guessed.and(fall.le(zero)).not());
            }
            let alpha = self.search(problem.bundles, fall, down.and(small.not()));
            let alpha = R::select(down, alpha, zero);
            self.advance(alpha, todo);
            self.moved = true;
            // The slope falls from `fall` to about 0.
            let gain = R::of(0.5) * alpha * fall;
            let little = gain.lt(least_gain).and(least_gain.gt(zero)).and(guessed.not());
            let end = small.or(stuck).or(little);
            full = todo.and(alpha.ge(R::one())).and(alpha.le(R::one()));
            done.add(todo, 1);
            report.updates.add_each(todo, &rows);
            self.decrement = R::select(todo, part(fall), self.decrement);
            self.floor = R::select(todo, floor, self.floor);
            last = R::select(todo.and(guessed.not()), fall, last);
            todo = todo.and(end.not());
            if iteration % ITERATIONS == ITERATIONS - 1 {
                checkpoint();
            }
        }
        // An unfinished lane has nothing to refine.
        self.fresh = self.fresh.and(todo.not());
        report.sweeps.raise(&done);
        todo
    }

    /// g = D(u − û) − Σ yλ; returns |g|² in D⁻¹, and |u − û|² in D.
    pub(super) fn slope(&mut self, problem: Problem<R>) -> (R, R) {
        let mut moved = R::zero();
        for (((g, u), guess), d) in
            self.gradient.iter_mut().zip(&self.u).zip(&self.guess).zip(&self.d)
        {
            let away = *u - *guess;
            *g = *d * away;
            moved += *g * away;
        }
        problem.gather(&self.impulse, -R::one(), &mut self.gradient, &mut self.local);
        let mut size = R::zero();
        for (g, inv) in self.gradient.iter().zip(&self.inv_d) {
            size += *g * *g * *inv;
        }
        (size, moved)
    }

    /// step = −H⁻¹ g.
    fn direction(&mut self, problem: Problem<R>) {
        let Problem { pattern, bundles, rows, .. } = problem;
        if R::ALONE && pattern.heap {
            let curved = Curved { bundles, y: &rows.y, curve: &self.curve };
            self.columns.factor(&pattern.nodes, &self.d, curved);
        } else {
            self.hessian.make(problem, &self.d, (&self.curve, &mut self.changed));
        }
        for (p, g) in self.step.iter_mut().zip(&self.gradient) {
            *p = R::zero() - *g;
        }
        self.solve(pattern);
    }

    /// step ← H⁻¹ step.
    pub(super) fn solve(&mut self, pattern: &Pattern) {
        if R::ALONE && pattern.heap {
            self.columns.solve(&pattern.nodes, &mut self.step);
        } else {
            self.hessian.solve(pattern, &mut self.step);
        }
    }

    /// Returns the α > 0 at which the cost along the step is least; 1 in lanes not searched.
    ///
    /// The slope is increasing (the cost is convex) and piecewise almost linear:
    /// Newton's method on it, kept within a bracket.
    fn search(&mut self, bundles: &Bundles<R>, fall: R, mut todo: R::Mask) -> R {
        let (zero, one) = (R::zero(), R::one());
        let mut alpha = one;
        if todo.none() {
            return alpha;
        }
        let (first, second) = self.energy_along();
        let (mut lo, mut hi) = (zero, R::of(f64::INFINITY));
        for _ in 0..TRIALS {
            let (slope, curve) = self.bend_at(bundles, alpha);
            let (slope, curve) = (slope + first + alpha * second, curve + second);
            todo = todo.and(slope.abs().le(R::of(FLAT) * fall).not());
            if todo.none() {
                break;
            }
            let up = slope.lt(zero);
            lo = R::select(todo.and(up), alpha, lo);
            hi = R::select(todo.and(up.not()), alpha, hi);
            let newton = alpha - slope / curve;
            let within = newton.gt(lo).and(newton.lt(hi));
            let split = R::select(hi.lt(R::of(f64::INFINITY)), R::of(0.5) * (lo + hi), lo + lo);
            let next = R::select(within, newton, split);
            alpha = R::select(todo, next, alpha);
        }
        alpha
    }

    /// Returns slope and curvature of ½ (u − û)ᵀD(u − û) along the step.
    pub(super) fn energy_along(&self) -> (R, R) {
        let (mut first, mut second) = (R::zero(), R::zero());
        for (((u, guess), d), p) in self.u.iter().zip(&self.guess).zip(&self.d).zip(&self.step) {
            first += *d * (*u - *guess) * *p;
            second += *d * *p * *p;
        }
        (first, second)
    }

    /// Move by α steps.
    pub(super) fn advance(&mut self, alpha: R, todo: R::Mask) {
        for (u, p) in self.u.iter_mut().zip(&self.step) {
            *u = R::select(todo, *u + alpha * *p, *u);
        }
        for (w, rate) in self.w.iter_mut().zip(&self.rate) {
            *w = R::select(todo, *w + alpha * *rate, *w);
        }
    }

    /// Prepares the cones along the current step.
    pub(super) fn line_up(&mut self, bundles: &Bundles<R>) {
        self.lines.clear();
        for run in &bundles.runs {
            if let Some(cone) = run.cone {
                let own = run.rows.range();
                let line = Line::new(&bundles.cones[cone], &self.w[own.clone()], &self.rate[own]);
                self.lines.push(line);
            }
        }
    }

    /// Returns the rows' part of the slope and the curvature at u + α step.
    pub(super) fn bend_at(&self, bundles: &Bundles<R>, alpha: R) -> (R, R) {
        let (mut slope, mut curve) = (R::zero(), R::zero());
        for run in &bundles.runs {
            let Some(cone) = run.cone else {
                (slope, curve) = self.bend_intervals_at(bundles, run, alpha, (slope, curve));
                continue;
            };
            let (mask, (tilt, bend)) = (bundles.mask[run.rows.start], self.lines[cone].at(alpha));
            slope = R::select(mask, slope + tilt, slope);
            curve = R::select(mask, curve + bend, curve);
        }
        (slope, curve)
    }

    /// Adds the part of some intervals to slope and curvature.
    #[inline(always)]
    fn bend_intervals_at(
        &self,
        bundles: &Bundles<R>,
        run: &Run,
        alpha: R,
        (mut slope, mut curve): (R, R),
    ) -> (R, R) {
        let own = run.rows.range();
        let (lo, hi) = (&bundles.lo[own.clone()], &bundles.hi[own.clone()]);
        let (inv_c, mask) = (&bundles.inv_c[own.clone()], &bundles.mask[own.clone()]);
        let (w, rate) = (&self.w[own.clone()], &self.rate[own]);
        for i in 0..run.rows.len {
            let (v, mask) = (rate[i], if run.whole { R::Mask::of(true) } else { mask[i] });
            let (impulse, bend) = interval([lo[i], hi[i]], inv_c[i], w[i] + alpha * v);
            slope = R::select(mask, slope - impulse * v, slope);
            curve = R::select(mask, curve + bend * v * v, curve);
        }
        (slope, curve)
    }
}
