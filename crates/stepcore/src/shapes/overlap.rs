//! The shortest way out of each other of two shapes that overlap.

use super::epa::Polytope;
use super::gjk::Vertex;
use super::hint::{Kept, Shell};
use super::separation::{Cause, Pairing, Separation};
use crate::spatial::V3;
use core::cell::RefCell;

/// Rounds of the search, and room for points of the polytope; of shapes with corners alone more, because
/// meshes of many faces may lie deep in others.
const ROUNDS: usize = 90;
const POINTS: usize = 72;
const MANY: usize = 2000;
const MANY_POINTS: usize = 600;
/// The most corners of a shell that is kept: from step to step it gathers more, while a search from anew
/// ends with 10 to 20.
const SHELL: usize = 24;
/// Over the size of the pair: how near a search must have come for a first answer.
const FIRST: f64 = 0.05;
/// Over the height of a face: how near one must have come that has no better answer behind it. Of 9,600
/// pairs of bent shapes at random 8 have one with 1e-3, less deep by 3e-4 of their depth at most; with
/// 1e-4 none has.
const NEXT: f64 = 1e-5;

thread_local! {
    static POLYTOPE: RefCell<Polytope> = RefCell::default();
}

impl Pairing<'_> {
    /// The shortest way out, from a simplex that may hold the origin; of polytopes `shell` gets the one
    /// that proves it.
    pub(super) fn overlap(&self, simplex: &[Vertex], shell: Kept) -> Separation {
        POLYTOPE.with_borrow_mut(|polytope| {
            let most = if self.smooth { POINTS } else { MANY_POINTS };
            if !polytope.start(&|way| self.vertex(way), simplex, most) {
                let length = self.between.dot(&self.between).sqrt();
                let n = if length > 0.0 { self.between * (1.0 / length) } else { V3::x() };
                return self.refine(&n);
            }
            let (best, proven) = self.expand(polytope);
            if let (Some(shell), true, false) = (shell, proven && !polytope.torn, self.smooth) {
                polytope.keep(shell.get_or_insert_default(), SHELL);
            }
            let found =
                best.map_or_else(|| self.refine(&-polytope.best), |best| self.settled(best));
            self.topped(found)
        })
    }

    /// The shortest way out of polytopes, from the shell of the step before; where that proves none it is
    /// forgotten.
    pub(super) fn overlap_again(&self, shell: &mut Shell) -> Option<Separation> {
        if shell.is_empty() {
            return None;
        }
        let at = |[one, two]: [u32; 2]| {
            self.between + (self.two.corner(two as usize) - self.one.corner(one as usize))
        };
        POLYTOPE.with_borrow_mut(|polytope| {
            let inside = polytope.start_from(shell, &at, POINTS);
            let (best, proven) = if inside { self.expand(polytope) } else { (None, false) };
            // A direction that neither faces nor edges fix is the search's own, to the last bit.
            let fixed = |best: &Separation| best.apart < 0.0 && !matches!(best.cause, Cause::Free);
            let found = best.filter(|best| fixed(best) && proven && !polytope.torn);
            if found.is_none() {
                shell.clear();
            } else if polytope.grown {
                polytope.keep(shell, SHELL);
            }
            found
        })
    }

    /// The best of what refining finds as the polytope grows, and whether nothing better is left.
    fn expand(&self, polytope: &mut Polytope) -> (Option<Separation>, bool) {
        let support = |way: &V3<f64>| self.vertex(way);
        let mut best: Option<Separation> = None;
        for _ in 0..if self.smooth { ROUNDS } else { MANY } {
            let depth = best.map_or(f64::INFINITY, |best| -best.apart);
            let lowest = polytope.lowest(depth - 1e-12 * self.size);
            let Some((face, height)) = lowest else { return (best, !polytope.full) };
            // With a first answer the rest of the search only has to rule out better ones.
            let close = match (self.smooth, best) {
                (true, None) => FIRST * self.size,
                (true, _) => NEXT * (height.max(0.0) + 1e-3 * self.size),
                _ => 1e-12 * self.size,
            };
            let way = polytope.push(face, best.map_or(0.0, |_| close), &support);
            let ended = way.reach - height <= close || polytope.stuck;
            if ended && way.reach < depth {
                let found = self.refine_once(&-way.normal, self.near());
                if found.apart > -depth {
                    best = Some(found);
                }
            }
        }
        (best, false)
    }
}
