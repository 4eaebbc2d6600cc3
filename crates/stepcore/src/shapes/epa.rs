//! The way out of a convex set that holds the origin: the expanding polytope (van den Bergen 2001).
//!
//! A polytope inside the set grows towards the set's surface: its face nearest to the origin is
//! pushed out to the set's furthest point along the face's normal. The set reaches at least as far
//! as each face and, along that normal, exactly as far as the furthest point.

use super::gjk::Vertex;
use super::hint::Shell;
use super::separation::across_both;
use crate::spatial::V3;

/// No place in a list: lists hold fewer.
const NONE: u16 = u16::MAX;
/// Height above a face, over the size, that is only rounding.
const FLAT: f64 = 1e-13;
/// Sine of the tilt of a direction: a face over a surface that bends by it is lower by 4e-6.
const LEAN: f64 = 6e-3;
/// Cosine of the angle up to which a face is next to a direction.
const BESIDE: f64 = 0.5;

/// Points from which the first four are taken: of a simplex, along axes, and twice next to these.
const SEEDS: usize = 4 + 6 + 2 * 4;

/// One triangle, counter-clockwise from outside.
#[derive(Clone, Copy)]
struct Face {
    corners: [u16; 3],
    /// The faces across the edge from corner k to the next.
    across: [u16; 3],
    normal: V3<f64>,
    /// From the origin along the normal; infinite if the triangle has no area.
    height: f64,
    /// Only rounding lies beyond it.
    done: bool,
}

/// The polytope at its present size. Its lists are used again for the next one.
#[derive(Default)]
pub struct Polytope {
    points: Vec<Vertex>,
    faces: Vec<Face>,
    /// Capacity for this many points, and twice as many faces.
    most: usize,
    size: f64,
    /// The last push found nothing more, or no room for it.
    pub stuck: bool,
    /// A push found no room.
    pub full: bool,
    /// It has more points than at the start.
    pub grown: bool,
    /// A push found faces that do not fit around the visible ones.
    pub torn: bool,
    /// The direction of the shortest way out so far.
    pub best: V3<f64>,
    least: f64,
    growth: Growth,
}

/// The lists of one growth of the polytope.
#[derive(Default)]
struct Growth {
    /// By face: whether the new point sees it; and the faces that it sees.
    seen: Vec<bool>,
    visible: Vec<u16>,
    /// Edges of the rim: the face outside, and the number of its edge.
    rim: Vec<(u16, u16)>,
    /// By point the rim's edge that leaves it.
    places: Vec<u16>,
}

/// A face, and the set's reach along its normal.
pub struct Way {
    pub normal: V3<f64>,
    /// Reach of the set along this normal: a way out.
    pub reach: f64,
}

impl Polytope {
    /// Starts with a tetrahedron of points of the set; returns false if the set is flat.
    pub fn start(
        &mut self,
        support: &impl Fn(&V3<f64>) -> Vertex,
        simplex: &[Vertex],
        most: usize,
    ) -> bool {
        let Some(corners) = tetrahedron(support, simplex) else { return false };
        self.begin(corners.into_iter(), most);
        let [a, b, c, d] = corners.map(|corner| corner.at);
        // Counter-clockwise, d above the triangle a b c seen from d; across edges the other faces.
        let up = (b - a).cross(&(c - a)).dot(&(d - a)) > 0.0;
        let lists = if up {
            [
                ([0, 2, 1], [3, 2, 1]),
                ([0, 1, 3], [0, 2, 3]),
                ([1, 2, 3], [0, 3, 1]),
                ([2, 0, 3], [0, 1, 2]),
            ]
        } else {
            [
                ([0, 1, 2], [1, 2, 3]),
                ([1, 0, 3], [0, 3, 2]),
                ([2, 1, 3], [0, 1, 3]),
                ([0, 2, 3], [0, 2, 1]),
            ]
        };
        lists.into_iter().for_each(|(corners, across)| self.add(corners, across));
        true
    }

    /// Starts with a shell whose corners are now at `at`; returns false if the origin is no longer
    /// inside of each of its faces.
    pub fn start_from(
        &mut self,
        shell: &Shell,
        at: &impl Fn([u32; 2]) -> V3<f64>,
        most: usize,
    ) -> bool {
        let corner = |&pieces: &[u32; 2]| Vertex { at: at(pieces), pieces };
        self.begin(shell.corners.iter().map(corner), most);
        shell.faces.iter().for_each(|[corners, across]| self.add(*corners, *across));
        self.faces.iter().all(|face| face.height > 0.0)
    }

    fn begin(&mut self, points: impl Iterator<Item = Vertex>, most: usize) {
        self.points.clear();
        self.points.extend(points);
        self.faces.clear();
        self.size = self.points.iter().map(|p| p.at.dot(&p.at)).fold(0.0, f64::max).sqrt();
        (self.most, self.stuck, self.full, self.grown, self.torn) =
            (most, false, false, false, false);
        (self.best, self.least) = (V3::x(), f64::INFINITY);
    }

    fn add(&mut self, corners: [u16; 3], across: [u16; 3]) {
        let face = Face { across, ..self.face(corners) };
        self.faces.push(face);
    }

    /// Writes its surface, of corners that faces have; nothing if these are more than `most`.
    pub fn keep(&mut self, shell: &mut Shell, most: usize) {
        let places = &mut self.growth.places;
        places.clear();
        places.resize(self.points.len(), NONE);
        shell.clear();
        // The Euler formula for a closed surface of triangles.
        if self.faces.len() / 2 + 2 > most {
            return;
        }
        for face in &self.faces {
            let corners = face.corners.map(|corner| {
                let place = &mut places[usize::from(corner)];
                if *place == NONE {
                    *place = shell.corners.len() as u16;
                    shell.corners.push(self.points[usize::from(corner)].pieces);
                }
                *place
            });
            shell.faces.push([corners, face.across]);
        }
    }

    fn face(&self, corners: [u16; 3]) -> Face {
        let [a, b, c] = corners.map(|i| self.points[usize::from(i)].at);
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
        Face { corners, across: [0; 3], normal, height, done: sliver }
    }

    /// Returns the lowest face below a height, and the face's height; None: all are done.
    pub fn lowest(&self, below: f64) -> Option<(usize, f64)> {
        let mut best: Option<(usize, f64)> = None;
        for (i, face) in self.faces.iter().enumerate() {
            if !face.done && face.height < best.map_or(below, |best| best.1) {
                best = Some((i, face.height));
            }
        }
        best
    }

    /// Returns the set's reach beyond a face. If it is further than `close` the polytope grows there,
    /// if there is room.
    pub fn push(&mut self, face: usize, close: f64, support: &impl Fn(&V3<f64>) -> Vertex) -> Way {
        let Face { normal, height, .. } = self.faces[face];
        let w = support(&normal);
        let reach = normal.dot(&w.at);
        if reach < self.least {
            (self.least, self.best) = (reach, normal);
        }
        let grown = reach - height > close.max(FLAT * self.size) && self.grow(face, w);
        self.stuck = !grown;
        if !grown {
            self.faces[face].done = true;
        }
        Way { normal, reach }
    }

    /// Grows over a face with the set's furthest point along a direction, or along one that leans from
    /// it a little towards the face; returns false if neither lies beyond the face.
    pub fn grow_beside(
        &mut self,
        face: usize,
        way: &V3<f64>,
        support: &impl Fn(&V3<f64>) -> Vertex,
    ) -> bool {
        let Face { normal, height, .. } = self.faces[face];
        let along = normal.dot(way);
        let sideways = normal - way * along;
        let far = sideways.dot(&sideways).sqrt();
        if along < BESIDE || far <= 2.0 * LEAN {
            return false;
        }
        [*way, way + sideways * (LEAN / far)].iter().any(|way| {
            let w = support(way);
            normal.dot(&w.at) - height > FLAT * self.size && self.grow(face, w)
        })
    }

    /// Removes the faces that the new point sees and joins the rim to it.
    fn grow(&mut self, seed: usize, w: Vertex) -> bool {
        self.see(seed, &w.at);
        if !self.find_rim() {
            self.torn = true;
            return false;
        }
        let edges = self.growth.rim.len();
        if self.points.len() >= self.most || self.faces.len() + edges > 2 * self.most {
            self.full = true;
            return false;
        }
        if !self.close_rim() {
            self.torn = true;
            return false;
        }
        let point = self.points.len() as u16;
        self.points.push(w);
        self.grown = true;
        self.size = self.size.max(w.at.dot(&w.at).sqrt());
        // New faces take the places of the removed ones.
        let mut visible = std::mem::take(&mut self.growth.visible);
        for _ in visible.len()..edges {
            visible.push(self.faces.len() as u16);
            self.faces.push(self.faces[seed]);
        }
        for (&here, &(outside, k)) in visible.iter().zip(&self.growth.rim) {
            let (from, to) = self.ends((outside, k));
            let after = visible[usize::from(self.growth.places[usize::from(to)])];
            self.faces[usize::from(here)] =
                Face { across: [outside, after, 0], ..self.face([from, to, point]) };
            self.faces[usize::from(outside)].across[usize::from(k)] = here;
        }
        for here in &visible[..edges] {
            let after = self.faces[usize::from(*here)].across[1];
            self.faces[usize::from(after)].across[2] = *here;
        }
        self.close_gaps(&mut visible[edges..]);
        self.growth.visible = visible;
        true
    }

    /// Removes these faces, which have no neighbours: the last ones move to their places.
    fn close_gaps(&mut self, gaps: &mut [u16]) {
        gaps.sort_unstable();
        for gap in gaps.iter().rev() {
            self.faces.swap_remove(usize::from(*gap));
            let last = self.faces.len() as u16;
            if *gap == last {
                continue;
            }
            for beside in self.faces[usize::from(*gap)].across {
                for across in &mut self.faces[usize::from(beside)].across {
                    *across = if *across == last { *gap } else { *across };
                }
            }
        }
    }

    /// Lists the faces that a point sees, from one of them on.
    fn see(&mut self, seed: usize, w: &V3<f64>) {
        let Growth { seen, visible, .. } = &mut self.growth;
        seen.clear();
        seen.resize(self.faces.len(), false);
        seen[seed] = true;
        visible.clear();
        visible.push(seed as u16);
        let mut at = 0;
        while let Some(&here) = visible.get(at) {
            at += 1;
            for other in self.faces[usize::from(here)].across {
                let face = &self.faces[usize::from(other)];
                let over = face.normal.dot(w) - face.height > FLAT * self.size;
                if over && !seen[usize::from(other)] {
                    seen[usize::from(other)] = true;
                    visible.push(other);
                }
            }
        }
    }

    /// Lists the edges between visible and hidden faces; returns false if neighbours do not match.
    fn find_rim(&mut self) -> bool {
        let Growth { seen, visible, rim, .. } = &mut self.growth;
        rim.clear();
        for here in visible.iter().map(|here| usize::from(*here)) {
            let Face { across, corners, .. } = self.faces[here];
            for k in (0..3).filter(|k| !seen[usize::from(across[*k])]) {
                let face = &self.faces[usize::from(across[k])];
                let from = corners[(k + 1) % 3];
                let Some(back) = (0..3)
                    .find(|m| usize::from(face.across[*m]) == here && face.corners[*m] == from)
                else {
                    return false;
                };
                rim.push((across[k], back as u16));
            }
        }
        true
    }

    /// Lists the edge of the rim that leaves each point; returns false unless it is one closed loop, in
    /// which each corner leaves once and arrives once.
    fn close_rim(&mut self) -> bool {
        let mut places = std::mem::take(&mut self.growth.places);
        places.clear();
        places.resize(self.points.len(), NONE);
        let mut closed = true;
        for (i, edge) in (0..).zip(&self.growth.rim) {
            let from = &mut places[usize::from(self.ends(*edge).0)];
            closed &= *from == NONE;
            *from = i;
        }
        let arrives = |edge: &(u16, u16)| places[usize::from(self.ends(*edge).1)] != NONE;
        closed &= self.growth.rim.iter().all(arrives);
        self.growth.places = places;
        closed
    }

    /// Returns the ends of an edge of the rim. From inside the rim it runs the other way.
    fn ends(&self, (face, k): (u16, u16)) -> (u16, u16) {
        let corners = &self.faces[usize::from(face)].corners;
        (corners[(usize::from(k) + 1) % 3], corners[usize::from(k)])
    }
}

/// Returns four points of the set that span a volume; None if the set is flat.
fn tetrahedron(support: &impl Fn(&V3<f64>) -> Vertex, simplex: &[Vertex]) -> Option<[Vertex; 4]> {
    let mut seeds = [Vertex::default(); SEEDS];
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
    // Two crossed needles: the sampled points lie in one plane or on one line, the set does not.
    for _ in 0..2 {
        if corners.is_none() {
            for way in beside(&seeds[..count])? {
                seeds[count] = support(&way);
                count += 1;
            }
            corners = spread(&seeds[..count]);
        }
    }
    corners
}

/// Returns the first of the points, the one furthest from it, and the one furthest from their line;
/// with the square of their distance, and of twice the area of their triangle.
fn base(points: &[Vertex]) -> Option<([Vertex; 3], f64, f64)> {
    let first = *points.first()?;
    let a = first.at;
    let (length, b) = furthest(points, |p| (p - a).dot(&(p - a)));
    let ab = b.at - a;
    let (area, c) = furthest(points, |p| ab.cross(&(p - a)).dot(&ab.cross(&(p - a))));
    Some(([first, b, c], length, area))
}

fn furthest(points: &[Vertex], measure: impl Fn(&V3<f64>) -> f64) -> (f64, Vertex) {
    points.iter().fold((0.0, points[0]), |best, p| {
        let value = measure(&p.at);
        if value > best.0 {
            (value, *p)
        } else {
            best
        }
    })
}

/// Returns four of the points that span a volume.
fn spread(points: &[Vertex]) -> Option<[Vertex; 4]> {
    let ([a, b, c], length, area) = base(points)?;
    let normal = (b.at - a.at).cross(&(c.at - a.at));
    let (volume, d) = furthest(points, |p| normal.dot(&(p - a.at)).abs());
    // Height over the base, and width over the length.
    let flat = area <= FLAT * length * length || volume <= FLAT * area.sqrt() * length.sqrt();
    (!flat).then_some([a, b, c, d])
}

/// Returns four directions across the plane or the line in which points lie.
fn beside(points: &[Vertex]) -> Option<[V3<f64>; 4]> {
    let (corners, length, area) = base(points)?;
    let [a, b, c] = corners.map(|corner| corner.at);
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
