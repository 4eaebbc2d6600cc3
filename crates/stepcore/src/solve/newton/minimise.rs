//! The iteration, its line search, and the last digits.

use super::columns::Curved;
use super::hessian::Pattern;
use super::penalty::interval;
use super::system::{padded, System};
use crate::real::{Count, Mask, Real};
use crate::solve::cone::project_some;
use crate::solve::islands::row_count;
use crate::solve::limits::{Limits, Report};
use crate::solve::rows::{Rows, Set, CONE, NARROW};
use std::ops::Range;

/// A step this many roundings long is rounding.
const ROUNDING: f64 = 4.0;
/// Below this fraction of the motion's energy, in roundings, a fall may be rounding.
const STAGNANT: f64 = 1e-4;
/// The line search ends when the slope has fallen by this factor.
const FLAT: f64 = 1e-4;
/// The most refinements of the impulses at the end.
const REFINEMENTS: usize = 3;
/// Limit of the line search's evaluations.
const TRIALS: usize = 60;

impl<R: Real> System<R> {
    /// The iteration. A lane leaves it when its gradient or its step is rounding, its
    /// residual is within the tolerance, or its last step was exact. Lanes that it had to
    /// leave unfinished.
    pub fn minimise(
        &mut self,
        pattern: &Pattern,
        blocks: &[usize],
        rows: &Rows<R>,
        mut live: R::Mask,
        limits: Limits,
        report: &mut Report<R>,
    ) -> R::Mask {
        let zero = R::zero();
        let mut full = R::Mask::of(false);
        let (mut done, mut last) = (Count::ZERO, R::of(f64::INFINITY));
        self.decrement = zero;
        self.fresh = full;
        let tiny = |factor: f64| R::of(factor * factor * R::EPSILON * R::EPSILON);
        let count = row_count(rows, blocks);
        let bound = R::of(limits.tolerance * limits.tolerance) * lightest(blocks, rows);
        for _ in 0..limits.sweeps {
            let (changed, scale) = self.laws(pattern, blocks, rows, live);
            self.moved = false;
            self.fresh = self.fresh.and(changed.not());
            live = live.and(full.and(changed.not()).not());
            if live.none() {
                break;
            }
            let (size, moved) = self.slope(pattern, blocks, rows);
            // |g| in D⁻¹ bounds the residual's energy, and the step that is left.
            let floor = moved + scale;
            let part = |x: R| (x * floor.recip_or_zero()).max(zero).sqrt();
            self.decrement = R::select(live, part(size), self.decrement);
            live = live.and(size.le(bound.max(tiny(1.0) * moved)).not());
            if live.none() {
                break;
            }
            self.direction(pattern, blocks, rows);
            self.fresh = self.fresh.or(live);
            let (mut fall, mut length) = (zero, zero);
            for ((g, p), d) in self.gradient.iter().zip(&self.step).zip(&self.d) {
                fall -= *g * *p;
                length += *d * *p * *p;
            }
            // Among cones Newton may close in slowly: only what no longer falls is rounding.
            let stuck = fall.ge(last).and(fall.lt(R::of(STAGNANT) * R::of(R::EPSILON) * floor));
            let small = length.le(tiny(ROUNDING) * floor);
            let end = small.or(stuck);
            let alpha = self.search(pattern, blocks, rows, fall, live.and(small.not()));
            for (u, p) in self.u.iter_mut().zip(&self.step) {
                *u = R::select(live, *u + alpha * *p, *u);
            }
            self.moved = true;
            full = live.and(alpha.ge(R::one())).and(alpha.le(R::one()));
            done.add(live, 1);
            report.updates.add_each(live, &count);
            self.decrement = R::select(live, part(fall), self.decrement);
            self.floor = R::select(live, floor, self.floor);
            last = R::select(live, fall, last);
            live = live.and(end.not());
        }
        // An unfinished lane has nothing to refine.
        self.fresh = self.fresh.and(live.not());
        report.sweeps.raise(&done);
        live
    }

    /// g = D(u − û) − Σ yλ; |g|² in D⁻¹, and |u − û|² in D.
    fn slope(&mut self, pattern: &Pattern, blocks: &[usize], rows: &Rows<R>) -> (R, R) {
        let mut moved = R::zero();
        for (((g, u), guess), d) in
            self.gradient.iter_mut().zip(&self.u).zip(&self.guess).zip(&self.d)
        {
            let away = *u - *guess;
            *g = *d * away;
            moved += *g * away;
        }
        Self::gather(pattern, blocks, rows, &self.impulse, -R::one(), &mut self.gradient);
        let mut size = R::zero();
        for (g, inv) in self.gradient.iter().zip(&self.inv_d) {
            size += *g * *g * *inv;
        }
        (size, moved)
    }

    /// step = −H⁻¹ g.
    fn direction(&mut self, pattern: &Pattern, blocks: &[usize], rows: &Rows<R>) {
        if pattern.heap {
            let curved = Curved { blocks, rows, curve: &self.curve, starts: &self.starts };
            self.columns.factor(&pattern.nodes, &self.d, curved);
        } else {
            self.factor(pattern, blocks, rows);
        }
        for (p, g) in self.step.iter_mut().zip(&self.gradient) {
            *p = R::zero() - *g;
        }
        self.solve(pattern);
    }

    /// step ← H⁻¹ step.
    fn solve(&mut self, pattern: &Pattern) {
        if pattern.heap {
            self.columns.solve(&pattern.nodes, &mut self.step);
        } else {
            self.hessian.solve(pattern, &mut self.step);
        }
    }

    fn factor(&mut self, pattern: &Pattern, blocks: &[usize], rows: &Rows<R>) {
        self.hessian.reset(pattern, &self.d);
        let mut start = 0;
        for (b, block) in blocks.iter().map(|b| &rows.blocks[*b]).enumerate() {
            let len = pattern.list(b).len();
            let curves = start..start + block.curves();
            start = curves.end;
            let curves = &self.curve[curves];
            let own = &rows.rows[block.rows.range()];
            let y = |i: usize| &rows.y[own[i].y..own[i].y + len];
            for i in 0..own.len() {
                if block.set == Set::Interval {
                    let curve = curves[i];
                    if curve.gt(R::zero()).any() {
                        let y = y(i);
                        self.hessian.add(pattern, b, y, |j| curve * y[j], block.mask);
                    }
                    continue;
                }
                self.bent.clear();
                self.bent.resize(len, R::zero());
                let curve = &curves[i * own.len()..][..own.len()];
                for (j, curve) in curve.iter().enumerate() {
                    for (bent, y) in self.bent.iter_mut().zip(y(j)) {
                        *bent += *curve * *y;
                    }
                }
                let bent = &self.bent;
                self.hessian.add(pattern, b, y(i), |j| bent[j], block.mask);
            }
        }
        self.hessian.factor(pattern);
    }

    /// The α > 0 at which the cost along the step is least; 1 in lanes not searched.
    ///
    /// The slope is increasing (the cost is convex) and piecewise almost linear:
    /// Newton's method on it, kept within a bracket.
    fn search(
        &mut self,
        pattern: &Pattern,
        blocks: &[usize],
        rows: &Rows<R>,
        fall: R,
        mut live: R::Mask,
    ) -> R {
        let (zero, one) = (R::zero(), R::one());
        let mut alpha = one;
        if live.none() {
            return alpha;
        }
        let mut at = 0;
        for (b, block) in blocks.iter().map(|b| &rows.blocks[*b]).enumerate() {
            let len = pattern.list(b).len();
            for row in &rows.rows[block.rows.range()] {
                self.rate[at] = pattern.dot(b, &rows.y[row.y..row.y + len], &self.step);
                at += 1;
            }
        }
        let (mut first, mut second) = (zero, zero);
        for (((u, guess), d), p) in self.u.iter().zip(&self.guess).zip(&self.d).zip(&self.step) {
            first += *d * (*u - *guess) * *p;
            second += *d * *p * *p;
        }
        let (mut lo, mut hi) = (zero, R::of(f64::INFINITY));
        for _ in 0..TRIALS {
            let (slope, curve) = self.bend_at(blocks, rows, alpha);
            let (slope, curve) = (slope + first + alpha * second, curve + second);
            live = live.and(slope.abs().le(R::of(FLAT) * fall).not());
            if live.none() {
                break;
            }
            let up = slope.lt(zero);
            lo = R::select(live.and(up), alpha, lo);
            hi = R::select(live.and(up.not()), alpha, hi);
            let newton = alpha - slope / curve;
            let within = newton.gt(lo).and(newton.lt(hi));
            let split = R::select(hi.lt(R::of(f64::INFINITY)), R::of(0.5) * (lo + hi), lo + lo);
            let next = R::select(within, newton, split);
            alpha = R::select(live, next, alpha);
        }
        alpha
    }

    /// The rows' part of the slope and the curvature at u + α step.
    fn bend_at(&self, blocks: &[usize], rows: &Rows<R>, alpha: R) -> (R, R) {
        let (mut slope, mut curve) = (R::zero(), R::zero());
        let mut at = 0;
        for (b, block) in blocks.iter().map(|b| &rows.blocks[*b]).enumerate() {
            let own = &rows.rows[block.rows.range()];
            let range = at..at + own.len();
            at += own.len();
            if block.set == Set::Interval {
                for (row, at) in own.iter().zip(range) {
                    let v = self.rate[at];
                    let (impulse, bend) = interval(row, self.inv_c[at], self.w[at] + alpha * v);
                    slope = R::select(block.mask, slope - impulse * v, slope);
                    curve = R::select(block.mask, curve + bend * v * v, curve);
                }
                continue;
            }
            let now = (slope, curve);
            (slope, curve) = if own.len() <= NARROW {
                self.bend_cone_at::<NARROW>(b, range, alpha, now, block.mask)
            } else {
                self.bend_cone_at::<CONE>(b, range, alpha, now, block.mask)
            };
        }
        (slope, curve)
    }

    /// Adds a cone's part to slope and curvature.
    fn bend_cone_at<const N: usize>(
        &self,
        cone: usize,
        own: Range<usize>,
        alpha: R,
        (mut slope, mut curve): (R, R),
        mask: R::Mask,
    ) -> (R, R) {
        let (w, v): ([R; N], [R; N]) = (padded(&self.w[own.clone()]), padded(&self.rate[own]));
        let (impulse, bend) =
            self.cones[cone].law::<N>(core::array::from_fn(|i| w[i] + alpha * v[i]));
        for i in 0..N {
            slope = R::select(mask, slope - impulse[i] * v[i], slope);
            let mut bent = bend[i][0] * v[0];
            for j in 1..N {
                bent += bend[i][j] * v[j];
            }
            curve = R::select(mask, curve + bent * v[i], curve);
        }
        (slope, curve)
    }

    /// Writes the impulses and u = û + D⁻¹ Σ yλ.
    ///
    /// −w/c magnifies the rounding of w where c is small. So the pair (λ, u) is
    /// refined with the last factors, within their zones: the law's impulse at this u,
    /// less λ, is e; Hδ = Σ y e, Δλ = e − s″ y·δ. Once is enough unless c is tiny.
    pub fn finish(
        &mut self,
        pattern: &Pattern,
        blocks: &[usize],
        rows: &mut Rows<R>,
        mine: R::Mask,
    ) {
        if self.moved {
            self.laws(pattern, blocks, rows, R::Mask::of(false));
        }
        self.follow(pattern, blocks, rows);
        for _ in 0..REFINEMENTS {
            if self.fresh.none() {
                break;
            }
            self.rate.copy_from_slice(&self.impulse);
            self.laws(pattern, blocks, rows, R::Mask::of(false));
            self.stay_in_zones(blocks, rows);
            // `rate` holds λ, `impulse` the law's: make them e and λ.
            for (impulse, rate) in self.impulse.iter_mut().zip(&mut self.rate) {
                (*impulse, *rate) = (*rate, *impulse - *rate);
            }
            self.step.fill(R::zero());
            Self::gather(pattern, blocks, rows, &self.rate, R::one(), &mut self.step);
            // Σ y e is what is left of the gradient: with δ it tells the decrement.
            self.gradient.copy_from_slice(&self.step);
            self.solve(pattern);
            let fall =
                self.gradient.iter().zip(&self.step).fold(R::zero(), |sum, (g, p)| sum + *g * *p);
            let left = (fall * self.floor.recip_or_zero()).max(R::zero()).sqrt();
            self.decrement = R::select(self.fresh, left, self.decrement);
            self.refine(pattern, blocks, rows);
            self.follow(pattern, blocks, rows);
            self.fresh = self.fresh.and(left.gt(R::of(R::EPSILON)));
        }
        let mut at = 0;
        for block in blocks {
            let block = &rows.blocks[*block];
            for row in &mut rows.rows[block.rows.range()] {
                row.impulse = R::select(block.mask.and(mine), self.impulse[at], row.impulse);
                at += 1;
            }
        }
        for (k, u) in pattern.dofs().iter().zip(&self.u) {
            rows.u[*k] = R::select(mine, *u, rows.u[*k]);
        }
    }

    /// A row at a bound stays there: rounding/c must not flip it out of its zone.
    fn stay_in_zones(&mut self, blocks: &[usize], rows: &Rows<R>) {
        let (mut at, mut start) = (0, 0);
        for block in blocks.iter().map(|b| &rows.blocks[*b]) {
            if block.set == Set::Interval {
                for i in 0..block.rows.len {
                    let active = self.curve[start + i].gt(R::zero());
                    let free = -self.w[at + i] * self.inv_c[at + i];
                    self.impulse[at + i] = R::select(active, free, self.rate[at + i]);
                }
            }
            at += block.rows.len;
            start += block.curves();
        }
    }

    /// λ + e − s″ y·δ, within the sets.
    fn refine(&mut self, pattern: &Pattern, blocks: &[usize], rows: &Rows<R>) {
        let (mut at, mut start) = (0, 0);
        for (b, block) in blocks.iter().map(|b| &rows.blocks[*b]).enumerate() {
            let len = pattern.list(b).len();
            let curves = &self.curve[start..start + block.curves()];
            start += curves.len();
            let mask = block.mask.and(self.fresh);
            let first = at;
            let own = &rows.rows[block.rows.range()];
            let mut v = [R::zero(); CONE];
            for (i, row) in own.iter().enumerate() {
                let along = pattern.dot(b, &rows.y[row.y..row.y + len], &self.step);
                if block.set == Set::Interval {
                    let new = self.impulse[at] + (self.rate[at] - curves[i] * along);
                    self.impulse[at] = R::select(mask, new.clamp(row.lo, row.hi), self.impulse[at]);
                } else {
                    v[i] = along;
                }
                at += 1;
            }
            if block.set == Set::Interval {
                continue;
            }
            let mut new = padded(&self.impulse[first..at]);
            for (i, curve) in curves.chunks_exact(own.len()).enumerate() {
                let mut bent = curve[0] * v[0];
                for (curve, v) in curve.iter().zip(&v).skip(1) {
                    bent += *curve * *v;
                }
                new[i] += self.rate[first + i] - bent;
            }
            let new = project_some(block.mu, new, own.len());
            for (x, new) in self.impulse[first..at].iter_mut().zip(new) {
                *x = R::select(mask, new, *x);
            }
        }
    }

    /// u = û + D⁻¹ Σ yλ.
    fn follow(&mut self, pattern: &Pattern, blocks: &[usize], rows: &Rows<R>) {
        self.gradient.fill(R::zero());
        Self::gather(pattern, blocks, rows, &self.impulse, R::one(), &mut self.gradient);
        for (((u, guess), f), inv) in
            self.u.iter_mut().zip(&self.guess).zip(&self.gradient).zip(&self.inv_d)
        {
            *u = *guess + *f * *inv;
        }
    }
}

/// The least mass of a block.
fn lightest<R: Real>(blocks: &[usize], rows: &Rows<R>) -> R {
    let mut mass = R::of(f64::INFINITY);
    for block in blocks.iter().map(|b| &rows.blocks[*b]) {
        mass = R::select(block.mask, mass.min(R::of(block.mass)), mass);
    }
    mass
}
