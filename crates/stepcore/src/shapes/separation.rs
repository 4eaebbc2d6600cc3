//! The signed distance of two convex shapes and the direction along which it is taken.
//!
//! Along a unit direction n from one to the other the shapes are apart by
//! s(n) = min over two of n·x − max over one of n·x, and the signed distance is the largest s: the
//! distance where it is positive, minus the shortest way out where it is negative (Cameron and
//! Culley 1986). A search that knows the shapes by their support functions alone finds n roughly
//! (`gjk` apart, `epa` overlapping). Where the maximum lies exactly is then a matter of what meets
//! there: a face fixes n; two edges fix it as their cross product; a corner, a bent surface or an
//! edge leave it two or one degrees of freedom, in which Newton's method ends at rounding. What
//! s(n) says is exact whatever n came from, so the largest of these candidates is the answer.

use super::epa::Polytope;
use super::gjk::gjk;
use super::solid::{plain, Core, Solid};
use super::touch::unit;
use crate::real::Real;
use crate::spatial::V3;
use core::cell::Cell;

/// What fixes the direction. Vectors are in the axes of the shape that they belong to.
#[derive(Clone, Copy, Debug)]
pub enum Cause {
    /// A face of one or two: its outward normal.
    FaceOne(V3<f64>),
    FaceTwo(V3<f64>),
    /// An edge of each.
    Edges(V3<f64>, V3<f64>),
    /// The normal is across an edge of one, or of two, and else free.
    EdgeOne(V3<f64>),
    EdgeTwo(V3<f64>),
    /// Corners and bent surfaces.
    Free,
}

#[derive(Clone, Copy, Debug)]
pub struct Separation {
    /// Unit, from one to two.
    pub normal: V3<f64>,
    /// Of the cores [m].
    pub apart: f64,
    pub cause: Cause,
}

/// Both shapes; `between` is from one's centre to two's.
pub struct Pairing<'a> {
    one: Solid<'a, f64>,
    two: Solid<'a, f64>,
    between: V3<f64>,
    size: f64,
    smooth: bool,
    /// How often a support function was asked.
    asked: Cell<u64>,
}

/// Sines of the angle from a rough direction within which faces and edges are tried: of polytopes
/// the search ends at rounding, of bent surfaces near the answer.
const NEAR_EXACT: f64 = 0.02;
const NEAR_ROUGH: f64 = 0.3;
const NEAR_AGAIN: f64 = 0.1;
/// Over the size of the pair: a gain that is only rounding.
const ROUNDING: f64 = 1e-14;
/// Over the size of the pair: by how much more than a distance shapes are apart for sure, whatever
/// rounding does to their contacts.
const SURE: f64 = 1e-6;
/// Rounds of the search, and of Newton's method.
const ROUNDS: usize = 90;
/// The same of meshes of many faces.
const MANY: usize = 2000;
const STEPS: usize = 30;
const AGAIN: usize = 4;
/// Cosine of the angle to a cap up to which its rim gets a start of its own.
const CAP: f64 = 0.9;
/// Over the size of the pair: how near a search must have come for a first answer.
const FIRST: f64 = 0.05;
/// Steps of Newton's method whose gain rounding hides.
const HIDDEN: usize = 3;
/// Edges of a corner that are tried.
const EDGES: usize = 16;

impl<'a> Pairing<'a> {
    pub fn new(one: Solid<'a, f64>, two: Solid<'a, f64>) -> Self {
        let between = two.pose.pos - one.pose.pos;
        let size = one.extent() + two.extent();
        let smooth = one.smooth() || two.smooth();
        Self { one, two, between, size, smooth, asked: Cell::new(0) }
    }

    /// How often a support function was asked.
    pub fn asked(&self) -> u64 {
        self.asked.get()
    }

    /// The point of two minus one furthest along a direction.
    fn furthest(&self, way: &V3<f64>) -> V3<f64> {
        self.asked.set(self.asked.get() + 1);
        self.between + (self.two.support(way).0 - self.one.support(&-way).0)
    }

    fn apart(&self, normal: &V3<f64>) -> f64 {
        normal.dot(&self.furthest(&-normal))
    }

    /// None of shapes that are proven `within` [m] apart: no contact of theirs is nearer.
    pub fn separation(&self, within: f64) -> Option<Separation> {
        let enough = within + self.one.radius + self.two.radius + SURE * self.size;
        self.search(enough.max(0.0))
    }

    /// None of cores that are proven `enough` apart.
    fn search(&self, enough: f64) -> Option<Separation> {
        let some = self.between.dot(&self.between) > 0.0;
        let toward = if some { self.between } else { V3::x() };
        let support = |way: &V3<f64>| self.furthest(way);
        let gaps: &[f64] = if self.smooth { &[1e-5, 1e-12] } else { &[1e-15] };
        for gap in gaps {
            let nearest = gjk(support, toward, *gap, enough);
            if nearest.beyond {
                return None;
            }
            if nearest.inside {
                return Some(self.overlap(&nearest.simplex[..nearest.count]));
            }
            let length = nearest.point.dot(&nearest.point).sqrt();
            let found = self.refine(&(nearest.point * (1.0 / length)));
            if found.apart >= length * (1.0 - 1e-4) {
                return Some(found);
            }
            if found.apart <= 0.0 {
                return Some(self.overlap(&nearest.simplex[..nearest.count]));
            }
        }
        Some(self.overlap(&[]))
    }

    /// The shortest way out, from a simplex that may hold the origin. Meshes of many faces that lie
    /// deep in others may need more room than is enough for all else.
    fn overlap(&self, simplex: &[V3<f64>]) -> Separation {
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
        let found = best.map_or_else(|| self.refine(&-polytope.best), |best| self.settled(best));
        (found, proven)
    }

    /// The largest separation near a rough direction. What meets there may be other corners than
    /// those that the rough direction shows: with bent surfaces again from where it led.
    fn refine(&self, rough: &V3<f64>) -> Separation {
        self.settled(self.refine_once(rough, self.near()))
    }

    fn near(&self) -> f64 {
        if self.smooth {
            NEAR_ROUGH
        } else {
            NEAR_EXACT
        }
    }

    /// The same again from where it led, until that is the best there is.
    fn settled(&self, mut best: Separation) -> Separation {
        for _ in 0..if self.smooth { AGAIN } else { 0 } {
            let next = self.refine_once(&best.normal, NEAR_AGAIN);
            if next.apart <= best.apart + ROUNDING * self.size {
                break;
            }
            best = next;
        }
        best
    }

    fn refine_once(&self, rough: &V3<f64>, near: f64) -> Separation {
        let start = self.apart(rough);
        let mut best = Separation { normal: *rough, apart: f64::NEG_INFINITY, cause: Cause::Free };
        let mut offer = |normal: V3<f64>, apart: f64, cause: Cause| {
            if apart > best.apart + ROUNDING * self.size {
                best = Separation { normal, apart, cause };
            }
        };
        let cosine = (1.0 - near * near).sqrt();
        if let Some((normal, along, _)) = self.one.face(rough) {
            if along >= cosine {
                offer(normal, self.apart(&normal), Cause::FaceOne(self.one.pose.to_local(&normal)));
            }
        }
        if let Some((outward, along, _)) = self.two.face(&-rough) {
            if along >= cosine {
                let local = self.two.pose.to_local(&outward);
                offer(-outward, self.apart(&-outward), Cause::FaceTwo(local));
            }
        }
        let (ones, nones) = edges(&self.one, rough, near);
        let (twos, ntwos) = edges(&self.two, &-rough, near);
        for e in &ones[..nones] {
            for f in &twos[..ntwos] {
                if let Some(normal) = across(e, f, rough) {
                    let [e, f] = [self.one.pose.to_local(e), self.two.pose.to_local(f)];
                    offer(normal, self.apart(&normal), Cause::Edges(e, f));
                }
            }
        }
        // With corners alone these are places of least separation while the shapes overlap.
        if self.smooth || start > 0.0 {
            let starts = [Some(*rough), self.over_rim_of_one(rough), self.over_rim_of_two(rough)];
            for from in starts.iter().flatten() {
                for e in &ones[..nones] {
                    let (normal, apart) = self.climb(from, Some(e));
                    offer(normal, apart, Cause::EdgeOne(self.one.pose.to_local(e)));
                }
                for f in &twos[..ntwos] {
                    let (normal, apart) = self.climb(from, Some(f));
                    offer(normal, apart, Cause::EdgeTwo(self.two.pose.to_local(f)));
                }
                let (normal, apart) = self.climb(from, None);
                offer(normal, apart, Cause::Free);
            }
        }
        offer(*rough, start, Cause::Free);
        best
    }

    /// Where what meets a cylinder's cap lies beyond its rim, a start for Newton's method: the cap's
    /// normal leant that way. The rim's bend is infinite at the cap's own normal, and from another
    /// side of it no step leads there.
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

    /// Newton's method for the largest separation near a direction; with an edge, across it.
    fn climb(&self, rough: &V3<f64>, edge: Option<&V3<f64>>) -> (V3<f64>, f64) {
        let onto = |n: V3<f64>| edge.map_or(n, |e| n - e * e.dot(&n));
        let mut normal = unit(&onto(*rough));
        let mut point = self.furthest(&-normal);
        let mut apart = normal.dot(&point);
        let mut hidden = 0;
        for _ in 0..STEPS {
            let Some(step) = self.newton(&normal, &point, apart, edge) else { break };
            let square = step.dot(&step);
            let mut share = 1.0;
            let better = loop {
                let next = unit(&onto(normal + step * share));
                let there = self.furthest(&-next);
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

    /// The step of Newton's method. On the unit sphere the slope
    /// of n·w(n) is what of w is across n, and its bend minus both shapes' bends minus n·w.
    fn newton(
        &self,
        normal: &V3<f64>,
        point: &V3<f64>,
        apart: f64,
        edge: Option<&V3<f64>>,
    ) -> Option<V3<f64>> {
        let bend = |t: &V3<f64>| self.one.bend(normal, t) + self.two.bend(&-normal, t);
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

/// Edges at the corner furthest along a unit direction that are nearly across it: unit vectors.
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
            while let Some(next) = solid.neighbour(corner, k) {
                add(unit(&(solid.corner(next) - here)));
                k += 1;
            }
        }
    }
    (list, count)
}

/// The unit vector across two, on the side of a third; None where they are parallel.
fn across<R: Real>(e: &V3<R>, f: &V3<R>, rough: &V3<f64>) -> Option<V3<R>> {
    let cross = e.cross(f);
    let square = cross.dot(&cross);
    if square.lane(0) <= 1e-24 {
        return None;
    }
    let n = cross * (R::one() / square.sqrt());
    Some(if n.map(|x| x.lane(0)).dot(rough) < 0.0 { -n } else { n })
}

/// Two unit vectors across a third and each other.
fn across_both(n: &V3<f64>) -> (V3<f64>, V3<f64>) {
    let mut axis = V3::zeros();
    let least = if n.x.abs() <= n.y.abs() && n.x.abs() <= n.z.abs() {
        0
    } else if n.y.abs() <= n.z.abs() {
        1
    } else {
        2
    };
    axis[least] = 1.0;
    let t = unit(&n.cross(&axis));
    (t, n.cross(&t))
}

/// The direction in numbers that carry slopes, from what fixes it.
pub fn normal<R: Real>(
    found: &Separation,
    one: &Solid<R>,
    two: &Solid<R>,
    between: &V3<R>,
) -> V3<R> {
    let constant = found.normal.map(R::of);
    match found.cause {
        Cause::FaceOne(n) => one.pose.to_world(&n.map(R::of)),
        Cause::FaceTwo(n) => -two.pose.to_world(&n.map(R::of)),
        Cause::Edges(e, f) => {
            let [e, f] = [one.pose.to_world(&e.map(R::of)), two.pose.to_world(&f.map(R::of))];
            across(&e, &f, &found.normal).unwrap_or(constant)
        }
        Cause::EdgeOne(e) => free(found, one, two, between, Some(one.pose.to_world(&e.map(R::of)))),
        Cause::EdgeTwo(f) => free(found, one, two, between, Some(two.pose.to_world(&f.map(R::of)))),
        Cause::Free => free(found, one, two, between, None),
    }
}

/// One Newton step from the direction found, which is where the step is 0.
fn free<R: Real>(
    found: &Separation,
    one: &Solid<R>,
    two: &Solid<R>,
    between: &V3<R>,
    edge: Option<V3<R>>,
) -> V3<R> {
    let constant = [found.normal.x, found.normal.y, found.normal.z].map(R::of);
    let newton = |n: [R; 3]| {
        let mut n = V3::new(n[0], n[1], n[2]);
        if let Some(e) = &edge {
            n = unit(&(n - e * e.dot(&n)));
        }
        let (p, q) = (plain(one.pose), plain(two.pose));
        let plain_one = Solid { core: one.core, radius: one.radius, pose: &p };
        let plain_two = Solid { core: two.core, radius: two.radius, pose: &q };
        let pairing = Pairing::new(plain_one, plain_two);
        let point = between + (two.support(&-n).0 - one.support(&n).0);
        let bend =
            |t: &V3<f64>| pairing.one.bend(&found.normal, t) + pairing.two.bend(&-found.normal, t);
        let step = match &edge {
            Some(e) => {
                let t = unit(&e.cross(&n));
                let plain_t = t.map(|x| x.lane(0));
                let h = plain_t.dot(&bend(&plain_t)) + found.apart;
                t * (t.dot(&point) * R::of(h.recip_or_zero()))
            }
            None => {
                let (t, u) = across_both(&found.normal);
                let (bt, bu) = (bend(&t), bend(&u));
                let (tt, tu, uu) = (t.dot(&bt) + found.apart, t.dot(&bu), u.dot(&bu) + found.apart);
                let inverse = R::of((tt * uu - tu * tu).recip_or_zero());
                let (t, u) = (t.map(R::of), u.map(R::of));
                let (g, k) = (t.dot(&point), u.dot(&point));
                t * ((R::of(uu) * g - R::of(tu) * k) * inverse)
                    + u * ((R::of(tt) * k - R::of(tu) * g) * inverse)
            }
        };
        let n = unit(&(n + step));
        [n.x, n.y, n.z]
    };
    let [x, y, z] = R::implicit(constant, newton);
    V3::new(x, y, z)
}
