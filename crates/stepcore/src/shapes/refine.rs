//! From a rough direction to the largest separation near it.

use super::gjk::Vertex;
use super::peak::peak;
use super::separation::{across, across_both, Cause, Pairing, Separation, ROUNDING};
use super::solid::{Core, Solid};
use super::touch::unit;
use crate::real::array::from_fn;
use crate::real::Real;
use crate::spatial::V3;

/// Sines of the angle from a rough direction within which faces and edges are tried: for polytopes the
/// search ends at rounding, for bent surfaces near the answer.
const NEAR_EXACT: f64 = 0.02;
const NEAR_ROUGH: f64 = 0.3;
const NEAR_AGAIN: f64 = 0.1;
/// Over the size of the pair: largest distance of a point outside of its shape.
const HOLDS: f64 = 1e-10;
/// Steps of Newton's method, and the number of its restarts from its result.
const STEPS: usize = 30;
const AGAIN: usize = 4;
/// Cosine of the angle to a cap up to which its rim gets a separate start.
const CAP: f64 = 0.9;
/// Steps of Newton's method whose gain rounding hides.
const HIDDEN: usize = 3;
/// Edges of a corner that are tried.
const EDGES: usize = 16;
/// Number of a search's last points that are kept.
const KEPT: usize = 8;

/// Points of two minus one. Along no direction are the two further apart than these are, so that
/// directions that gain nothing are rejected without computing their furthest points.
struct Seen {
    /// By coordinate, so that the products of all points are made at once.
    points: [[f64; KEPT]; 3],
    next: usize,
}

impl Seen {
    fn new(first: V3<f64>) -> Self {
        Self { points: from_fn(|k| [first[k]; KEPT]), next: 1 }
    }

    fn add(&mut self, point: V3<f64>) {
        for (k, of) in self.points.iter_mut().enumerate() {
            of[self.next % KEPT] = point[k];
        }
        self.next += 1;
    }

    fn least(&self, of: impl Fn(V3<f64>) -> f64) -> f64 {
        let [x, y, z] = &self.points;
        let mut all: [f64; KEPT] = from_fn(|i| of(V3::new(x[i], y[i], z[i])));
        for half in [KEPT / 2, KEPT / 4, KEPT / 8] {
            for i in 0..half {
                all[i] = Real::min(all[i], all[i + half]);
            }
        }
        all[0]
    }

    fn apart_at_most(&self, normal: &V3<f64>) -> f64 {
        self.least(|point| normal.dot(&point))
    }

    /// Returns the same along any direction; `reach_across`: along any across an edge. Nonnegative.
    fn reach(&self) -> f64 {
        self.least(|point| point.dot(&point)).sqrt()
    }

    fn reach_across(&self, edge: &V3<f64>) -> f64 {
        self.least(|p| p.dot(&p) - edge.dot(&p) * edge.dot(&p)).max(0.0).sqrt()
    }
}

impl Pairing<'_> {
    /// Finds the largest separation near a rough direction. Other corners than the rough direction's
    /// may meet there: for bent surfaces the search repeats from its result.
    pub(super) fn refine(&self, rough: &V3<f64>) -> Separation {
        self.settled(self.refine_once(rough, self.near()))
    }

    pub(super) fn near(&self) -> f64 {
        if self.smooth {
            NEAR_ROUGH
        } else {
            NEAR_EXACT
        }
    }

    /// Repeats the search from its result, until it is the best there is.
    pub(super) fn settled(&self, mut best: Separation) -> Separation {
        for _ in 0..if self.smooth { AGAIN } else { 0 } {
            let next = self.refine_once(&best.normal, NEAR_AGAIN);
            if next.apart <= best.apart + ROUNDING * self.size {
                break;
            }
            best = next;
        }
        best
    }

    /// Improves a separation that is not the largest nearby, as when one of its points is not on its
    /// shape. Polytopes that overlap have only exact directions.
    pub(super) fn topped(&self, found: Separation) -> Separation {
        if !(self.smooth || found.apart > 0.0) || self.holds(&found) {
            return found;
        }
        let top = peak(self, &found.normal);
        let mut seen = Seen::new(self.furthest(&-top));
        let (normal, apart) = self.climb(&top, None, &mut seen);
        let free = Separation { normal, apart, cause: Cause::Free };
        let mut best = found;
        // Directions that differ by 1e-8 are as good within rounding; their points are not.
        for next in [self.refine_once(&top, NEAR_AGAIN), free] {
            let gained = next.apart - best.apart;
            let even = gained.abs() <= ROUNDING * self.size;
            if if even { self.holds(&next) } else { gained > 0.0 } {
                best = next;
            }
        }
        best
    }

    /// Checks that the place along the normal at which the separation is taken belongs to both shapes.
    pub(super) fn holds(&self, found: &Separation) -> bool {
        let n = &found.normal;
        let (p, q) = (self.one.support(n).0, self.between + self.two.support(&-n).0);
        let off = HOLDS * self.size;
        match found.cause {
            Cause::FaceOne(_) | Cause::EdgeOne(_) => {
                let over = |q: V3<f64>| self.one.outside(&(q - n * found.apart)) <= off;
                let middle = || self.one.face(n).and_then(|(.., face)| self.one.middle(face));
                let beside = |at| self.between + self.two.furthest_near(&-n, &(at - self.between));
                over(q) || middle().is_some_and(|at| over(beside(at)))
            }
            Cause::FaceTwo(_) | Cause::EdgeTwo(_) => {
                let over = |p| self.two.outside(&(p + n * found.apart - self.between)) <= off;
                let middle = || self.two.face(&-n).and_then(|(.., face)| self.two.middle(face));
                let beside = |at| self.one.furthest_near(n, &(at + self.between));
                over(p) || middle().is_some_and(|at| over(beside(at)))
            }
            Cause::Edges(e, f) => {
                let [e, f] = [self.one.pose.to_world(&e), self.two.pose.to_world(&f)];
                let side = f.cross(n);
                let at = p + e * ((q - p).dot(&side) / e.dot(&side));
                let there = at + n * found.apart - self.between;
                self.one.outside(&at) <= off && self.two.outside(&there) <= off
            }
            Cause::Free => {
                let sideways = q - p - n * found.apart;
                sideways.dot(&sideways) <= off * off
            }
        }
    }

    pub(super) fn refine_once(&self, rough: &V3<f64>, near: f64) -> Separation {
        let first = self.furthest(&-rough);
        let (start, mut seen) = (rough.dot(&first), Seen::new(first));
        let level = (1.0 - near * near).sqrt();
        let facing = self.facing(rough, level);
        let mut best = self.best_of(&facing).unwrap_or(Separation {
            normal: *rough,
            apart: f64::NEG_INFINITY,
            cause: Cause::Free,
        });
        if self.tops(&facing, &best, near / level) {
            return best;
        }
        let offer = |best: &mut Separation, normal: V3<f64>, apart: f64, cause: Cause| {
            if apart > best.apart + ROUNDING * self.size {
                *best = Separation { normal, apart, cause };
            }
        };
        let (ones, nones) = edges(&self.one, rough, near);
        let (twos, ntwos) = edges(&self.two, &-rough, near);
        for e in &ones[..nones] {
            for f in &twos[..ntwos] {
                if let Some(normal) = across(e, f, rough) {
                    if seen.apart_at_most(&normal) < best.apart {
                        continue;
                    }
                    let point = self.furthest(&-normal);
                    seen.add(point);
                    let [e, f] = [self.one.pose.to_local(e), self.two.pose.to_local(f)];
                    offer(&mut best, normal, normal.dot(&point), Cause::Edges(e, f));
                }
            }
        }
        // For shapes with corners alone these are places of least separation while the shapes overlap.
        if self.smooth || start > 0.0 {
            let starts = [Some(*rough), self.over_rim_of_one(rough), self.over_rim_of_two(rough)];
            for from in starts.iter().flatten() {
                if seen.reach() <= best.apart {
                    break;
                }
                let (top, most) = self.climb(from, None, &mut seen);
                for (solid, flip) in [(&self.one, 1.0), (&self.two, -1.0)] {
                    let (edges, count) = edges(solid, &(top * flip), near.min(NEAR_AGAIN));
                    for e in &edges[..count] {
                        if seen.reach_across(e) <= best.apart {
                            continue;
                        }
                        let (normal, apart) = self.climb(&top, Some(e), &mut seen);
                        let own = solid.pose.to_local(e);
                        let cause =
                            if flip > 0.0 { Cause::EdgeOne(own) } else { Cause::EdgeTwo(own) };
                        offer(&mut best, normal, apart, cause);
                    }
                }
                offer(&mut best, top, most, Cause::Free);
            }
        }
        offer(&mut best, *rough, start, Cause::Free);
        best
    }

    /// Returns a start for Newton's method if the feature over a cylinder's cap lies beyond its rim:
    /// the cap's normal tilted that way. The rim's bend is infinite at the cap's normal, and no step
    /// leads there from another side of it.
    fn over_rim_of_one(&self, rough: &V3<f64>) -> Option<V3<f64>> {
        let (cap, ..) = self.one.face(rough).filter(|face| face.1 > CAP)?;
        let there = self.between + self.two.support(&-cap).0;
        self.one.over_rim(&cap, &there, self.size)
    }

    fn over_rim_of_two(&self, rough: &V3<f64>) -> Option<V3<f64>> {
        let (cap, ..) = self.two.face(&-rough).filter(|face| face.1 > CAP)?;
        let there = self.one.support(&-cap).0 - self.between;
        self.two.over_rim(&cap, &there, self.size).map(|n| -n)
    }

    /// Runs Newton's method for the largest separation near a direction; with an edge, across it.
    fn climb(&self, rough: &V3<f64>, edge: Option<&V3<f64>>, seen: &mut Seen) -> (V3<f64>, f64) {
        let onto = |n: V3<f64>| edge.map_or(n, |e| n - e * e.dot(&n));
        let mut normal = unit(&onto(*rough));
        let Vertex { at: mut point, pieces } = self.vertex(&-normal);
        let mut pieces = pieces.map(|piece| piece as usize);
        let mut apart = normal.dot(&point);
        let mut hidden = 0;
        for _ in 0..STEPS {
            let Some(step) = self.newton(&normal, &point, apart, edge) else { break };
            let square = step.dot(&step);
            let mut share = 1.0;
            let better = loop {
                let next = unit(&onto(normal + step * share));
                if seen.apart_at_most(&next) > apart - 2.0 * ROUNDING * self.size {
                    let there = self.furthest_from(&mut pieces, &-next);
                    seen.add(there);
                    let gained = next.dot(&there);
                    if gained > apart {
                        break Some((next, there, gained));
                    }
                    // The last steps gain less than rounding shows.
                    let even = gained > apart - ROUNDING * self.size;
                    if share == 1.0 && square < 1e-4 && even && hidden < HIDDEN {
                        hidden += 1;
                        break Some((next, there, gained));
                    }
                }
                share *= 0.25;
                if share < 1e-3 {
                    break None;
                }
            };
            let Some((next, there, gained)) = better else { break };
            (normal, point, apart) = (next, there, gained);
            if square < 1e-32 {
                break;
            }
        }
        (normal, apart)
    }

    /// Returns the step of Newton's method. On the unit sphere the slope of n·w(n) is the part of w
    /// across n, and its bend is minus both shapes' bends minus n·w.
    fn newton(
        &self,
        normal: &V3<f64>,
        point: &V3<f64>,
        apart: f64,
        edge: Option<&V3<f64>>,
    ) -> Option<V3<f64>> {
        let bend = |t: &V3<f64>| self.bend(normal, t);
        if let Some(e) = edge {
            let t = unit(&e.cross(normal));
            let (g, h) = (t.dot(point), t.dot(&bend(&t)) + apart);
            let step =
                if h > 0.0 { g / h } else { g / (h.abs() + apart.abs()).max(f64::MIN_POSITIVE) };
            return step.is_finite().then(|| t * step.clamp(-0.5, 0.5));
        }
        let (t, u) = across_both(normal);
        let (bt, bu) = (bend(&t), bend(&u));
        let (g, k) = (t.dot(point), u.dot(point));
        let (tt, tu, uu) = (t.dot(&bt) + apart, t.dot(&bu), u.dot(&bu) + apart);
        let det = tt * uu - tu * tu;
        let step = if tt > 0.0 && det > 0.0 {
            t * ((uu * g - tu * k) / det) + u * ((tt * k - tu * g) / det)
        } else {
            let scale = (tt.abs() + uu.abs() + apart.abs()).max(f64::MIN_POSITIVE);
            (t * g + u * k) * (1.0 / scale)
        };
        let length = step.dot(&step).sqrt();
        let step = if length > 0.5 { step * (0.5 / length) } else { step };
        length.is_finite().then_some(step)
    }
}

/// Returns edges at the corner furthest along a unit direction that are nearly across it: unit vectors.
fn edges(solid: &Solid<f64>, rough: &V3<f64>, near: f64) -> ([V3<f64>; EDGES], usize) {
    let mut list = [V3::zeros(); EDGES];
    let mut count = 0;
    let mut add = |edge: V3<f64>| {
        if count < EDGES && edge.dot(rough).abs() <= near {
            list[count] = edge;
            count += 1;
        }
    };
    match solid.core {
        Core::Point | Core::Ellipsoid(_) => {}
        Core::Segment(_) | Core::Cylinder(..) => add(solid.pose.axis(2)),
        Core::Box(_) => (0..3).for_each(|i| add(solid.pose.axis(i))),
        Core::Hull(_) | Core::Prism(_) => {
            let corner = solid.support(rough).1;
            let here = solid.corner(corner);
            let mut k = 0;
            while let Some(next) = solid.fold(corner, k) {
                add(unit(&(solid.corner(next) - here)));
                k += 1;
            }
        }
    }
    (list, count)
}
