//! Momentum of contacts side by side: a sweep starts further along the last sweep's move, and along
//! the move before.
//!
//! The objective and a sweep's gain are as in `momentum.rs`: f(λ) = ½ λᵀHλ + λ·(J v̂ − t) with
//! H = A + C. A sweep from y ends at x; p = x − y is its move, and e is the move from the previous
//! y to this one. The next sweep starts at x + σp + τe, with the σ and τ at which f is least. That
//! may be outside the sets, but the sweep updates every impulse, and so ends within them: nothing
//! is projected, and u follows λ. The slope of f at x along p is Δf + ½ pᵀHp, with Δf the gain of
//! the sweep. Along e it was 0 at y, the minimum along both moves that form e, so it is eᵀHp at x.
//!
//! If a sweep ends higher than the one before, the sets turned the step into a detour. Then the
//! step is skipped as many times as that has happened, so that in the end sweeps proceed alone.

use super::super::free_bodies::SIX;
use crate::real::{Mask, Real};

/// A body's part of u, on a separate cache line.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub(super) struct Six<R>(pub [R; SIX]);

impl<R: Real> Six<R> {
    pub fn zero() -> Self {
        Self([R::zero(); SIX])
    }
}

/// Moves count as one if the determinant of their 2 × 2 products is below this part of the diagonal's.
const APART: f64 = 1e-8;

/// The next position and move: x + σp + τe, and the whole move from y, (1 + σ)p + τe, or none.
#[derive(Clone, Copy)]
pub(super) struct Step<R> {
    along: [R; 2],
    keep: [R; 2],
}

/// The result of a sweep: its gain of f, and pᵀCp and pᵀCe of its moves.
#[derive(Clone, Copy)]
pub(super) struct Found<R> {
    pub gain: R,
    pub own: R,
    pub both: R,
}

impl<R: Real> Found<R> {
    pub fn nothing() -> Self {
        Self { gain: R::zero(), own: R::zero(), both: R::zero() }
    }
}

/// The method's memory for the current island.
pub(super) struct SweepMomentum<R> {
    /// Per body: D, u at the start of the sweep, and the move e.
    d: Vec<Six<R>>,
    from: Vec<Six<R>>,
    last: Vec<Six<R>>,
    /// eᵀHe, and the decrease of f in the step before the sweep.
    energy: R,
    fall: R,
    /// Sweeps that ended too high, and the number of sweeps without a step.
    failures: u32,
    rest: u32,
}

room!(SweepMomentum<R>: d, from, last, energy, fall, failures, rest);

impl<R: Real> Step<R> {
    pub fn none() -> Self {
        Self { along: [R::zero(); 2], keep: [R::zero(); 2] }
    }

    /// From x, the previous y and e, compute the next y, which replaces x and y, and the next e.
    #[inline(always)]
    pub fn go<const N: usize>(&self, x: &mut [R; N], y: &mut [R; N], e: &mut [R; N]) {
        for k in 0..N {
            let p = x[k] - y[k];
            x[k] += self.along[0] * p + self.along[1] * e[k];
            e[k] = self.keep[0] * p + self.keep[1] * e[k];
            y[k] = x[k];
        }
    }
}

impl<R: Real> SweepMomentum<R> {
    pub fn new() -> Self {
        Self {
            d: Vec::new(),
            from: Vec::new(),
            last: Vec::new(),
            energy: R::zero(),
            fall: R::zero(),
            failures: 0,
            rest: 0,
        }
    }

    /// Start on an island with these bodies, each with its D.
    pub fn begin(&mut self, bodies: &[Six<R>], d: impl Iterator<Item = Six<R>>) -> Step<R> {
        self.d.clear();
        self.d.extend(d);
        self.from.clear();
        self.from.extend_from_slice(bodies);
        self.last.clear();
        self.last.resize(bodies.len(), Six::zero());
        (self.energy, self.fall) = (R::zero(), R::zero());
        (self.failures, self.rest) = (0, 0);
        Step::none()
    }

    /// Returns the change of f in the step before the sweep.
    pub fn fall(&self) -> R {
        self.fall
    }

    /// After a sweep: moves the bodies on, and returns the step for their contacts.
    pub fn step(&mut self, bodies: &mut [Six<R>], found: Found<R>) -> Step<R> {
        let step = self.best(bodies, found);
        let places = bodies.iter_mut().zip(&mut self.from).zip(&mut self.last);
        for ((x, y), e) in places {
            step.go(&mut x.0, &mut y.0, &mut e.0);
        }
        step
    }

    /// Returns the step to the minimum of f.
    fn best(&mut self, bodies: &[Six<R>], found: Found<R>) -> Step<R> {
        let (zero, one, half) = (R::zero(), R::one(), R::of(0.5));
        let (own, both) = self.products(bodies, found);
        let too_high = (self.fall + found.gain).gt(zero).any();
        let (last, slopes) = (self.energy, [found.gain + half * own, both]);
        (self.energy, self.fall) = (zero, zero);
        if too_high {
            self.failures += 1;
            self.rest = self.failures;
        }
        if self.rest > 0 {
            self.rest -= 1;
            return Step::none();
        }
        let product = own * last;
        let determinant = product - both * both;
        let apart = determinant.gt(R::of(APART) * product);
        let two = [both * slopes[1] - last * slopes[0], both * slopes[0] - own * slopes[1]]
            .map(|x| x / determinant);
        let sigma = R::select(apart, two[0], -slopes[0] * own.recip_or_zero());
        let tau = R::select(apart, two[1], zero);
        if sigma.is_finite().and(tau.is_finite()).not().any() {
            return Step::none();
        }
        let whole = one + sigma;
        self.energy = whole * whole * own + R::of(2.0) * whole * tau * both + tau * tau * last;
        self.fall = half * (sigma * slopes[0] + tau * slopes[1]);
        Step { along: [sigma, tau], keep: [whole, tau] }
    }

    /// Returns pᵀHp and pᵀHe: H of impulses is D of their effect on u, plus C.
    fn products(&self, bodies: &[Six<R>], found: Found<R>) -> (R, R) {
        let (mut own, mut both) = ([R::zero(); SIX], [R::zero(); SIX]);
        let places = bodies.iter().zip(&self.from).zip(&self.last).zip(&self.d);
        for (((x, y), e), d) in places {
            for k in 0..SIX {
                let p = x.0[k] - y.0[k];
                own[k] += d.0[k] * p * p;
                both[k] += d.0[k] * p * e.0[k];
            }
        }
        let sum = |start: R, parts: [R; SIX]| parts.into_iter().fold(start, |sum, x| sum + x);
        (sum(found.own, own), sum(found.both, both))
    }
}
