//! The shortest way out of each other of two shapes that overlap.

use super::epa::Polytope;
use super::separation::{Pairing, Separation, ROUNDING};
use super::solid::{Core, Solid};
use crate::spatial::V3;
use core::cell::RefCell;

/// Rounds of the search, and room for points of the polytope; of shapes with corners alone more, because
/// meshes of many faces may lie deep in others.
const ROUNDS: usize = 90;
const POINTS: usize = 72;
const MANY: usize = 2000;
const MANY_POINTS: usize = 600;
/// Over the size of the pair: how near a search must have come for a first answer.
const FIRST: f64 = 0.05;

thread_local! {
    static POLYTOPE: RefCell<Polytope> = RefCell::default();
}

impl Pairing<'_> {
    /// The shortest way out, from a simplex that may hold the origin.
    pub(super) fn overlap(&self, simplex: &[V3<f64>]) -> Separation {
        POLYTOPE.with_borrow_mut(|polytope| self.expand(polytope, simplex))
    }

    fn expand(&self, polytope: &mut Polytope, simplex: &[V3<f64>]) -> Separation {
        let support = |way: &V3<f64>| self.furthest(way);
        let (rounds, most) = if self.smooth { (ROUNDS, POINTS) } else { (MANY, MANY_POINTS) };
        if !polytope.start(&support, simplex, most) {
            let length = self.between.dot(&self.between).sqrt();
            let n = if length > 0.0 { self.between * (1.0 / length) } else { V3::x() };
            return self.refine(&n);
        }
        let faceted = |solid: &Solid<f64>| matches!(solid.core, Core::Hull(_) | Core::Prism(_));
        // Within this cosine a refined direction is the best one: facets of a mesh may be as near to
        // one another as this.
        let own = if faceted(&self.one) || faceted(&self.two) { 1.0 - 1e-9 } else { 1.0 - 1e-3 };
        let (mut best, mut proven): (Option<Separation>, _) = (None, false);
        for _ in 0..rounds {
            let skip = |normal: &V3<f64>, height: f64| {
                best.is_some_and(|best: Separation| {
                    height >= -best.apart - 1e-12 * self.size || -normal.dot(&best.normal) > own
                })
            };
            let Some(face) = polytope.lowest(skip) else {
                proven = !polytope.full;
                break;
            };
            let way = polytope.push(face, &support);
            let gap = way.reach - way.height;
            // With a first answer the rest of the search only has to rule out better ones.
            let close = match (self.smooth, best) {
                (true, None) => FIRST * self.size,
                (true, _) => 1e-3 * way.reach + 1e-6 * self.size,
                _ => 1e-12 * self.size,
            };
            if gap <= close || polytope.stuck {
                let found = self.refine_once(&-way.normal, self.near());
                if best.is_none_or(|best| found.apart > best.apart) {
                    best = Some(found);
                }
            }
        }
        if let (Some(first), true, true) = (best, self.smooth, proven) {
            best = Some(self.beside(first, polytope, own));
        }
        let found = best.map_or_else(|| self.refine(&-polytope.best), |best| self.settled(best));
        self.topped(found)
    }

    /// A better answer that hides behind faces which look along the best one's direction: of a large
    /// shape's rim with a small shape around it they may be far below the surface.
    fn beside(&self, mut best: Separation, polytope: &mut Polytope, own: f64) -> Separation {
        let support = |way: &V3<f64>| self.furthest(way);
        for _ in 0..ROUNDS {
            let skip = |_: &V3<f64>, height: f64| height >= -best.apart - 1e-12 * self.size;
            let Some(face) = polytope.lowest(skip) else { break };
            let close = -1e-3 * best.apart + 1e-6 * self.size;
            let way = polytope.push_beyond(face, close, &support);
            let ended = way.reach - way.height <= close || polytope.stuck;
            if ended && -way.normal.dot(&best.normal) <= own {
                let found = self.refine_once(&-way.normal, self.near());
                if found.apart > best.apart + ROUNDING * self.size {
                    best = found;
                }
            }
        }
        best
    }
}
