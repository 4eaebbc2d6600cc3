//! The update of a contact between free bodies, for one or several side by side, number by number.

use super::super::free_bodies::SIX;
use super::super::rows::NARROW;
use crate::real::array::from_fn;
use crate::real::Real;
use core::ops::{Add, Mul, Neg, Sub};

/// Rows of a pyramid.
pub(super) const EDGES: usize = 4;
/// Contacts updated at once: the numbers per vector of most machines.
pub(super) const SIDE: usize = 4;

/// A number, or several side by side.
pub(super) trait Numbers:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Neg<Output = Self>
{
    fn every(x: f64) -> Self;
    fn larger(self, other: Self) -> Self;
    fn size(self) -> Self;
}

impl<R: Real> Numbers for R {
    #[inline(always)]
    fn every(x: f64) -> Self {
        R::of(x)
    }
    #[inline(always)]
    fn larger(self, other: Self) -> Self {
        self.max(other)
    }
    #[inline(always)]
    fn size(self) -> Self {
        self.abs()
    }
}

/// A number of each contact.
#[derive(Clone, Copy)]
pub(super) struct Each<R>(pub [R; SIDE]);

impl<R: Real> Each<R> {
    #[inline(always)]
    fn with(self, other: Self, of: impl Fn(R, R) -> R) -> Self {
        let ([a, b, c, d], [p, q, r, s]) = (self.0, other.0);
        Self([of(a, p), of(b, q), of(c, r), of(d, s)])
    }
}

macro_rules! each {
    ($($operation:ident $name:ident $sign:tt),*) => {
        $(impl<R: Real> $operation for Each<R> {
            type Output = Self;
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                self.with(other, |a, b| a $sign b)
            }
        })*
    };
}
each!(Add add +, Sub sub -, Mul mul *);

impl<R: Real> Neg for Each<R> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.with(self, |a, _| -a)
    }
}

impl<R: Real> Numbers for Each<R> {
    #[inline(always)]
    fn every(x: f64) -> Self {
        Self([R::of(x); SIDE])
    }
    #[inline(always)]
    fn larger(self, other: Self) -> Self {
        self.with(other, R::max)
    }
    #[inline(always)]
    fn size(self) -> Self {
        self.with(self, |a, _| a.abs())
    }
}

/// The contact data that an update reads; lists of four are edges, or three directions and a blank.
#[derive(Clone, Copy)]
pub(super) struct Point<N> {
    /// y by body and direction.
    pub y: [[[N; SIX]; NARROW]; 2],
    /// y D⁻¹ yᵀ of edges, or of directions with c on the diagonal; rows of the lower triangle, for
    /// edges without the diagonal.
    pub between: [N; 6],
    pub t: [N; EDGES],
    pub c: [N; EDGES],
    pub inv_s: [N; EDGES],
    pub impulse: [N; EDGES],
    /// √(A/m).
    pub weight: [N; EDGES],
}

/// The result of a sweep.
pub(in super::super) struct Swept<R> {
    /// The largest change of an impulse [m/s].
    pub change: R,
    /// The change of the objective of convex rows (see `momentum.rs`); side by side, since the
    /// sweep before.
    pub gain: R,
}

/// Returns the gain of convex rows by the change of an impulse: ½ s Δ² − Δ (t − Jv − cλ).
#[inline(always)]
pub(super) fn gain<N: Numbers>(s: N, change: N, short: N) -> N {
    change * (N::every(0.5) * s * change - short)
}

/// The same for a cone, from its slope and its curvature times the change; added to `sum`.
#[inline(always)]
pub(super) fn gain_in_cone<R: Real>(sum: R, change: &[R], slope: &[R], curved: &[R]) -> R {
    let each = change.iter().zip(slope.iter().zip(curved));
    each.fold(sum, |sum, (x, (slope, curved))| sum + *x * (*slope + R::of(0.5) * *curved))
}

impl<N: Numbers> Point<N> {
    pub fn empty() -> Self {
        let zero = N::every(0.0);
        let none = [zero; EDGES];
        Self {
            y: [[[zero; SIX]; NARROW]; 2],
            between: [zero; 6],
            t: none,
            c: none,
            inv_s: none,
            impulse: none,
            weight: none,
        }
    }

    /// Returns y·u by direction, even and odd dofs separately; without a second body, for the first.
    #[inline(always)]
    pub fn velocity(&self, one: &[N; SIX], two: Option<&[N; SIX]>) -> [N; NARROW] {
        // Loops: as a closure over arrays this takes a fifth longer.
        let mut sums = [N::every(0.0); NARROW];
        for way in 0..NARROW {
            let [y, z] = [&self.y[0][way], &self.y[1][way]];
            let mut p = [N::every(0.0); SIX];
            for k in 0..SIX {
                p[k] = y[k] * one[k];
                if let Some(two) = two {
                    p[k] = p[k] + z[k] * two[k];
                }
            }
            sums[way] = ((p[0] + p[2]) + p[4]) + ((p[1] + p[3]) + p[5]);
        }
        sums
    }

    /// Returns Σ y f over the directions, for a body's dof.
    #[inline(always)]
    pub fn push(&self, body: usize, k: usize, f: &[N; NARROW]) -> N {
        let [n, a, b] = &self.y[body];
        (n[k] * f[0] + a[k] * f[1]) + b[k] * f[2]
    }

    /// Returns t − Jv − cλ.
    #[inline(always)]
    pub fn short(&self, i: usize, velocity: N) -> N {
        self.t[i] - velocity - self.c[i] * self.impulse[i]
    }

    /// Returns the change of an impulse to max(λ + (t − Jv − cλ)/s, 0).
    #[inline(always)]
    pub fn change(&self, i: usize, short: N) -> N {
        (short * self.inv_s[i]).larger(-self.impulse[i])
    }

    /// Returns the changes of the edges, in sequence, given the velocities along the directions;
    /// `keep` zeroes unwanted changes, and `note` receives each edge's change and shortfall.
    #[inline(always)]
    pub fn edges(
        &self,
        [n, a, b]: [N; NARROW],
        keep: impl Fn(N) -> N,
        mut note: impl FnMut(usize, N, N),
    ) -> [N; EDGES] {
        let velocity = [n + a, n - a, n + b, n - b];
        let mut short: [N; EDGES] = from_fn(|i| self.short(i, velocity[i]));
        let mut change = [N::every(0.0); EDGES];
        for i in 0..EDGES {
            change[i] = keep(self.change(i, short[i]));
            note(i, change[i], short[i]);
            for j in i + 1..EDGES {
                short[j] = short[j] - self.between[j * (j - 1) / 2 + i] * change[i];
            }
        }
        change
    }

    /// Adds the changes to the impulses; returns the largest of them and of `largest` [m/s].
    #[inline(always)]
    pub fn add(&mut self, change: &[N; EDGES], mut largest: N) -> N {
        for i in 0..EDGES {
            self.impulse[i] = self.impulse[i] + change[i];
            largest = largest.larger(change[i].size() * self.weight[i]);
        }
        largest
    }
}

/// Converts impulses of edges to the directions.
#[inline(always)]
pub(super) fn along<N: Numbers>(edges: &[N; EDGES]) -> [N; NARROW] {
    [(edges[0] + edges[1]) + (edges[2] + edges[3]), edges[0] - edges[1], edges[2] - edges[3]]
}

impl<R: Real> Point<Each<R>> {
    /// Stores one of the contacts.
    pub fn set(&mut self, lane: usize, one: &Point<R>) {
        let lists: [(&mut [Each<R>], &[R]); 7] = [
            (&mut self.between, &one.between),
            (&mut self.t, &one.t),
            (&mut self.c, &one.c),
            (&mut self.inv_s, &one.inv_s),
            (&mut self.impulse, &one.impulse),
            (&mut self.weight, &one.weight),
            (self.y.as_flattened_mut().as_flattened_mut(), one.y.as_flattened().as_flattened()),
        ];
        for (each, given) in lists {
            each.iter_mut().zip(given).for_each(|(each, given)| each.0[lane] = *given);
        }
    }
}
