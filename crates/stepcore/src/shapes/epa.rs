//! The way out of a convex set that holds the origin: the expanding polytope (van den Bergen 2001).
//!
//! A polytope inside the set grows towards the set's surface: its face nearest to the origin is
//! pushed out to the set's furthest point along the face's normal. The set reaches at least as far
//! as each face and, along that normal, exactly as far as the furthest point.

use super::separation::across_both;
use crate::spatial::V3;

/// No place in a list: lists hold fewer.
const NONE: u16 = u16::MAX;
/// Height above a face, over the size, that is only rounding.
const FLAT: f64 = 1e-13;

/// Points from which the first four are taken: of a simplex, along axes, and beside those twice.
const SEEDS: usize = 4 + 6 + 2 * 4;

/// One triangle, counter-clockwise from outside.
#[derive(Clone, Copy)]
struct Face {
    corners: [u16; 3],
    /// Across the edge from corner k to the next.
    across: [u16; 3],
    normal: V3<f64>,
    /// From the origin along the normal; infinite where the triangle has no area.
    height: f64,
    alive: bool,
    /// Nothing lies beyond it but rounding.
    done: bool,
}

/// The polytope as grown so far, with room for so many points, and twice as many faces.
pub struct Polytope<const POINTS: usize, const FACES: usize> {
    points: [V3<f64>; POINTS],
    npoint: usize,
    faces: [Face; FACES],
    nface: usize,
    size: f64,
    /// The last push found nothing more, or no room for it.
    pub stuck: bool,
    /// A push found no room.
    pub full: bool,
    /// The direction of the shortest way out that was seen.
    pub best: V3<f64>,
    least: f64,
}

/// A face, and the set's reach along its normal.
pub struct Way {
    pub normal: V3<f64>,
    /// Of the face: no way out that passes through it is shorter.
    pub height: f64,
    /// Of the set along this normal: a way out.
    pub reach: f64,
}

impl<const POINTS: usize, const FACES: usize> Polytope<POINTS, FACES> {
    /// A tetrahedron of points of the set, or None where the set is flat.
    pub fn new(support: &impl Fn(&V3<f64>) -> V3<f64>, simplex: &[V3<f64>]) -> Option<Self> {
        let mut seeds = [V3::zeros(); SEEDS];
        seeds[..simplex.len()].copy_from_slice(simplex);
        let mut count = simplex.len();
        let mut corners = spread(&seeds[..count]);
        if corners.is_none() {
            for axis in 0..3 {
                for side in [1.0, -1.0] {
                    let mut way = V3::zeros();
                    way[axis] = side;
                    seeds[count] = support(&way);
                    count += 1;
                }
            }
            corners = spread(&seeds[..count]);
        }
        // Two crossed needles: what was seen lies in one plane or on one line, the set does not.
        for _ in 0..2 {
            if corners.is_none() {
                for way in beside(&seeds[..count])? {
                    seeds[count] = support(&way);
                    count += 1;
                }
                corners = spread(&seeds[..count]);
            }
        }
        let [a, b, c, d] = corners?;
        let blank = Face {
            corners: [0; 3],
            across: [0; 3],
            normal: V3::zeros(),
            height: 0.0,
            alive: false,
            done: false,
        };
        let mut new = Self {
            points: [V3::zeros(); POINTS],
            npoint: 4,
            faces: [blank; FACES],
            nface: 4,
            size: 0.0,
            stuck: false,
            full: false,
            best: V3::x(),
            least: f64::INFINITY,
        };
        new.points[..4].copy_from_slice(&[a, b, c, d]);
        new.size = [a, b, c, d].iter().map(|p| p.dot(p).sqrt()).fold(0.0, f64::max);
        // Counter-clockwise, d above the triangle a b c seen from d.
        let up = (b - a).cross(&(c - a)).dot(&(d - a)) > 0.0;
        let lists = if up {
            [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
        } else {
            [[0, 1, 2], [1, 0, 3], [2, 1, 3], [0, 2, 3]]
        };
        for (i, list) in lists.iter().enumerate() {
            new.faces[i] = new.face(*list);
        }
        for i in 0..4 {
            for k in 0..3 {
                let edge = (lists[i][(k + 1) % 3], lists[i][k]);
                let other =
                    |j: &usize| (0..3).any(|m| (lists[*j][m], lists[*j][(m + 1) % 3]) == edge);
                new.faces[i].across[k] = (0..4).find(other)? as u16;
            }
        }
        Some(new)
    }

    fn face(&self, corners: [u16; 3]) -> Face {
        let [a, b, c] = corners.map(|i| self.points[usize::from(i)]);
        let (ab, ac, bc) = (b - a, c - a, c - b);
        let cross = ab.cross(&ac);
        let length = cross.dot(&cross).sqrt();
        let longest = ab.dot(&ab).max(ac.dot(&ac)).max(bc.dot(&bc));
        let sliver = length <= FLAT * longest;
        let normal = if sliver { V3::zeros() } else { cross * (1.0 / length) };
        let height = if sliver {
            f64::INFINITY
        } else {
            normal.dot(&a).max(normal.dot(&b)).max(normal.dot(&c))
        };
        Face { corners, across: [0; 3], normal, height, alive: true, done: sliver }
    }

    /// The lowest face that `skip` does not leave out; None: all are done.
    pub fn lowest(&self, skip: impl Fn(&V3<f64>, f64) -> bool) -> Option<usize> {
        let mut best: Option<usize> = None;
        for (i, face) in self.faces[..self.nface].iter().enumerate() {
            let lower = best.is_none_or(|b| face.height < self.faces[b].height);
            if face.alive && !face.done && lower && !skip(&face.normal, face.height) {
                best = Some(i);
            }
        }
        best
    }

    /// How far the set reaches beyond a face; the polytope grows there, if there is room.
    pub fn push(&mut self, face: usize, support: &impl Fn(&V3<f64>) -> V3<f64>) -> Way {
        self.push_beyond(face, 0.0, support)
    }

    /// The same; it grows only where the set reaches further beyond the face than `close`.
    pub fn push_beyond(
        &mut self,
        face: usize,
        close: f64,
        support: &impl Fn(&V3<f64>) -> V3<f64>,
    ) -> Way {
        let Face { normal, height, .. } = self.faces[face];
        let w = support(&normal);
        let reach = normal.dot(&w);
        if reach < self.least {
            (self.least, self.best) = (reach, normal);
        }
        let grown = reach - height > close.max(FLAT * self.size) && self.grow(face, w);
        self.stuck = !grown;
        if !grown {
            self.faces[face].done = true;
        }
        Way { normal, height, reach }
    }

    /// Room for another point and the faces around it.
    fn room(&self, edges: usize) -> bool {
        self.npoint < POINTS && self.nface + edges <= FACES
    }

    /// Takes away what the new point sees and joins the rim to it.
    fn grow(&mut self, seed: usize, w: V3<f64>) -> bool {
        let mut seen = [false; FACES];
        let mut stack = [0_u16; FACES];
        let mut waiting = 1;
        stack[0] = seed as u16;
        seen[seed] = true;
        // Edges of the rim: the face outside, and which of its edges.
        let mut rim = [(0_u16, 0_u16); FACES];
        let mut edges = 0;
        while waiting > 0 {
            waiting -= 1;
            let here = usize::from(stack[waiting]);
            for other in self.faces[here].across {
                let face = &self.faces[usize::from(other)];
                let over = face.normal.dot(&w) - face.height > FLAT * self.size;
                if over && !seen[usize::from(other)] {
                    seen[usize::from(other)] = true;
                    stack[waiting] = other;
                    waiting += 1;
                }
            }
        }
        for here in (0..self.nface).filter(|i| seen[*i]) {
            let Face { across, corners, .. } = self.faces[here];
            for k in 0..3 {
                let face = &self.faces[usize::from(across[k])];
                if seen[usize::from(across[k])] {
                    continue;
                }
                let from = corners[(k + 1) % 3];
                let Some(back) = (0..3)
                    .find(|m| usize::from(face.across[*m]) == here && face.corners[*m] == from)
                else {
                    return false;
                };
                if edges == FACES {
                    self.full = true;
                    return false;
                }
                rim[edges] = (across[k], back as u16);
                edges += 1;
            }
        }
        if !self.room(edges) {
            self.full = true;
            return false;
        }
        // The rim must be one closed loop: each corner leaves once and arrives once.
        let rim = &rim[..edges];
        // Seen from inside the rim an edge runs the other way.
        let ends = |faces: &[Face; FACES], (face, k): (u16, u16)| {
            let corners = &faces[usize::from(face)].corners;
            (corners[(usize::from(k) + 1) % 3], corners[usize::from(k)])
        };
        let mut next = [NONE; POINTS];
        for (i, edge) in rim.iter().enumerate() {
            let from = usize::from(ends(&self.faces, *edge).0);
            if next[from] != NONE {
                return false;
            }
            next[from] = i as u16;
        }
        if rim.iter().any(|edge| next[usize::from(ends(&self.faces, *edge).1)] == NONE) {
            return false;
        }
        let point = self.npoint;
        self.points[point] = w;
        self.npoint += 1;
        self.size = self.size.max(w.dot(&w).sqrt());
        let first = self.nface;
        for (i, edge) in rim.iter().enumerate() {
            let (from, to) = ends(&self.faces, *edge);
            let mut face = self.face([from, to, point as u16]);
            face.across = [edge.0, first as u16 + next[usize::from(to)], 0];
            self.faces[first + i] = face;
        }
        for (i, edge) in rim.iter().enumerate() {
            self.faces[usize::from(edge.0)].across[usize::from(edge.1)] = (first + i) as u16;
            let after = self.faces[first + i].across[1];
            self.faces[usize::from(after)].across[2] = (first + i) as u16;
        }
        self.nface += edges;
        for here in 0..first {
            if seen[here] {
                self.faces[here].alive = false;
            }
        }
        self.compact();
        true
    }

    /// Closes the gaps that dead faces left.
    fn compact(&mut self) {
        let mut to = [NONE; FACES];
        let mut kept = 0;
        for from in 0..self.nface {
            if self.faces[from].alive {
                to[from] = kept as u16;
                self.faces[kept] = self.faces[from];
                kept += 1;
            }
        }
        self.nface = kept;
        for face in &mut self.faces[..kept] {
            face.across = face.across.map(|i| to[usize::from(i)]);
        }
    }
}

/// The first of the points, the one furthest from it, and the one furthest from their line; with
/// the square of their distance, and of twice the area of their triangle.
fn base(points: &[V3<f64>]) -> Option<([V3<f64>; 3], f64, f64)> {
    let a = *points.first()?;
    let (length, b) = furthest(points, |p| (p - a).dot(&(p - a)));
    let ab = b - a;
    let (area, c) = furthest(points, |p| ab.cross(&(p - a)).dot(&ab.cross(&(p - a))));
    Some(([a, b, c], length, area))
}

fn furthest(points: &[V3<f64>], measure: impl Fn(&V3<f64>) -> f64) -> (f64, V3<f64>) {
    points.iter().fold((0.0, points[0]), |best, p| {
        let value = measure(p);
        if value > best.0 {
            (value, *p)
        } else {
            best
        }
    })
}

/// Four of the points that span a volume.
fn spread(points: &[V3<f64>]) -> Option<[V3<f64>; 4]> {
    let ([a, b, c], length, area) = base(points)?;
    let normal = (b - a).cross(&(c - a));
    let (volume, d) = furthest(points, |p| normal.dot(&(p - a)).abs());
    // Height over the base, and width over the length.
    let flat = area <= FLAT * length * length || volume <= FLAT * area.sqrt() * length.sqrt();
    (!flat).then_some([a, b, c, d])
}

/// Four directions across the plane or the line in which points lie.
fn beside(points: &[V3<f64>]) -> Option<[V3<f64>; 4]> {
    let ([a, b, c], length, area) = base(points)?;
    if length == 0.0 {
        return None;
    }
    let along = (b - a) * (1.0 / length.sqrt());
    let (t, u) = if area > FLAT * length * length {
        let normal = (b - a).cross(&(c - a)) * (1.0 / area.sqrt());
        (normal, along.cross(&normal))
    } else {
        across_both(&along)
    };
    Some([t, -t, u, -u])
}
