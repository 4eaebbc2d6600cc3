//! All points at which two shapes lie against each other, given their normal.
//!
//! In the projection along the normal, the features that meet (a face, an edge, or a point of each)
//! overlap in a polygon, a stretch or a point. Its corners are the contacts. Each has the distance
//! along the normal between the two shapes there, and is named by the features that cross at it. The
//! deepest place is always among them.

use super::contact_feature::{feature, Corner, Feature, Polygon, CORNERS};
use super::separation::{Cause, Separation};
use super::solid::{on_segment, Core, Solid};
use super::spread::spread;
use crate::real::Real;
use crate::spatial::V3;

/// Capacity for contacts: of a pair, and of a cell of a height field.
pub const MOST: usize = 8;
/// Corners of the overlap of two faces.
const ROOM: usize = 2 * CORNERS;
/// Over the size of the pair: a point outside by no more than this lies on the border, and a difference
/// in depth of no more than this does not count.
const BORDER: f64 = 1e-10;
/// Over the size of the pair: places whose depths differ by less may be equally deep.
const EVEN: f64 = 1e-6;
/// Sine of the angle below which two edges count as parallel.
const PARALLEL: f64 = 1e-3;

/// A contact of the cores.
#[derive(Clone, Copy)]
pub struct Point<R: Real> {
    /// Distance between the cores along the normal [m].
    pub apart: R,
    /// Halfway between them, from the first shape's centre.
    pub at: V3<R>,
    pub name: u32,
}

pub struct Manifold<R: Real> {
    pub points: [Point<R>; MOST],
    pub count: usize,
}

/// The mutual contact of two shapes.
pub struct ContactPatch<'a, R: Real> {
    pub one: Solid<'a, R>,
    pub two: Solid<'a, R>,
    /// From one's centre to two's.
    pub between: V3<R>,
    pub normal: V3<R>,
    /// The sum of the half extents.
    pub size: f64,
}

/// Lists that grow to at most `ROOM`.
struct Points<R: Real> {
    list: [Point<R>; ROOM],
    count: usize,
}

impl<R: Real> Points<R> {
    fn new() -> Self {
        let none = Point { apart: R::one(), at: V3::zeros(), name: 0 };
        Self { list: [none; ROOM], count: 0 }
    }

    /// Returns the index of the deepest.
    fn low(&self) -> Option<usize> {
        let deeper = |low: usize, i: usize| {
            let lower = self.list[i].apart.lane(0) < self.list[low].apart.lane(0);
            if lower {
                i
            } else {
                low
            }
        };
        (0..self.count).reduce(deeper)
    }

    fn add(&mut self, point: Point<R>) {
        if self.count < ROOM {
            self.list[self.count] = point;
            self.count += 1;
        }
    }
}

/// Returns a number below 2²⁴ for a crossing: names on the first and on the second shape.
fn name(kind: u32, one: usize, two: usize) -> u32 {
    let mixed = (one as u32).wrapping_mul(0x9E37_79B1) ^ (two as u32).wrapping_mul(0x85EB_CA77);
    let mixed = (mixed ^ mixed >> 15).wrapping_mul(0x2C1B_3C6D) ^ kind.wrapping_mul(0x27D4_EB2F);
    (mixed ^ mixed >> 13) & 0x00FF_FFFF
}

impl<R: Real> ContactPatch<'_, R> {
    /// Returns the contacts: at most `most`.
    pub fn manifold(&self, found: &Separation, most: usize) -> Manifold<R> {
        let mut deepest = self.deepest(found);
        let mut points = Points::new();
        let capped = matches!(self.one.core, Core::Cylinder(..))
            || matches!(self.two.core, Core::Cylinder(..));
        let strays = self.strays(found);
        if most > 1 || capped || strays {
            let one = feature(&self.one, &V3::zeros(), &self.normal);
            let two = feature(&self.two, &self.between, &-self.normal);
            match (&one, &two) {
                (Feature::Face(p), Feature::Face(q)) => self.faces(p, q, &mut points),
                (Feature::Face(p), Feature::Edge(e)) => self.stretch(p, e, false, &mut points),
                (Feature::Edge(e), Feature::Face(q)) => self.stretch(q, e, true, &mut points),
                (Feature::Edge(e), Feature::Edge(f)) => self.side_by_side(e, f, &mut points),
                _ => {}
            }
            if points.count == 0 {
                if let Some(at) = self.under_cap(&one, &two) {
                    let half = R::of(0.5) * deepest.apart;
                    let under = Point { at: at + self.normal * half, ..deepest };
                    let most = self.outside(&deepest).max(BORDER * self.size);
                    if self.outside(&under) <= most {
                        deepest = under;
                    }
                }
            }
            if strays {
                let low = points.low().map(|low| points.list[low]);
                deepest = self.on_both(deepest, low, [&one, &two]);
            }
        }
        chosen(&mut points, deepest, BORDER * self.size, most)
    }

    /// Returns the place where the cores are nearest or overlap most; if there are several, one of them.
    fn deepest(&self, found: &Separation) -> Point<R> {
        let n = &self.normal;
        let (p, i) = self.one.support(n);
        let (q, k) = self.two.support(&-n);
        let q = self.between + q;
        let half = R::of(0.5);
        let (apart, at) = match found.cause {
            // Two's point; one's surface is as far along the normal everywhere nearby.
            Cause::FaceOne(_) | Cause::EdgeOne(_) => {
                let apart = n.dot(&(q - p));
                (apart, q - n * (half * apart))
            }
            Cause::FaceTwo(_) | Cause::EdgeTwo(_) => {
                let apart = n.dot(&(q - p));
                (apart, p + n * (half * apart))
            }
            Cause::Edges(e, f) => {
                let e = self.one.pose.to_world(&e.map(R::of));
                let f = self.two.pose.to_world(&f.map(R::of));
                let side = f.cross(n);
                let at = p + e * ((q - p).dot(&side) / e.dot(&side));
                let apart = n.dot(&(q - p));
                (apart, at + n * (half * apart))
            }
            Cause::Free => (n.dot(&(q - p)), (p + q) * half),
        };
        Point { apart, at, name: name(0, i, k) }
    }

    /// Checks for a direction that no face or edge gives, as when the corners of a face are even except
    /// for rounding, and each core may return a different corner.
    fn strays(&self, found: &Separation) -> bool {
        if !matches!(found.cause, Cause::Free) {
            return false;
        }
        let n = &self.normal;
        let way = self.between + self.two.support(&-n).0 - self.one.support(n).0;
        let sideways = way - n * n.dot(&way);
        sideways.dot(&sideways).lane(0) > (EVEN * self.size) * (EVEN * self.size)
    }

    /// Returns the candidate for the deepest place, at either core's corner or where faces and edges
    /// overlap, that lies on both cores. If none does, sides of the features may cross there.
    #[inline(never)]
    fn on_both(
        &self,
        deepest: Point<R>,
        low: Option<Point<R>>,
        [one, two]: [&Feature<R>; 2],
    ) -> Point<R> {
        let n = &self.normal;
        let half = n * (R::of(0.5) * deepest.apart);
        let at_one = Point { at: self.one.support(n).0 + half, ..deepest };
        let at_two = Point { at: self.between + self.two.support(&-n).0 - half, ..deepest };
        let rise = |low: &Point<R>| low.apart.lane(0) - deepest.apart.lane(0);
        let even = low.filter(|low| rise(low) < EVEN * self.size);
        let mut best = (self.outside(&deepest), deepest);
        for point in [at_one, at_two].into_iter().chain(even) {
            let outside = self.outside(&point);
            if outside < best.0 {
                best = (outside, point);
            }
        }
        if best.0 > BORDER * self.size {
            best = self.crossing(one, two, &deepest, best);
        }
        best.1
    }

    /// Returns the crossing of the features' sides in the projection along the normal, for faces so
    /// narrow that no corner of one lies over the other, or the best so far, if it lies less outside.
    #[inline(never)]
    fn crossing(
        &self,
        one: &Feature<R>,
        two: &Feature<R>,
        deepest: &Point<R>,
        mut best: (f64, Point<R>),
    ) -> (f64, Point<R>) {
        for [a, b] in sides(one) {
            for [c, d] in sides(two) {
                let (e, f) = (b - a, d - c);
                let (over, under) = (f.cross(&self.normal), e.cross(&self.normal));
                let s = (c - a).dot(&over) / e.dot(&over);
                let t = (a - c).dot(&under) / f.dot(&under);
                let within = |share: R| (share.lane(0) - 0.5).abs() <= 0.5 + EVEN;
                // Parallel sides give NaN or infinity, which is not within.
                if !(within(s) && within(t)) {
                    continue;
                }
                let point = Point { at: (a + e * s + c + f * t) * R::of(0.5), ..*deepest };
                let outside = self.outside(&point);
                if outside < best.0 {
                    best = (outside, point);
                }
            }
        }
        best
    }

    /// Returns the distance of a contact's places on the two cores outside of them.
    #[inline(never)]
    fn outside(&self, point: &Point<R>) -> f64 {
        let plain = |v: V3<R>| v.map(|x| x.lane(0));
        let half = self.normal * (R::of(0.5) * point.apart);
        let on_two = point.at + half - self.between;
        self.one.outside(&plain(point.at - half)).max(self.two.outside(&plain(on_two)))
    }

    /// Returns a contact where the cores pass through p and q on one line along the normal.
    fn contact(&self, p: &V3<R>, q: &V3<R>, name: u32) -> Point<R> {
        let apart = self.normal.dot(&(q - p));
        Point { apart, at: (p + q) * R::of(0.5), name }
    }

    /// Returns the point where a line along the normal through a point meets a face's plane.
    fn onto(&self, point: &V3<R>, face: &Polygon<R>) -> V3<R> {
        let height = (face.offset - face.normal.dot(point)) / face.normal.dot(&self.normal);
        point + self.normal * height
    }

    /// Returns an inward side of a polygon in the projection along the normal: side k runs from corner
    /// k, and is where inward · x = offset.
    fn side(&self, face: &Polygon<R>, k: usize, turn: R) -> (V3<R>, R) {
        let (a, b) = (&face.corners[k].at, &face.corners[(k + 1) % face.count].at);
        let across = self.normal.cross(&(b - a)) * turn;
        let inward = across * across.dot(&across).sqrt().recip_or_zero();
        (inward, inward.dot(a))
    }

    /// Returns 1 if the corners run counter-clockwise about the normal, −1 if clockwise.
    fn turn(&self, face: &Polygon<R>) -> R {
        let mut area = R::zero();
        let first = &face.corners[0].at;
        for k in 1..face.count - 1 {
            let (a, b) = (&face.corners[k].at, &face.corners[k + 1].at);
            area += (a - first).cross(&(b - first)).dot(&self.normal);
        }
        R::of(if area.lane(0) < 0.0 { -1.0 } else { 1.0 })
    }

    /// Returns a point of the first surface where a cap and a face or an edge meet that overlap so
    /// little that the cap's corners miss it: the other one's point nearest to the cap's centre.
    fn under_cap(&self, one: &Feature<R>, two: &Feature<R>) -> Option<V3<R>> {
        let centre = |feature: &Feature<R>| match feature {
            Feature::Face(face) => face.circle.map(|(centre, _)| centre),
            _ => None,
        };
        let (near, other) = match (centre(one), centre(two)) {
            (Some(near), _) => (near, two),
            (_, Some(near)) => (near, one),
            _ => return None,
        };
        let point = self.nearest(other, &near)?;
        let height = |x: &V3<R>| self.normal.dot(x);
        let first = height(&self.one.support(&self.normal).0);
        Some(point + self.normal * (first - height(&point)))
    }

    /// Returns the point of a face or an edge nearest to a point, in the projection along the normal.
    fn nearest(&self, feature: &Feature<R>, to: &V3<R>) -> Option<V3<R>> {
        let flat = |v: V3<R>| v - self.normal * self.normal.dot(&v);
        match feature {
            Feature::Point => None,
            Feature::Edge([a, b]) => Some(on_segment(&flat(a.at), &flat(b.at), &flat(*to))),
            Feature::Face(face) => {
                if let Some((centre, radius)) = face.circle {
                    let way = flat(to - centre);
                    let length = way.dot(&way).sqrt();
                    let share = (radius * length.recip_or_zero()).min(R::one());
                    return Some(flat(centre) + way * share);
                }
                let turn = self.turn(face);
                let mut best: Option<(V3<R>, f64)> = None;
                let mut inside = true;
                for k in 0..face.count {
                    let (inward, offset) = self.side(face, k, turn);
                    inside &= (inward.dot(to) - offset).lane(0) >= 0.0;
                    let (a, b) = (face.corners[k].at, face.corners[(k + 1) % face.count].at);
                    let point = on_segment(&flat(a), &flat(b), &flat(*to));
                    let way = point - flat(*to);
                    let square = way.dot(&way).lane(0);
                    if best.is_none_or(|best| square < best.1) {
                        best = Some((point, square));
                    }
                }
                if inside {
                    Some(flat(*to))
                } else {
                    best.map(|best| best.0)
                }
            }
        }
    }

    /// Finds the overlap of two faces: the second cut by each side of the first (Sutherland and Hodgman
    /// 1974). A corner is named by the sides that cross there.
    #[inline(never)]
    fn faces(&self, one: &Polygon<R>, two: &Polygon<R>, out: &mut Points<R>) {
        /// A corner, and the side that leaves it: of one (true) or two, by its number.
        #[derive(Clone, Copy)]
        struct Cut<R: Real> {
            at: V3<R>,
            side: (bool, usize),
        }
        let border = -BORDER * self.size;
        let blank = Cut { at: V3::zeros(), side: (false, 0) };
        let (mut cut, mut other) = ([blank; ROOM], [blank; ROOM]);
        let (mut list, mut next) = (&mut cut, &mut other);
        for k in 0..two.count {
            list[k] = Cut { at: two.corners[k].at, side: (false, k) };
        }
        let (mut count, mut heights) = (two.count, [R::zero(); ROOM]);
        let turn = self.turn(one);
        for k in 0..one.count {
            let (inward, offset) = self.side(one, k, turn);
            let mut all_inside = true;
            for (cut, height) in list[..count].iter().zip(&mut heights) {
                *height = inward.dot(&cut.at) - offset;
                all_inside &= height.lane(0) >= border;
            }
            if all_inside {
                continue;
            }
            let mut kept = 0;
            let mut push = |cut: Cut<R>| {
                if kept < ROOM {
                    next[kept] = cut;
                    kept += 1;
                }
            };
            for i in 0..count {
                let after = if i + 1 == count { 0 } else { i + 1 };
                let (here, there) = (&list[i], &list[after]);
                let (a, b) = (heights[i], heights[after]);
                let (inside, inside_next) = (a.lane(0) >= border, b.lane(0) >= border);
                if inside {
                    push(*here);
                }
                if inside != inside_next {
                    let at = here.at + (there.at - here.at) * (a / (a - b));
                    // At an exit the new side runs along one's; at an entry, on along two's.
                    push(Cut { at, side: if inside { (true, k) } else { here.side } });
                }
            }
            core::mem::swap(&mut list, &mut next);
            count = kept;
        }
        for i in 0..count {
            let before = list[(i + count - 1) % count].side;
            let after = list[i].side;
            let q = list[i].at;
            let p = self.onto(&q, one);
            // A point of one's border is projected to two's plane.
            let q = self.onto(&q, two);
            let corner = |face: &Polygon<R>, k: usize| face.corners[k].name;
            let label = match (before.0, after.0) {
                (false, false) => name(1, 0, corner(two, after.1)),
                (true, true) => name(2, corner(one, self.shared(one, before.1, after.1)), 0),
                (true, false) => name(3, corner(one, before.1), corner(two, after.1)),
                (false, true) => name(3, corner(one, after.1), corner(two, before.1)),
            };
            out.add(self.contact(&p, &q, label));
        }
    }

    /// Returns the corner between two sides of a polygon.
    fn shared(&self, face: &Polygon<R>, j: usize, k: usize) -> usize {
        if (j + 1) % face.count == k {
            k
        } else {
            j
        }
    }

    /// Finds the part of an edge that lies over a face.
    fn stretch(&self, face: &Polygon<R>, edge: &[Corner<R>; 2], swap: bool, out: &mut Points<R>) {
        let border = -BORDER * self.size;
        let [a, b] = edge;
        let along = b.at - a.at;
        let (mut from, mut to) = ((R::zero(), usize::MAX), (R::one(), usize::MAX));
        if let Some((centre, radius)) = face.circle {
            // The chord: |a + t (b − a) − c|² = r², both ends projected onto the cap's plane.
            let (first, last) = (self.onto(&a.at, face), self.onto(&b.at, face));
            let (way, start) = (last - first, first - centre);
            let (square, foot) = (way.dot(&way), way.dot(&start));
            let inside = radius * radius - start.dot(&start);
            let root = foot * foot + square * inside;
            if root.lane(0) < 0.0 || square.lane(0) == 0.0 {
                return;
            }
            let root = root.sqrt();
            let (first, last) = ((-foot - root) / square, (root - foot) / square);
            if first.lane(0) > 0.0 {
                from = (first, 0);
            }
            if last.lane(0) < 1.0 {
                to = (last, 4);
            }
        }
        let turn = self.turn(face);
        let sides = if face.circle.is_some() { 0 } else { face.count };
        for k in 0..sides {
            let (inward, offset) = self.side(face, k, turn);
            let (start, end) = (inward.dot(&a.at) - offset, inward.dot(&b.at) - offset);
            let (left, right) = (start.lane(0) >= border, end.lane(0) >= border);
            if !left && !right {
                return;
            }
            if left && right {
                continue;
            }
            let share = (start / (start - end)).clamp(R::zero(), R::one());
            if left && share.lane(0) < to.0.lane(0) {
                to = (share, k);
            } else if right && share.lane(0) > from.0.lane(0) {
                from = (share, k);
            }
        }
        if from.0.lane(0) > to.0.lane(0) {
            return;
        }
        for ((share, side), end) in [(from, a), (to, b)] {
            let on = if side == usize::MAX { end.at } else { a.at + along * share };
            let under = self.onto(&on, face);
            let label = if side == usize::MAX {
                name(4, end.name, usize::from(swap))
            } else {
                name(5, face.corners[side].name, usize::from(swap))
            };
            let (p, q) = if swap { (on, under) } else { (under, on) };
            out.add(self.contact(&p, &q, label));
        }
    }

    /// Finds the stretch that two parallel edges have in common.
    fn side_by_side(&self, one: &[Corner<R>; 2], two: &[Corner<R>; 2], out: &mut Points<R>) {
        // In the projection along the normal.
        let flat = |edge: &[Corner<R>; 2]| {
            let along = edge[1].at - edge[0].at;
            along - self.normal * self.normal.dot(&along)
        };
        let (e, f) = (flat(one), flat(two));
        let (ee, ff, cross) = (e.dot(&e), f.dot(&f), e.cross(&f));
        let parallel = cross.dot(&cross).lane(0) <= PARALLEL * PARALLEL * (ee * ff).lane(0);
        if !parallel || ee.lane(0) == 0.0 || ff.lane(0) == 0.0 {
            return;
        }
        let share = |corner: &Corner<R>| (corner.at - one[0].at).dot(&e) / ee;
        let (s, t) = (share(&two[0]), share(&two[1]));
        let (low, high, first, last) =
            if s.lane(0) <= t.lane(0) { (s, t, two[0], two[1]) } else { (t, s, two[1], two[0]) };
        // The later start and the earlier end, each an end of one of the two.
        let (from, a) = if low.lane(0) > 0.0 { (low, first.name + 2) } else { (R::zero(), 0) };
        let (to, b) = if high.lane(0) < 1.0 { (high, last.name + 2) } else { (R::one(), 1) };
        if ((to - from) * ee.sqrt()).lane(0) < -BORDER * self.size {
            return;
        }
        for (share, label) in [(from, a), (to, b)] {
            let p = one[0].at + (one[1].at - one[0].at) * share;
            let q = two[0].at + (two[1].at - two[0].at) * ((p - two[0].at).dot(&f) / ff);
            out.add(self.contact(&p, &q, name(6, label, 0)));
        }
    }
}

/// Returns the sides of a face, or an edge.
fn sides<R: Real>(feature: &Feature<R>) -> impl Iterator<Item = [V3<R>; 2]> + '_ {
    let (corners, count): (&[Corner<R>], usize) = match feature {
        Feature::Point => (&[], 0),
        Feature::Edge(ends) => (ends, 1),
        Feature::Face(face) => (&face.corners[..face.count], face.count),
    };
    (0..count).map(move |k| [corners[k].at, corners[(k + 1) % corners.len()].at])
}

/// Chooses at most `most` of the points: the deepest, and then each time the one furthest from the
/// chosen ones. Points that coincide count once. In the order of the list.
fn chosen<R: Real>(
    points: &mut Points<R>,
    deepest: Point<R>,
    border: f64,
    most: usize,
) -> Manifold<R> {
    let mut out = Manifold { points: [deepest; MOST], count: 1 };
    let square = |p: &Point<R>, q: &Point<R>| {
        let way = p.at - q.at;
        way.dot(&way).lane(0)
    };
    let Some(mut low) = points.low() else { return out };
    // If the deepest place is not a corner, it replaces the nearest corner, which would otherwise carry
    // its load.
    if points.list[low].apart.lane(0) > deepest.apart.lane(0) + border {
        low = 0;
        for i in 1..points.count {
            if square(&points.list[i], &deepest) < square(&points.list[low], &deepest) {
                low = i;
            }
        }
        points.list[low] = Point { name: points.list[low].name, ..deepest };
    }
    // Among places that are even except for rounding, the first.
    let even = points.list[low].apart.lane(0) + border;
    low = (0..low).find(|i| points.list[*i].apart.lane(0) <= even).unwrap_or(low);
    let mut places = [low; MOST];
    let apart = |i: usize, j: usize| square(&points.list[i], &points.list[j]);
    let places = &mut places[..most.min(points.count)];
    out.count = spread::<ROOM>(points.count, places, 1, 4.0 * border * border, apart);
    places[..out.count].sort_unstable();
    for (to, at) in out.points.iter_mut().zip(&places[..out.count]) {
        *to = points.list[*at];
    }
    out
}
