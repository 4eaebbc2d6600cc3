//! Data for the exact solution of cones, computed once per solve: up to N rows, W of them ways.

use super::super::cone::{times, InBall, InCone, Matrix};
use super::super::rows::{Set, CONE, NARROW};
use super::super::square::Square;
use crate::real::array::from_fn;
use crate::real::Real;

/// The coupling of a block's impulses, and for a cone its place among cones of its kind.
#[derive(Clone, Copy)]
pub(super) enum Tie {
    /// Only bounds.
    Bounds,
    Convex(u32),
    Disc(u32),
    Square(u32),
}

/// Indexed by the place in a `Tie`.
pub(super) struct Cones<R: Real, const N: usize, const W: usize> {
    pub convex: Vec<InCone<R, N>>,
    disc: Vec<InBall<R, W>>,
    square: Vec<Square<R, W>>,
}

/// For a normal and two tangents, and for all possible ways.
pub(super) type Narrow<R> = Cones<R, NARROW, { NARROW - 1 }>;
pub(super) type Wide<R> = Cones<R, CONE, { CONE - 1 }>;

room!(Cones<R, N, W>: convex, disc, square);

impl<R: Real, const N: usize, const W: usize> Cones<R, N, W> {
    pub fn new() -> Self {
        Self { convex: Vec::new(), disc: Vec::new(), square: Vec::new() }
    }

    pub fn clear(&mut self) {
        self.convex.clear();
        self.disc.clear();
        self.square.clear();
    }

    /// Prepares a block with this y D⁻¹ yᵀ + C.
    pub fn tie(&mut self, set: Set, mu: R, q: Matrix<R, N>) -> Tie {
        let ways = from_fn(|i| from_fn(|j| q[i + 1][j + 1]));
        match set {
            Set::Interval => Tie::Bounds,
            Set::Convex => Tie::Convex(push(&mut self.convex, InCone::new(q, mu))),
            Set::CoulombRound => Tie::Disc(push(&mut self.disc, InBall::new(ways))),
            Set::CoulombBox => Tie::Square(push(&mut self.square, Square::new(ways))),
        }
    }

    /// Returns the ways' impulses of a Coulomb cone that minimise its part within their bound, with
    /// their slope at x.
    #[inline(always)]
    pub fn friction(
        &mut self,
        tie: Tie,
        slope: [R; W],
        x: &[R; W],
        bound: R,
        mask: R::Mask,
    ) -> [R; W] {
        let at_zero = |q: &Matrix<R, W>| {
            let held = times(q, x);
            from_fn(|i| slope[i] - held[i])
        };
        match tie {
            Tie::Disc(at) => {
                let ball = &mut self.disc[at as usize];
                ball.least(&at_zero(&ball.q), bound, mask)
            }
            Tie::Square(at) => {
                let square = &self.square[at as usize];
                square.least(&at_zero(&square.q), bound, x, mask)
            }
            Tie::Bounds | Tie::Convex(_) => [R::zero(); W],
        }
    }

    /// Returns Q between the ways of a round Coulomb cone, times x.
    pub fn curved(&self, tie: Tie, x: &[R; W]) -> [R; W] {
        match tie {
            Tie::Disc(at) => times(&self.disc[at as usize].q, x),
            _ => [R::zero(); W],
        }
    }
}

fn push<T>(list: &mut Vec<T>, item: T) -> u32 {
    list.push(item);
    (list.len() - 1) as u32
}
