//! Convex hull of points, by quickhull (Barber, Dobkin and Huhdanpaa, "The quickhull algorithm for
//! convex hulls", ACM TOMS 22, 1996), on a grid of integers.
//!
//! Points are rounded to a grid of 2⁴⁰ steps over the largest extent, 1e-12 of it a step. There the
//! side of a plane on which a point lies is an integer of less than 127 bits, so that every decision is
//! exact: the hull is a closed convex surface for any input.

use super::grid::{Plane, Point, NOISE};
use crate::interrupt::{Meter, ROW};
use std::collections::BinaryHeap;

/// A closed surface of triangles: corners counter-clockwise from outside, and the triangle beyond
/// the edge from each corner to the next.
pub(super) struct Surface {
    pub triangles: Vec<[usize; 3]>,
    pub across: Vec<[usize; 3]>,
}

/// The reason why points have no hull with a volume.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Flat {
    Point,
    Line,
    Plane,
}

struct Triangle {
    corners: [usize; 3],
    across: [usize; 3],
    plane: Plane,
    /// Points outside of it that no other triangle has, and the furthest of them.
    outside: Vec<usize>,
    furthest: usize,
    alive: bool,
}

/// A triangle with points outside, by the distance of the furthest.
#[derive(PartialEq)]
struct Waiting {
    distance: f64,
    triangle: usize,
}

impl Eq for Waiting {}

impl PartialOrd for Waiting {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Waiting {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.distance.total_cmp(&other.distance).then(other.triangle.cmp(&self.triangle))
    }
}

/// A hull that grows by one point at a time, the furthest first.
struct Growing<'a> {
    points: &'a [Point],
    triangles: Vec<Triangle>,
    waiting: BinaryHeap<Waiting>,
    /// Triangles that are not replaced.
    alive: usize,
    /// For the point being added: the triangles that see it, the edges around them as (triangle beyond,
    /// its edge), and the new triangle that starts at a vertex.
    seen: Vec<usize>,
    horizon: Vec<(usize, usize)>,
    starts: Vec<usize>,
    /// Of all points together: adding one may take little.
    meter: Meter,
}

/// Computes the hull of `points`, of at most `most` vertices.
pub(super) fn surface(points: &[Point], most: usize) -> Result<Surface, Flat> {
    let first = simplex(points)?;
    let mut hull = Growing {
        points,
        triangles: Vec::new(),
        waiting: BinaryHeap::new(),
        alive: 4,
        seen: Vec::new(),
        horizon: Vec::new(),
        starts: vec![0; points.len()],
        meter: Meter::default(),
    };
    hull.begin(first);
    while hull.vertices() < most {
        let Some(next) = hull.waiting.pop() else { break };
        if hull.triangles[next.triangle].alive {
            hull.add(next.triangle);
        }
    }
    Ok(hull.finish())
}

/// Returns four points of a tetrahedron as large as is easily found: the two ends of the longest axis,
/// the point furthest from their line, and the one furthest from that plane. Its first three corners
/// are counter-clockwise from outside.
fn simplex(points: &[Point]) -> Result<[usize; 4], Flat> {
    let of_axis = |axis: usize| {
        let low = (0..points.len()).min_by_key(|i| points[*i][axis]).unwrap_or(0);
        let high = (0..points.len()).max_by_key(|i| points[*i][axis]).unwrap_or(0);
        (points.get(high).zip(points.get(low)).map_or(0, |(h, l)| h[axis] - l[axis]), low, high)
    };
    let (_, a, b) = (0..3).map(of_axis).max_by_key(|(extent, ..)| *extent).unwrap_or((0, 0, 0));
    if points.is_empty() || points[a] == points[b] {
        return Err(Flat::Point);
    }
    let area = |i: usize| Plane::through(&points[a], &points[b], &points[i]).length();
    let c = furthest(points.len(), area);
    let along = Plane::distance_between(&points[a], &points[b]);
    if area(c) <= NOISE * along {
        return Err(Flat::Line);
    }
    let plane = Plane::through(&points[a], &points[b], &points[c]);
    let d = furthest(points.len(), |i| plane.height(&points[i]).abs());
    if plane.distance(&points[d]).abs() <= NOISE {
        return Err(Flat::Plane);
    }
    Ok(if plane.above(&points[d]) { [a, c, b, d] } else { [a, b, c, d] })
}

/// Returns the first of the indices at which `measure` is largest.
fn furthest(count: usize, measure: impl Fn(usize) -> f64) -> usize {
    let mut best = (0, f64::NEG_INFINITY);
    for i in 0..count {
        let value = measure(i);
        if value > best.1 {
            best = (i, value);
        }
    }
    best.0
}

impl Growing<'_> {
    fn begin(&mut self, [a, b, c, d]: [usize; 4]) {
        // Edge k of a triangle runs from corner k to corner k + 1.
        for (corners, across) in [
            ([a, b, c], [1, 2, 3]),
            ([b, a, d], [0, 3, 2]),
            ([c, b, d], [0, 1, 3]),
            ([a, c, d], [0, 2, 1]),
        ] {
            self.push(corners, across);
        }
        let all: Vec<usize> =
            (0..self.points.len()).filter(|i| ![a, b, c, d].contains(i)).collect();
        self.share(&all, 0);
        (0..4).for_each(|triangle| self.wait(triangle));
    }

    fn push(&mut self, corners: [usize; 3], across: [usize; 3]) {
        let [a, b, c] = corners.map(|i| &self.points[i]);
        let plane = Plane::through(a, b, c);
        let outside = Vec::new();
        self.triangles.push(Triangle { corners, across, plane, outside, furthest: 0, alive: true });
    }

    /// Gives each of these points to the first triangle from `from` on that it is outside of.
    fn share(&mut self, points: &[usize], from: usize) {
        for &point in points {
            self.meter.count(self.triangles.len() - from);
            let place = &self.points[point];
            let holder = self.triangles[from..].iter_mut().find(|t| t.plane.beyond_noise(place));
            if let Some(triangle) = holder {
                triangle.outside.push(point);
            }
        }
    }

    /// Queues a triangle if there are points outside of it.
    fn wait(&mut self, triangle: usize) {
        let Triangle { outside, plane, .. } = &self.triangles[triangle];
        if outside.is_empty() {
            return;
        }
        let at = furthest(outside.len(), |i| plane.height(&self.points[outside[i]]));
        let distance = plane.distance(&self.points[outside[at]]);
        self.triangles[triangle].furthest = outside[at];
        self.waiting.push(Waiting { distance, triangle });
    }

    /// Adds the furthest point of a triangle: a cone from it to the horizon replaces what it sees.
    fn add(&mut self, triangle: usize) {
        let apex = self.triangles[triangle].furthest;
        self.look(triangle, apex);
        let from = self.triangles.len();
        for at in 0..self.horizon.len() {
            let (beyond, edge) = self.horizon[at];
            let corners = self.triangles[beyond].corners;
            // The edge beyond runs from its corner to the next; the new triangle's the other way.
            let (start, end) = (corners[(edge + 1) % 3], corners[edge]);
            let new = self.triangles.len();
            self.push([start, end, apex], [beyond, 0, 0]);
            self.triangles[beyond].across[edge] = new;
            self.starts[start] = new;
        }
        for new in from..self.triangles.len() {
            let next = self.starts[self.triangles[new].corners[1]];
            self.triangles[new].across[1] = next;
            self.triangles[next].across[2] = new;
        }
        self.alive += self.horizon.len();
        self.alive -= self.seen.len();
        for at in 0..self.seen.len() {
            let gone = std::mem::take(&mut self.triangles[self.seen[at]].outside);
            let rest: Vec<usize> = gone.into_iter().filter(|point| *point != apex).collect();
            self.share(&rest, from);
        }
        (from..self.triangles.len()).for_each(|new| self.wait(new));
    }

    /// Returns the number of vertices: n/2 + 2 on a closed surface of n triangles (Euler). Adding a
    /// point can remove other vertices.
    fn vertices(&self) -> usize {
        self.alive / 2 + 2
    }

    /// Finds the triangles that see the point, and the edges around them.
    fn look(&mut self, triangle: usize, apex: usize) {
        self.seen.clear();
        self.horizon.clear();
        self.seen.push(triangle);
        self.triangles[triangle].alive = false;
        let mut at = 0;
        while at < self.seen.len() {
            self.meter.count(ROW);
            let here = self.seen[at];
            for edge in 0..3 {
                let beyond = self.triangles[here].across[edge];
                if !self.triangles[beyond].alive {
                    continue;
                }
                if self.triangles[beyond].plane.above(&self.points[apex]) {
                    self.triangles[beyond].alive = false;
                    self.seen.push(beyond);
                } else {
                    // Its edge back: it starts where this one ends.
                    let end = self.triangles[here].corners[(edge + 1) % 3];
                    let corners = &self.triangles[beyond].corners;
                    let back = (0..3).find(|k| corners[*k] == end).unwrap_or(0);
                    self.horizon.push((beyond, back));
                }
            }
            at += 1;
        }
    }

    /// Returns the remaining triangles, renumbered.
    fn finish(self) -> Surface {
        let mut number = vec![0; self.triangles.len()];
        let alive = || self.triangles.iter().enumerate().filter(|(_, t)| t.alive);
        for (new, (old, _)) in alive().enumerate() {
            number[old] = new;
        }
        Surface {
            triangles: alive().map(|(_, t)| t.corners).collect(),
            across: alive().map(|(_, t)| t.across.map(|beyond| number[beyond])).collect(),
        }
    }
}
