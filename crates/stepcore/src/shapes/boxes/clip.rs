//! The face of a box clipped to a face of another: Sutherland and Hodgman (1974).
//!
//! In the axes of the box whose face bounds (the bed) the other box's face is a rectangle. Its corners
//! and cut edges above the bed are the contacts.

use super::super::touch::Touch;
use super::axes::Axes;
use super::{corner_feature, edge, edges_feature, others, Block, Side, MOST};
use crate::real::{Mask, Real};
use crate::spatial::V3;

/// Capacity for a polygon: a quadrangle gains a corner at each of four cuts.
const ROOM: usize = 12;
/// Part of the smallest half length: a cut edge this near to a corner has the corner's name, so that
/// names stay while equal boxes lie on each other.
const SAME_CORNER: f64 = 1e-3;

/// Distance, as such a part, within which two points are one, and a point lies on a line: rounding that
/// turns equal boxes against each other cuts each corner and each side once more than without it.
const NEARBY: f64 = 1e-6;

/// Corners of a face, in cyclic order: signs along the two axes after the face's.
const CORNERS: [[bool; 2]; 4] = [[true, true], [false, true], [false, false], [true, false]];

/// The bound of a polygon between one corner and the next: an edge of the lying face, by its first
/// corner, or a side of the bed, along one of the two axes after the bed's.
#[derive(Clone, Copy)]
enum Bound {
    Lying(usize),
    Bed { axis: usize, positive: bool },
}

#[derive(Clone, Copy)]
struct Vertex<R: Real> {
    /// In the bed's axes, from its centre.
    at: V3<R>,
    /// Along the lying face's two axes, from its middle.
    lying: [f64; 2],
    next: Bound,
}

struct Polygon<R: Real> {
    vertices: [Vertex<R>; ROOM],
    count: usize,
}

impl<R: Real> Polygon<R> {
    fn empty() -> Self {
        let nowhere = Vertex { at: V3::zeros(), lying: [0.0; 2], next: Bound::Lying(0) };
        Self { vertices: [nowhere; ROOM], count: 0 }
    }

    fn push(&mut self, vertex: Vertex<R>) {
        if self.count < ROOM {
            self.vertices[self.count] = vertex;
            self.count += 1;
        }
    }

    /// Returns the vertices that count: all distinct, none on the line between its neighbours.
    fn corners(&self, near: f64) -> impl Iterator<Item = usize> {
        let mut kept = [0; ROOM];
        let mut count = 0;
        let at = |k: usize| self.vertices[k].at.map(|x| x.lane(0));
        for k in 0..self.count {
            if kept[..count].iter().all(|other| (at(k) - at(*other)).amax() > near) {
                kept[count] = k;
                count += 1;
            }
        }
        let mut k = 0;
        while count > 2 && k < count {
            let [before, here, after] =
                [(k + count - 1) % count, k, (k + 1) % count].map(|k| at(kept[k]));
            let (along, off) = (after - before, here - before);
            let between = off.dot(&along) > 0.0 && off.norm() < along.norm();
            if between && off.cross(&along).norm() <= near * along.norm() {
                kept.copy_within(k + 1..count, k);
                count -= 1;
            } else {
                k += 1;
            }
        }
        kept.into_iter().take(count)
    }

    /// Keeps the part inside one side of the bed.
    fn cut(&mut self, axis: usize, positive: bool, half: R) {
        let over = |v: &Vertex<R>| if positive { v.at[axis] - half } else { -v.at[axis] - half };
        if self.vertices[..self.count].iter().all(|vertex| over(vertex).lane(0) <= 0.0) {
            return;
        }
        let mut inside = Self::empty();
        let side = Bound::Bed { axis, positive };
        for k in 0..self.count {
            let (here, next) = (&self.vertices[k], &self.vertices[(k + 1) % self.count]);
            let (d, e) = (over(here), over(next));
            let (out, leaves, enters) = (d.lane(0) > 0.0, e.lane(0) > 0.0, e.lane(0) < 0.0);
            let crossing = |bound| {
                let share = d / (d - e);
                let plain = share.lane(0);
                let lying = [0, 1].map(|i| here.lying[i] + (next.lying[i] - here.lying[i]) * plain);
                Vertex { at: here.at + (next.at - here.at) * share, lying, next: bound }
            };
            if out {
                if enters {
                    inside.push(crossing(here.next));
                }
            } else if leaves && d.lane(0) < 0.0 {
                inside.push(*here);
                inside.push(crossing(side));
            } else {
                inside.push(Vertex { next: if leaves { side } else { here.next }, ..*here });
            }
        }
        *self = inside;
    }
}

/// Adds the contacts of the best face with the face that lies on it to `out`, positions from the first
/// box's centre.
pub(super) fn contacts<R: Real>(
    a: &Block<R>,
    b: &Block<R>,
    axes: &Axes<R>,
    out: &mut [Touch<R>; MOST],
) {
    let face = &axes.face;
    let first = face.side == Side::First;
    let (bed, lying) = if first { (a, b) } else { (b, a) };
    // Cosine of a lying axis k along the bed's axis i.
    let cosine = |i: usize, k: usize| if first { axes.cosines[i][k] } else { axes.cosines[k][i] };
    let up = face.axis;
    // Out of the bed, towards the lying box.
    let above = face.positive == first;
    let steepness = |k: usize| cosine(up, k).lane(0).abs();
    let down = (1..3).fold(0, |best, k| if steepness(k) > steepness(best) { k } else { best });
    let faces_down = (cosine(up, down).lane(0) < 0.0) == above;

    let [u, v] = others(down);
    let along = |k: usize, positive: bool| {
        let half = if positive { lying.half[k] } else { -lying.half[k] };
        V3::new(cosine(0, k), cosine(1, k), cosine(2, k)) * half
    };
    let between = lying.centre - bed.centre;
    let middle =
        V3::new(bed.axes[0].dot(&between), bed.axes[1].dot(&between), bed.axes[2].dot(&between))
            + along(down, faces_down);
    let mut polygon = Polygon::empty();
    for (k, [p, q]) in CORNERS.into_iter().enumerate() {
        let at = middle + along(u, p) + along(v, q);
        let signed = |k: usize, positive| {
            let half = lying.half[k].lane(0);
            if positive {
                half
            } else {
                -half
            }
        };
        polygon.push(Vertex { at, lying: [signed(u, p), signed(v, q)], next: Bound::Lying(k) });
    }
    for axis in others(up) {
        for positive in [true, false] {
            polygon.cut(axis, positive, bed.half[axis]);
        }
    }

    let outward = if above { R::one() } else { -R::one() };
    let to_second = bed.axes[up] * if face.positive { R::one() } else { -R::one() };
    let names = Names { bed, lying, first, up, above, down, faces_down };
    let near = NEARBY * names.smallest();
    let (mut used, mut count) = ([usize::MAX; MOST], 0);
    for k in polygon.corners(near) {
        if count == MOST {
            break;
        }
        let vertex = &polygon.vertices[k];
        let before = polygon.vertices[(k + polygon.count - 1) % polygon.count].next;
        let dist = vertex.at[up] * outward - bed.half[up];
        let mut at = vertex.at;
        at[up] -= outward * (R::of(0.5) * dist);
        used[count] = names.of(vertex, before, &used[..count]);
        out[count] = Touch {
            dist,
            pos: bed.centre + bed.axes[0] * at.x + bed.axes[1] * at.y + bed.axes[2] * at.z,
            normal: to_second,
            exists: R::Mask::of(true),
            feature: R::of(used[count] as f64),
        };
        count += 1;
    }
}

/// The data for naming the contacts of two faces.
struct Names<'a, R: Real> {
    bed: &'a Block<R>,
    lying: &'a Block<R>,
    /// The bed is the first box.
    first: bool,
    up: usize,
    above: bool,
    down: usize,
    faces_down: bool,
}

impl<R: Real> Names<'_, R> {
    /// Returns the feature of a vertex between two bounds: the first unused name. Corners come first,
    /// so that boxes of equal faces keep four names whichever of them counts as the bed.
    fn of(&self, vertex: &Vertex<R>, before: Bound, used: &[usize]) -> usize {
        let (bed_side, lying_side) =
            if self.first { (Side::First, Side::Second) } else { (Side::Second, Side::First) };
        let place = |k: usize| vertex.at[k].lane(0);
        let near = SAME_CORNER * self.smallest();
        let [p, q] = others(self.up);
        let [u, v] = others(self.down);
        let bed = corner_at(self.bed, [p, q], [place(p), place(q)], near);
        let lying = corner_at(self.lying, [u, v], vertex.lying, near);
        let bed = bed.map(|corner| corner_feature(bed_side, corner | bit(self.up, self.above)));
        let lying = lying
            .map(|corner| corner_feature(lying_side, corner | bit(self.down, self.faces_down)));
        let own = self.edges(vertex, before);
        let corners = if self.first { [bed, lying] } else { [lying, bed] };
        let names = corners.into_iter().flatten().chain(own);
        // No more names than this are requested.
        let spare = edges_feature(12, used.len());
        names.into_iter().find(|name| !used.contains(name)).unwrap_or(spare)
    }

    /// Returns the smallest half length of both boxes [m].
    fn smallest(&self) -> f64 {
        let halves = self.bed.half.iter().chain(&self.lying.half);
        halves.map(|half| half.lane(0)).fold(f64::INFINITY, f64::min)
    }

    /// Returns the edges that cross in a vertex where an edge of the lying face meets a side of the bed.
    fn edges(&self, vertex: &Vertex<R>, before: Bound) -> Option<usize> {
        let (corner, (axis, positive)) = match (before, vertex.next) {
            (Bound::Lying(k), Bound::Bed { axis, positive })
            | (Bound::Bed { axis, positive }, Bound::Lying(k)) => (k, (axis, positive)),
            _ => return None,
        };
        // The edge from a corner with two equal signs to the next runs along the face's first axis.
        let [u, v] = others(self.down);
        let [p, q] = CORNERS[corner];
        let (runs, fixed, sign) = if p == q { (u, v, q) } else { (v, u, p) };
        let lying = numbered(runs, [(fixed, sign), (self.down, self.faces_down)]);
        let runs = 3 - self.up - axis;
        let bed = numbered(runs, [(axis, positive), (self.up, self.above)]);
        Some(if self.first { edges_feature(bed, lying) } else { edges_feature(lying, bed) })
    }
}

/// Returns the number of the edge along axis k, given the signs of the others with their axes.
fn numbered(k: usize, signs: [(usize, bool); 2]) -> usize {
    edge(k, others(k).map(|axis| if signs[0].0 == axis { signs[0].1 } else { signs[1].1 }))
}

fn bit(axis: usize, positive: bool) -> usize {
    usize::from(positive) << axis
}

/// Returns the corner of a face at this place along two of a box's axes, if there is one.
fn corner_at<R: Real>(
    block: &Block<R>,
    axes: [usize; 2],
    place: [f64; 2],
    near: f64,
) -> Option<usize> {
    let off = |k: usize| (place[k].abs() - block.half[axes[k]].lane(0)).abs();
    let there = off(0) <= near && off(1) <= near;
    there.then(|| bit(axes[0], place[0] > 0.0) | bit(axes[1], place[1] > 0.0))
}
