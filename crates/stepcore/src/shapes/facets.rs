//! Faces and edges of a convex surface of triangles: triangles in one plane become one polygon.

use super::quickhull::Surface;
use nalgebra::Vector3;
use std::collections::{BTreeMap, BTreeSet};

/// Distance from a face's plane at which a vertex still lies in it, relative to half of the largest
/// extent: eight times the rounding of a coordinate in single precision, in which files store them.
const FLAT: f64 = 5e-7;

/// Cosine of the largest angle between two triangles of one face, and of a sliver and its face: the
/// normal of a triangle whose height is only rounding is only rounding.
const PARALLEL: f64 = 0.9999;
const SLIVER: f64 = 0.5;

/// Largest number of rounds in which polygons that are not convex are taken apart.
const ROUNDS: usize = 8;

/// A polygon of a polytope's surface.
#[derive(Clone, Debug, PartialEq)]
pub struct Face {
    /// Unit length, outward; normal · x ≤ offset [m] of every vertex x.
    pub normal: Vector3<f64>,
    pub offset: f64,
    /// Its corners lie in its plane except for 1e-9 of the hull's reach.
    pub level: bool,
    /// Counter-clockwise from outside: vertices, and the edge from each one to the next.
    pub corners: Vec<usize>,
    pub edges: Vec<usize>,
}

/// An edge from one vertex to another, and the faces on its left and right seen from outside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    pub ends: [usize; 2],
    pub faces: [usize; 2],
}

const NONE: usize = usize::MAX;

/// Returns the faces and edges of a surface whose half extent is `half`. Polygons that would not be
/// convex stay triangles, and so do all if the polygons would not close.
pub(super) fn merged(
    vertices: &[Vector3<f64>],
    surface: &Surface,
    half: f64,
) -> (Vec<Face>, Vec<Edge>) {
    let flat = FLAT * half;
    let mut regions = Regions::flat(vertices, surface, flat);
    for _ in 0..ROUNDS {
        let Some((faces, edges)) = regions.polygons() else { break };
        let hollow: Vec<usize> =
            (0..faces.len()).filter(|i| !faces[*i].convex(vertices, flat)).collect();
        if hollow.is_empty() {
            return (faces, edges);
        }
        regions.dissolve(&hollow);
    }
    let face = (0..surface.triangles.len()).collect();
    let count = surface.triangles.len();
    Regions { vertices, surface, face, count }.polygons().unwrap_or_default()
}

impl Face {
    /// Checks that no corner lies inside the line between its neighbours, except for rounding.
    fn convex(&self, vertices: &[Vector3<f64>], flat: f64) -> bool {
        let n = self.corners.len();
        (0..n).all(|k| {
            let [a, b, c] = [0, 1, 2].map(|j| vertices[self.corners[(k + j) % n]]);
            let across = c - a;
            (b - a).cross(&across).dot(&self.normal) >= -4.0 * flat * across.norm()
        })
    }
}

/// The face of each triangle.
struct Regions<'a> {
    vertices: &'a [Vector3<f64>],
    surface: &'a Surface,
    face: Vec<usize>,
    count: usize,
}

impl<'a> Regions<'a> {
    /// Groups triangles around the largest that lie in its plane, then around the largest of the rest.
    fn flat(vertices: &'a [Vector3<f64>], surface: &'a Surface, flat: f64) -> Self {
        let areas: Vec<Vector3<f64>> =
            surface.triangles.iter().map(|corners| area(vertices, corners)).collect();
        let mut order: Vec<usize> = (0..areas.len()).collect();
        order.sort_by(|a, b| areas[*b].norm().total_cmp(&areas[*a].norm()).then(a.cmp(b)));
        let mut regions = Self { vertices, surface, face: vec![NONE; areas.len()], count: 0 };
        for seed in order {
            if regions.face[seed] == NONE {
                regions.spread(&areas, seed, flat);
            }
        }
        regions.heal();
        regions
    }

    /// Makes a new face from a triangle and all that lie in its plane.
    fn spread(&mut self, areas: &[Vector3<f64>], seed: usize, flat: f64) {
        let vertices = self.vertices;
        let face = self.count;
        self.count += 1;
        self.face[seed] = face;
        let normal = areas[seed].normalize();
        let offset = normal.dot(&vertices[self.surface.triangles[seed][0]]);
        let mut pending = vec![seed];
        while let Some(here) = pending.pop() {
            for next in self.surface.across[here] {
                if self.face[next] != NONE {
                    continue;
                }
                let corners = &self.surface.triangles[next];
                let least =
                    if low(vertices, corners, &areas[next], flat) { SLIVER } else { PARALLEL };
                let level = |i: &usize| (normal.dot(&vertices[*i]) - offset).abs() <= flat;
                let turned = areas[next].dot(&normal) < least * areas[next].norm();
                if !turned && corners.iter().all(level) {
                    self.face[next] = face;
                    pending.push(next);
                }
            }
        }
    }

    /// Returns whether each vertex is a corner: at least three faces meet there.
    fn corners(&self) -> Vec<bool> {
        let most = self.surface.triangles.iter().flatten().max().map_or(0, |v| v + 1);
        let mut faces: Vec<Vec<usize>> = vec![Vec::new(); most];
        for (corners, face) in self.surface.triangles.iter().zip(&self.face) {
            for &corner in corners {
                if !faces[corner].contains(face) {
                    faces[corner].push(*face);
                }
            }
        }
        faces.iter().map(|list| list.len() >= 3).collect()
    }

    /// Gives a face with fewer than three corners, a strip of slivers, to the face that it shares most
    /// edges with.
    fn heal(&mut self) {
        loop {
            let corners = self.corners();
            let mut met = vec![0; self.count];
            let mut shared: Vec<BTreeMap<usize, usize>> = vec![BTreeMap::new(); self.count];
            for (triangle, &face) in self.face.iter().enumerate() {
                for k in 0..3 {
                    let beyond = self.face[self.surface.across[triangle][k]];
                    if beyond != face {
                        met[face] += usize::from(corners[self.surface.triangles[triangle][k]]);
                        *shared[face].entry(beyond).or_insert(0) += 1;
                    }
                }
            }
            let mut given: Vec<usize> = (0..self.count).collect();
            for bad in (0..self.count).filter(|face| met[*face] < 3) {
                let into = shared[bad].iter().max_by_key(|(_, edges)| **edges);
                // A face whose receiver is itself given away waits for the next round.
                if let Some((into, _)) = into.filter(|(into, _)| given[**into] == **into) {
                    given[bad] = *into;
                }
            }
            if (0..self.count).all(|face| given[face] == face) {
                return;
            }
            self.face.iter_mut().for_each(|face| *face = given[*face]);
        }
    }

    /// Splits the faces at these places, among those that have triangles, into triangles.
    fn dissolve(&mut self, places: &[usize]) {
        let used: BTreeSet<usize> = self.face.iter().copied().collect();
        let used: Vec<usize> = used.into_iter().collect();
        let hollow: BTreeSet<usize> = places.iter().map(|place| used[*place]).collect();
        for face in &mut self.face {
            if hollow.contains(face) {
                *face = self.count;
                self.count += 1;
            }
        }
    }

    /// Returns the polygons around the faces, and the edges between corners; None if one is not closed.
    fn polygons(&self) -> Option<(Vec<Face>, Vec<Edge>)> {
        let corners = self.corners();
        let mut triangles: Vec<Vec<usize>> = vec![Vec::new(); self.count];
        for (triangle, face) in self.face.iter().enumerate() {
            triangles[*face].push(triangle);
        }
        let full = triangles.iter().filter(|list| !list.is_empty());
        let mut faces =
            full.map(|list| self.polygon(&corners, list)).collect::<Option<Vec<Face>>>()?;
        let mut edges: Vec<Edge> = Vec::new();
        let mut edge_of = BTreeMap::new();
        for (index, face) in faces.iter_mut().enumerate() {
            for k in 0..face.corners.len() {
                let (start, end) = (face.corners[k], face.corners[(k + 1) % face.corners.len()]);
                // Both faces of an edge list it, in opposite directions.
                let edge = match edge_of.remove(&(end, start)) {
                    Some(edge) => edge,
                    None => {
                        edges.push(Edge { ends: [start, end], faces: [index, NONE] });
                        edge_of.insert((start, end), edges.len() - 1);
                        edges.len() - 1
                    }
                };
                if edges[edge].faces[0] != index {
                    edges[edge].faces[1] = index;
                }
                face.edges.push(edge);
            }
        }
        let closed = edge_of.is_empty() && edges.iter().all(|e| e.faces[1] != NONE);
        let met = corners.iter().filter(|corner| **corner).count();
        (closed && met + faces.len() == edges.len() + 2).then_some((faces, edges))
    }

    /// Returns one face: the corners in the order of its boundary, and its normal.
    fn polygon(&self, corner: &[bool], triangles: &[usize]) -> Option<Face> {
        let mut next = BTreeMap::new();
        let mut normal = Vector3::zeros();
        for &triangle in triangles {
            let ends = self.surface.triangles[triangle];
            normal += area(self.vertices, &ends);
            for k in 0..3 {
                let outside = self.face[self.surface.across[triangle][k]] != self.face[triangle];
                if outside && next.insert(ends[k], ends[(k + 1) % 3]).is_some() {
                    return None;
                }
            }
        }
        let start = *next.keys().find(|v| corner[**v])?;
        let mut corners = Vec::new();
        let (mut at, mut steps) = (start, 0);
        loop {
            if corner[at] {
                corners.push(at);
            }
            at = *next.get(&at)?;
            steps += 1;
            if at == start {
                break;
            }
        }
        let normal = normal.try_normalize(0.0)?;
        let whole = steps == next.len() && corners.len() >= 3;
        whole.then_some(Face { normal, offset: 0.0, level: true, corners, edges: Vec::new() })
    }
}

/// Returns the cross product of a triangle's sides: normal to it, twice the area long.
fn area(vertices: &[Vector3<f64>], corners: &[usize; 3]) -> Vector3<f64> {
    let [a, b, c] = corners.map(|i| vertices[i]);
    (b - a).cross(&(c - a))
}

/// Checks that the triangle is hardly higher than the rounding of its corners.
fn low(vertices: &[Vector3<f64>], corners: &[usize; 3], area: &Vector3<f64>, flat: f64) -> bool {
    let [a, b, c] = corners.map(|i| vertices[i]);
    let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
    area.norm() <= 4.0 * flat * longest
}
