//! What cones of three rows or less need for their exact solutions, made once a solve.

use super::super::exact::{Convex, TangentBox, Tangents};
use super::super::rows::Set;
use crate::real::Real;
use crate::room::room;

/// What ties the impulses of a block, and for a cone its place among those of its kind.
#[derive(Clone, Copy)]
pub(super) enum Tie {
    /// Nothing but bounds.
    Bounds,
    Convex(u32),
    Disc(u32),
    Square(u32),
}

/// By the place in a `Tie`.
pub(super) struct Cones<R: Real> {
    pub convex: Vec<Convex<R>>,
    disc: Vec<Tangents<R>>,
    square: Vec<TangentBox<R>>,
}

room!(Cones<R>: convex, disc, square;);

impl<R: Real> Cones<R> {
    pub fn new() -> Self {
        Self { convex: Vec::new(), disc: Vec::new(), square: Vec::new() }
    }

    pub fn clear(&mut self) {
        self.convex.clear();
        self.disc.clear();
        self.square.clear();
    }

    /// Of a block with this y D⁻¹ yᵀ + C; rows of the lower triangle.
    pub fn tie(&mut self, set: Set, mu: R, q: [R; 6]) -> Tie {
        let tangents = [q[2], q[4], q[5]];
        match set {
            Set::Interval => Tie::Bounds,
            Set::Convex => Tie::Convex(push(&mut self.convex, Convex::new(q, mu))),
            Set::CoulombRound => Tie::Disc(push(&mut self.disc, Tangents::new(q[2], q[4], q[5]))),
            Set::CoulombBox => Tie::Square(push(&mut self.square, TangentBox::new(tangents))),
        }
    }

    /// q₁₁, q₁₂, q₂₂ of the tangents of a Coulomb cone.
    #[inline(always)]
    pub fn plane(&self, tie: Tie) -> [R; 3] {
        match tie {
            Tie::Disc(at) => self.disc[at as usize].q,
            Tie::Square(at) => self.square[at as usize].q,
            Tie::Bounds | Tie::Convex(_) => [R::zero(); 3],
        }
    }

    /// The tangents' impulses that minimise ½ xᵀQx + g·x within their bound.
    #[inline(always)]
    pub fn friction(&self, tie: Tie, g: [R; 2], bound: R, mask: R::Mask) -> [R; 2] {
        match tie {
            Tie::Disc(at) => self.disc[at as usize].disc(g, bound, mask),
            Tie::Square(at) => self.square[at as usize].minimiser(g, bound),
            Tie::Bounds | Tie::Convex(_) => [R::zero(); 2],
        }
    }
}

fn push<T>(list: &mut Vec<T>, item: T) -> u32 {
    list.push(item);
    (list.len() - 1) as u32
}
