//! The signed distance of two convex shapes and the direction along which it is taken.
//!
//! Along a unit direction n from one to the other the shapes are apart by s(n) = min over two of
//! n·x − max over one of n·x, and the signed distance is the largest s: the distance if it is positive,
//! minus the shortest way out if it is negative (Cameron and Culley 1986). A search with support
//! functions alone finds n roughly (`gjk` apart, `epa` overlapping). The exact maximum then depends on
//! the features that meet there: a face fixes n; two edges fix it as their cross product; a corner, a
//! bent surface or an edge leave it two or one degrees of freedom, in which Newton's method ends at
//! rounding. s(n) is exact for any n, so the largest of these candidates is the answer.

use super::gjk::{beyond, gjk, Vertex};
use super::hint::{Hint, Kept};
use super::solid::{plain, Solid};
use super::touch::unit;
use crate::real::Real;
use crate::spatial::V3;
use core::cell::Cell;

thread_local! {
    static SEARCHED: Cell<u64> = const { Cell::new(0) };
}

/// Returns the number of distance searches of this thread: a height field has one for each cell, so
/// that the number of pairs does not determine the cost of a step.
pub(crate) fn searched() -> u64 {
    SEARCHED.get()
}

/// The features that fix the direction. Vectors are in the axes of the shape that they belong to.
#[derive(Clone, Copy, Debug)]
pub enum Cause {
    /// A face of one or two: its outward normal.
    FaceOne(V3<f64>),
    FaceTwo(V3<f64>),
    /// An edge of each.
    Edges(V3<f64>, V3<f64>),
    /// The normal is across an edge of one, or of two, and otherwise free.
    EdgeOne(V3<f64>),
    EdgeTwo(V3<f64>),
    /// Corners and bent surfaces.
    Free,
}

#[derive(Clone, Copy, Debug)]
pub struct Separation {
    /// Unit, from one to two.
    pub normal: V3<f64>,
    /// Separation of the cores [m].
    pub apart: f64,
    pub cause: Cause,
}

/// Both shapes; `between` is from one's centre to two's.
pub struct Pairing<'a> {
    pub(super) one: Solid<'a, f64>,
    pub(super) two: Solid<'a, f64>,
    pub(super) between: V3<f64>,
    pub(super) size: f64,
    pub(super) smooth: bool,
    /// Number of calls of support functions.
    asked: Cell<u64>,
}

/// Over the size of the pair: a gain that is only rounding.
pub(super) const ROUNDING: f64 = 1e-14;
/// Over the size of the pair: margin over a distance beyond which shapes are certainly apart, whatever
/// the rounding of their contacts.
const SURE: f64 = 1e-6;
/// Cosine of the angle to a face's direction that rounding leaves, in single precision too.
const ALONG: f64 = 1.0 - 1e-6;

impl<'a> Pairing<'a> {
    pub fn new(one: Solid<'a, f64>, two: Solid<'a, f64>) -> Self {
        let between = two.pose.pos - one.pose.pos;
        let size = one.extent() + two.extent();
        let smooth = one.smooth() || two.smooth();
        Self { one, two, between, size, smooth, asked: Cell::new(0) }
    }

    /// Counts a call of a support function.
    pub(super) fn ask(&self) {
        self.asked.set(self.asked.get() + 1);
    }

    /// Returns the number of calls of support functions.
    pub fn asked(&self) -> u64 {
        self.asked.get()
    }

    /// Returns the point of two minus one furthest along a direction.
    pub(super) fn furthest(&self, way: &V3<f64>) -> V3<f64> {
        self.vertex(way).at
    }

    /// Returns the same, and its pieces.
    pub(super) fn vertex(&self, way: &V3<f64>) -> Vertex {
        let [(near, one), (far, two)] = self.ends(way);
        Vertex { at: self.between + (far - near), pieces: [one as u32, two as u32] }
    }

    /// Returns one's point furthest against a direction, and two's furthest along it, each from its
    /// shape's centre, and its piece.
    pub(super) fn ends(&self, way: &V3<f64>) -> [(V3<f64>, usize); 2] {
        self.ask();
        [self.one.support(&-way), self.two.support(way)]
    }

    /// Does as `furthest`, starting at the pieces that are furthest along a nearby direction.
    pub(super) fn furthest_from(&self, [one, two]: &mut [usize; 2], way: &V3<f64>) -> V3<f64> {
        self.ask();
        let (near, far);
        (near, *one) = self.one.support_from(*one, &-way);
        (far, *two) = self.two.support_from(*two, way);
        self.between + (far - near)
    }

    /// Returns the pieces of the two that are least apart along a unit direction.
    pub(super) fn pieces(&self, normal: &V3<f64>) -> (usize, usize) {
        (self.one.piece(normal), self.two.piece(&-normal))
    }

    /// Returns the furthest point along a direction of a piece of two minus a piece of one.
    pub(super) fn pinned(&self, (one, two): (usize, usize), way: &V3<f64>) -> V3<f64> {
        self.ask();
        self.between + (self.two.pinned(two, way) - self.one.pinned(one, &-way))
    }

    /// Returns the bend of both shapes: minus the second derivative of the separation along a
    /// direction, without the term of the separation itself.
    pub(super) fn bend(&self, normal: &V3<f64>, turn: &V3<f64>) -> V3<f64> {
        self.one.bend(normal, turn) + self.two.bend(&-normal, turn)
    }

    pub(super) fn apart(&self, normal: &V3<f64>) -> f64 {
        normal.dot(&self.furthest(&-normal))
    }

    /// Returns None if the shapes are proven `within` [m] apart: no contact of theirs is nearer.
    pub fn separation(&self, within: f64, hint: Option<&Cell<Hint>>) -> Option<Separation> {
        SEARCHED.set(SEARCHED.get() + 1);
        let enough = (within + self.one.radius + self.two.radius + SURE * self.size).max(0.0);
        let Some(hint) = hint else {
            return self.found(enough, &mut Hint::default(), false).ok();
        };
        let mut known = hint.take();
        let found = self.found(enough, &mut known, true);
        match &found {
            Ok(Separation { normal, cause, .. }) => {
                known.axis = *normal;
                known.face = matches!(cause, Cause::FaceOne(_) | Cause::FaceTwo(_));
            }
            Err(proof) => known.axis = *proof,
        }
        hint.set(known);
        found.ok()
    }

    /// Returns the direction that proves it as an error, if the cores are `enough` apart. The proof of
    /// the step before is tried first; a search may keep a new proof.
    fn found(&self, enough: f64, known: &mut Hint, keep: bool) -> Result<Separation, V3<f64>> {
        let again = known.shell.as_deref_mut().and_then(|shell| self.overlap_again(shell));
        if let Some(found) = again {
            return Ok(self.or_face(found));
        }
        let some = known.axis != V3::zeros();
        if some && beyond(&self.furthest(&-known.axis), &known.axis, enough) {
            return Err(known.axis);
        }
        let near = if some { known.axis } else { self.toward() };
        if known.face || !some {
            if let Some(own) = self.on_face(&near, -1.0, None) {
                let along = || self.on_face(&own.normal, ALONG, Some(&own));
                return if own.apart > enough {
                    Err(own.normal)
                } else {
                    Ok(along().unwrap_or(own))
                };
            }
        }
        if let Some(own) = self.on_side(&near) {
            return if own.apart > enough { Err(own.normal) } else { Ok(own) };
        }
        self.search(enough, keep.then_some(&mut known.shell)).map(|found| self.or_face(found))
    }

    /// Returns the same numbers for a face, however it was found.
    fn or_face(&self, found: Separation) -> Separation {
        if !self.smooth && matches!(found.cause, Cause::FaceOne(_) | Cause::FaceTwo(_)) {
            return found;
        }
        self.on_face(&found.normal, ALONG, None).unwrap_or(found)
    }

    /// Returns the vector from one's centre to two's; if they coincide, any vector.
    fn toward(&self) -> V3<f64> {
        if self.between.dot(&self.between) > 0.0 {
            self.between
        } else {
            V3::x()
        }
    }

    /// Returns the direction that proves it as an error, if the cores are `enough` apart.
    pub(super) fn search(&self, enough: f64, mut shell: Kept) -> Result<Separation, V3<f64>> {
        let toward = self.toward();
        let support = |way: &V3<f64>| self.vertex(way);
        let gaps: &[f64] = if self.smooth { &[1e-5, 1e-12] } else { &[1e-15] };
        for gap in gaps {
            let nearest = gjk(support, toward, *gap, enough);
            if nearest.beyond {
                return Err(nearest.point);
            }
            if nearest.inside {
                return Ok(self.overlap(&nearest.simplex[..nearest.count], shell.as_deref_mut()));
            }
            let length = nearest.point.dot(&nearest.point).sqrt();
            let found = self.topped(self.refine(&(nearest.point * (1.0 / length))));
            if found.apart >= length * (1.0 - 1e-4) {
                return Ok(found);
            }
            if found.apart <= 0.0 {
                return Ok(self.overlap(&nearest.simplex[..nearest.count], shell.as_deref_mut()));
            }
        }
        Ok(self.overlap(&[], shell))
    }
}

/// Returns the unit vector across two, on the side of a third; None if they are parallel.
pub(super) fn across<R: Real>(e: &V3<R>, f: &V3<R>, rough: &V3<f64>) -> Option<V3<R>> {
    let cross = e.cross(f);
    let square = cross.dot(&cross);
    if square.lane(0) <= 1e-24 {
        return None;
    }
    let n = cross * (R::one() / square.sqrt());
    Some(if n.map(|x| x.lane(0)).dot(rough) < 0.0 { -n } else { n })
}

/// Returns two unit vectors across a third and each other.
pub(super) fn across_both(n: &V3<f64>) -> (V3<f64>, V3<f64>) {
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

/// Returns the direction in numbers that carry slopes, from the features that fix it.
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

/// Takes one Newton step from the direction found, where the step is 0.
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
