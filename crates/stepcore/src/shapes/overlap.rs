//! The shortest way out of each other of two shapes that overlap.

use super::epa::Polytope;
use super::separation::{Pairing, Separation, ROUNDING};
use super::solid::{Core, Solid};
use crate::spatial::V3;

/// Rounds of the search.
const ROUNDS: usize = 90;
/// The same of meshes of many faces.
const MANY: usize = 2000;
/// Over the size of the pair: how near a search must have come for a first answer.
const FIRST: f64 = 0.05;

impl Pairing<'_> {
    /// The shortest way out, from a simplex that may hold the origin. Meshes of many faces that lie
    /// deep in others may need more room than is enough for all else.
    pub(super) fn overlap(&self, simplex: &[V3<f64>]) -> Separation {
        let (found, proven) = self.expand::<72, 144>(simplex, ROUNDS);
        if proven || self.smooth {
            return found;
        }
        let (again, _) = self.expand::<600, 1200>(simplex, MANY);
        if again.apart > found.apart {
            again
        } else {
            found
        }
    }

    /// The same with this much room; false: room or rounds ended before all others were ruled out.
    #[inline(never)]
    fn expand<const POINTS: usize, const FACES: usize>(
        &self,
        simplex: &[V3<f64>],
        rounds: usize,
    ) -> (Separation, bool) {
        let support = |way: &V3<f64>| self.furthest(way);
        let Some(mut polytope) = Polytope::<POINTS, FACES>::new(&support, simplex) else {
            let length = self.between.dot(&self.between).sqrt();
            let n = if length > 0.0 { self.between * (1.0 / length) } else { V3::x() };
            return (self.refine(&n), true);
        };
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
            let (better, room) = self.beside(first, &mut polytope, own, rounds);
            (best, proven) = (Some(better), room);
        }
        let found = best.map_or_else(|| self.refine(&-polytope.best), |best| self.settled(best));
        (self.topped(found), proven)
    }

    /// A better answer that hides behind faces which look along the best one's direction: of a large
    /// shape's rim with a small shape around it they may be far below the surface. false: room or
    /// rounds ended first.
    fn beside<const POINTS: usize, const FACES: usize>(
        &self,
        mut best: Separation,
        polytope: &mut Polytope<POINTS, FACES>,
        own: f64,
        rounds: usize,
    ) -> (Separation, bool) {
        let support = |way: &V3<f64>| self.furthest(way);
        for _ in 0..rounds {
            let skip = |_: &V3<f64>, height: f64| height >= -best.apart - 1e-12 * self.size;
            let Some(face) = polytope.lowest(skip) else { return (best, !polytope.full) };
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
        (best, false)
    }
}
