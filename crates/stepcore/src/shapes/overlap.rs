//! The shortest way to separate two shapes that overlap.

use super::epa::Polytope;
use super::gjk::Vertex;
use super::hint::{Kept, Shell};
use super::separation::{Cause, Pairing, Separation};
use crate::spatial::V3;
use core::cell::RefCell;

/// Rounds of the search, and capacity for points of the polytope; larger for shapes with corners alone,
/// because meshes of many faces may lie deep in others.
const ROUNDS: usize = 90;
const POINTS: usize = 72;
const MANY: usize = 2000;
const MANY_POINTS: usize = 600;
/// The largest number of corners of a shell that is kept: it grows from step to step, while a new
/// search ends with 10 to 20.
const SHELL: usize = 24;
/// Over the size of the pair: accuracy of a search at its first answer.
const FIRST: f64 = 0.05;
/// Over the height of a face: accuracy that shows that no better answer is behind it. Of 9,600 random
/// pairs of bent shapes 8 have one with 1e-3, less deep by 3e-4 of their depth at most; with 1e-4 none
/// has.
const NEXT: f64 = 1e-5;

/// Over the size of the pair: a way out that is longer by less may be the shortest, within rounding.
const CLEAR: f64 = 1e-9;
/// Cosine of the angle between directions of one facet.
const SAME: f64 = 1.0 - 1e-9;

/// The result of a search.
#[derive(Default)]
struct Found {
    best: Option<Separation>,
    /// Nothing better is left.
    proven: bool,
    /// Another direction is as good.
    tied: bool,
}

thread_local! {
    static POLYTOPE: RefCell<Polytope> = RefCell::default();
}

impl Pairing<'_> {
    /// Finds the shortest way out, from a simplex that may hold the origin; for polytopes `shell`
    /// receives the polytope that proves it.
    pub(super) fn overlap(&self, simplex: &[Vertex], shell: Kept) -> Separation {
        POLYTOPE.with_borrow_mut(|polytope| {
            let most = if self.smooth { POINTS } else { MANY_POINTS };
            if !polytope.start(&|way| self.vertex(way), simplex, most) {
                let length = self.between.dot(&self.between).sqrt();
                let n = if length > 0.0 { self.between * (1.0 / length) } else { V3::x() };
                return self.refine(&n);
            }
            let Found { best, proven, .. } = self.expand(polytope, -1e-12);
            if let (Some(shell), true, false) = (shell, proven && !polytope.torn, self.smooth) {
                polytope.keep(shell.get_or_insert_default(), SHELL);
            }
            match best {
                // Nothing is much better, and nothing nearby is better.
                Some(best) if self.smooth && self.holds(&best) => best,
                Some(best) => self.topped(self.settled(best)),
                None => self.topped(self.refine(&-polytope.best)),
            }
        })
    }

    /// Finds the shortest way out of polytopes from the shell of the step before; if the shell proves
    /// none it is cleared.
    pub(super) fn overlap_again(&self, shell: &mut Shell) -> Option<Separation> {
        if shell.is_empty() {
            return None;
        }
        let at = |[one, two]: [u32; 2]| {
            self.between + (self.two.corner(two as usize) - self.one.corner(one as usize))
        };
        POLYTOPE.with_borrow_mut(|polytope| {
            let inside = polytope.start_from(shell, &at, POINTS);
            let Found { best, proven, tied } =
                if inside { self.expand(polytope, CLEAR) } else { Found::default() };
            // A direction that neither faces nor edges fix, or a tied one, is left to the search.
            let fixed = |best: &Separation| best.apart < 0.0 && !matches!(best.cause, Cause::Free);
            let found = best.filter(|best| fixed(best) && proven && !tied && !polytope.torn);
            if found.is_none() {
                shell.clear();
            } else if polytope.grown {
                polytope.keep(shell, SHELL);
            }
            found
        })
    }

    /// Returns the best result of refining while the polytope grows, until no remaining face is better,
    /// or worse by less than `clear` of the size.
    fn expand(&self, polytope: &mut Polytope, clear: f64) -> Found {
        let support = |way: &V3<f64>| self.vertex(way);
        let next = |height: f64| NEXT * (height.max(0.0) + 1e-3 * self.size);
        let mut out = Found::default();
        for _ in 0..if self.smooth { ROUNDS } else { MANY } {
            let depth = out.best.map_or(f64::INFINITY, |best| -best.apart);
            let least = match out.best {
                Some(_) if self.smooth => depth - next(depth),
                _ => depth + clear * self.size,
            };
            let Some((face, height)) = polytope.lowest(least) else {
                out.proven = !polytope.full;
                break;
            };
            // While the way out is short relative to the bent surfaces, faces near an answer settle at
            // once.
            if let (true, Some(best)) = (self.smooth && depth < FIRST * self.size, out.best) {
                if polytope.grow_beside(face, &-best.normal, &support) {
                    continue;
                }
            }
            // With a first answer the rest of the search only has to rule out better ones.
            let close = match (self.smooth, out.best) {
                (true, None) => FIRST * self.size,
                (true, _) => next(height),
                _ => 1e-12 * self.size,
            };
            let way = polytope.push(face, out.best.map_or(0.0, |_| close), &support);
            let ended = way.reach - height <= close || polytope.stuck;
            let other = |best: Separation| -way.normal.dot(&best.normal) < SAME;
            out.tied |= ended
                && (way.reach - depth).abs() <= clear * self.size
                && out.best.is_some_and(other);
            // Without room for more points a lower face of a bent set may hide a better answer.
            if ended && (way.reach < depth || self.smooth && polytope.full) {
                let found = self.refine_once(&-way.normal, self.near());
                if found.apart > -depth {
                    out.best = Some(found);
                }
            }
        }
        out
    }
}
