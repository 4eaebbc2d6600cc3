//! `Hull`: a convex polytope in its frame.

pub use super::facets::{Edge, Face};

use super::directions::{self, ByDirection};
use super::facets;
use super::grid::{Grid, Point, NOISE};
use super::quickhull::{surface, Flat, Surface};
use crate::error::{Error, Result};
use crate::real::array::from_fn;
use nalgebra::{Matrix3, Vector3};

/// From this many vertices on the support function climbs instead of examining every vertex.
const CLIMB: usize = 32;

/// From this many faces on, faces are listed by the direction of their normals.
const LISTED: usize = 32;

/// Over a hull's reach: corners at most this far below a face's plane lie in it.
const LEVEL: f64 = 1e-9;

/// A convex polytope.
#[derive(Clone, Debug, PartialEq)]
pub struct Hull {
    /// Its corners [m], in the order of the points from which they were made.
    pub vertices: Vec<Vector3<f64>>,
    /// The index of the point of each corner.
    pub source: Vec<usize>,
    /// Its surface in triangles of vertices, counter-clockwise from outside.
    pub triangles: Vec<[usize; 3]>,
    /// Its surface in polygons: triangles in one plane except for rounding are one face.
    pub faces: Vec<Face>,
    /// Their planes by fours, the first again if there are fewer: by coordinate the normals, then the
    /// offsets.
    planes: Vec<[[f64; 4]; 4]>,
    /// The lines in which two faces meet.
    pub edges: Vec<Edge>,
    /// Ends of triangles' edges: vertex v's neighbours are `adjacent[starts[v]..starts[v + 1]]`.
    starts: Vec<usize>,
    adjacent: Vec<usize>,
    /// The same with their positions, by fours: the fours of vertex v are
    /// `around[first_four[v]..first_four[v + 1]]`.
    first_four: Vec<usize>,
    around: Vec<Four>,
    /// The same without lines inside of level faces.
    folds: Vec<Vec<usize>>,
    /// By cell of directions: the vertex furthest along the middle of the cell, from which the others
    /// of the cell are climbed to; empty if the hull does not climb.
    nearby: Vec<usize>,
    /// By cell: the faces whose normals may be nearest to it; empty if there are few, and until the
    /// hull is at its place of collision.
    faces_along: ByDirection,
    /// Distance of the furthest vertex from the origin [m].
    reach: f64,
}

/// Four neighbours of a vertex; if there are fewer, the first is repeated.
#[derive(Clone, Debug, PartialEq)]
struct Four {
    vertices: [u32; 4],
    /// By coordinate.
    at: [[f64; 4]; 3],
}

impl Four {
    /// Returns the reach of the furthest along a direction, and its index: the first of several.
    #[inline(always)]
    fn furthest(&self, direction: &Vector3<f64>) -> (f64, u32) {
        let [x, y, z] = &self.at;
        let along: [(f64, u32); 4] =
            from_fn(|i| (Vector3::new(x[i], y[i], z[i]).dot(direction), self.vertices[i]));
        // The outcome is unpredictable: selections are cheaper than mispredicted branches.
        let further = |a: (f64, u32), b: (f64, u32)| {
            (if b.0 > a.0 { b.0 } else { a.0 }, if b.0 > a.0 { b.1 } else { a.1 })
        };
        further(further(along[0], along[1]), further(along[2], along[3]))
    }
}

impl Hull {
    /// Creates the hull of points [m]. A point nearer to the hull of the others than 1e-11 of the
    /// largest extent is left out.
    pub fn of(points: &[[f64; 3]]) -> Result<Self> {
        Self::of_at_most(points, usize::MAX)
    }

    /// Creates the hull of at most `most` of the points (at least 4); the points furthest outside are
    /// added first: MuJoCo's `maxhullvert`.
    pub fn of_at_most(points: &[[f64; 3]], most: usize) -> Result<Self> {
        if most < 4 {
            return Err(Error::value("vertices of a convex hull", most, "at least 4"));
        }
        if let Some(i) = points.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
            let [x, y, z] = points[i];
            return Err(Error::value(format!("point {i}"), format!("{x} {y} {z}"), "finite"));
        }
        let Some(grid) = Grid::around(points) else {
            return Err(refuse(points.len(), Flat::Point));
        };
        let places: Vec<Point> = points.iter().map(|p| grid.point(p)).collect();
        let flat = |kind| refuse(points.len(), kind);
        let mut source: Vec<usize> = (0..points.len()).collect();
        let mut on_grid = places.clone();
        let surface = loop {
            let surface = surface(&on_grid, most).map_err(flat)?;
            let kept = corners(&surface, &on_grid);
            // Points inside, and corners that proved to lie in a face or on an edge.
            if kept.len() == on_grid.len() {
                break surface;
            }
            source = kept.iter().map(|i| source[*i]).collect();
            on_grid = kept.iter().map(|i| on_grid[*i]).collect();
        };
        let vertices = source.iter().map(|i| Vector3::from(points[*i])).collect();
        Ok(Self::with_faces(vertices, source, surface, grid.half))
    }

    /// Creates a box of these half sizes [m].
    pub fn block(half: [f64; 3]) -> Result<Self> {
        let sign =
            |i: usize, axis: usize| if i >> axis & 1 == 1 { half[axis] } else { -half[axis] };
        let corner = |i: usize| from_fn(|axis| sign(i, axis));
        Self::of(&(0..8).map(corner).collect::<Vec<_>>())
    }

    fn with_faces(
        vertices: Vec<Vector3<f64>>,
        source: Vec<usize>,
        surface: Surface,
        half: f64,
    ) -> Self {
        let mut lists = vec![Vec::new(); vertices.len()];
        for corners in &surface.triangles {
            for k in 0..3 {
                lists[corners[k]].push(corners[(k + 1) % 3]);
            }
        }
        let mut starts = vec![0];
        let mut adjacent = Vec::new();
        for list in &mut lists {
            list.sort_unstable();
            adjacent.append(list);
            starts.push(adjacent.len());
        }
        let (faces, edges) = facets::merged(&vertices, &surface, half);
        let triangles = surface.triangles;
        let reach = furthest(&vertices);
        let mut hull = Self {
            vertices,
            source,
            triangles,
            faces,
            planes: Vec::new(),
            edges,
            starts,
            adjacent,
            first_four: Vec::new(),
            around: Vec::new(),
            folds: Vec::new(),
            nearby: Vec::new(),
            faces_along: ByDirection::default(),
            reach,
        };
        hull.find_around();
        for i in 0..hull.faces.len() {
            let normal = hull.faces[i].normal;
            let furthest = hull.support_from(hull.faces[i].corners[0], &normal);
            let offset = normal.dot(&hull.vertices[furthest]);
            let lowest = |low: f64, corner: &usize| low.min(normal.dot(&hull.vertices[*corner]));
            let low = hull.faces[i].corners.iter().fold(offset, lowest);
            (hull.faces[i].offset, hull.faces[i].level) = (offset, offset - low <= LEVEL * reach);
        }
        hull.find_planes();
        hull.find_folds();
        hull.find_nearby();
        hull
    }

    fn find_around(&mut self) {
        self.around.clear();
        self.first_four = vec![0];
        for vertex in 0..self.vertices.len() {
            let own = &self.adjacent[self.starts[vertex]..self.starts[vertex + 1]];
            self.around.extend(own.chunks(4).map(|few| {
                let vertices = from_fn(|i| *few.get(i).unwrap_or(&few[0]));
                let at = from_fn(|k| vertices.map(|other: usize| self.vertices[other][k]));
                Four { vertices: vertices.map(|other| other as u32), at }
            }));
            self.first_four.push(self.around.len());
        }
    }

    fn find_planes(&mut self) {
        let number = |face: &Face, k: usize| if k < 3 { face.normal[k] } else { face.offset };
        let of = |few: &[Face]| from_fn(|k| from_fn(|i| number(few.get(i).unwrap_or(&few[0]), k)));
        self.planes = self.faces.chunks(4).map(of).collect();
    }

    fn find_folds(&mut self) {
        let mut edges: Vec<_> = self.edges.iter().map(|edge| edge.ends).collect();
        edges.iter_mut().for_each(|ends| ends.sort_unstable());
        edges.sort_unstable();
        let mut uneven = vec![Vec::new(); self.vertices.len()];
        for (index, face) in self.faces.iter().enumerate().filter(|(_, face)| !face.level) {
            face.corners.iter().for_each(|corner| uneven[*corner].push(index));
        }
        let folded = &|one: usize, other: usize| {
            edges.binary_search(&[one.min(other), one.max(other)]).is_ok()
                || uneven[one].iter().any(|face| uneven[other].contains(face))
        };
        let of =
            |one| self.neighbours(one).iter().copied().filter(move |other| folded(one, *other));
        self.folds = (0..self.vertices.len()).map(|one| of(one).collect()).collect();
    }

    /// Returns the vertices at the other ends of the edges from a vertex along which the surface folds.
    pub fn folds(&self, vertex: usize) -> &[usize] {
        &self.folds[vertex]
    }

    /// Returns the distance of a point from the face that it is furthest outside of; negative inside.
    pub fn outside(&self, p: &Vector3<f64>) -> f64 {
        let mut most = [f64::NEG_INFINITY; 4];
        for [x, y, z, offset] in &self.planes {
            for i in 0..4 {
                let above = Vector3::new(x[i], y[i], z[i]).dot(p) - offset[i];
                most[i] = if above > most[i] { above } else { most[i] };
            }
        }
        most.into_iter().fold(f64::NEG_INFINITY, f64::max)
    }

    fn find_nearby(&mut self) {
        self.nearby.clear();
        if self.vertices.len() < CLIMB {
            return;
        }
        let mut last = 0;
        for index in 0..directions::COUNT {
            last = self.support_from(last, &directions::middle(index));
            self.nearby.push(last);
        }
    }

    /// Returns the vertices at the other ends of a vertex's edges.
    pub fn neighbours(&self, vertex: usize) -> &[usize] {
        &self.adjacent[self.starts[vertex]..self.starts[vertex + 1]]
    }

    /// Returns the vertex furthest along a direction; the first of several, if there are few.
    pub fn support(&self, direction: &Vector3<f64>) -> usize {
        if self.vertices.len() >= CLIMB {
            return self.support_from(self.nearby[directions::cell(direction)], direction);
        }
        let mut best = (0, f64::NEG_INFINITY);
        for (i, vertex) in self.vertices.iter().enumerate() {
            let along = vertex.dot(direction);
            if along > best.1 {
                best = (i, along);
            }
        }
        best.0
    }

    /// Returns the face whose normal is nearest to a direction, the first of several.
    pub fn face(&self, direction: &Vector3<f64>) -> usize {
        let mut best = (f64::NEG_INFINITY, 0);
        let mut see = |index: usize| {
            let along = self.faces[index].normal.dot(direction);
            if along > best.0 {
                best = (along, index);
            }
        };
        if self.faces_along.is_empty() {
            (0..self.faces.len()).for_each(see);
        } else {
            let list = self.faces_along.at(directions::cell(direction));
            list.iter().for_each(|index| see(*index as usize));
        }
        best.1
    }

    /// Does the same by hill climbing from a vertex: on a convex surface a vertex that is as far as its
    /// neighbours is the furthest.
    pub fn support_from(&self, start: usize, direction: &Vector3<f64>) -> usize {
        let (mut best, mut most) = (start, self.vertices[start].dot(direction));
        loop {
            let (mut next, mut second) = (best, f64::NEG_INFINITY);
            for four in &self.around[self.first_four[best]..self.first_four[best + 1]] {
                let (along, vertex) = four.furthest(direction);
                next = if along > second { vertex as usize } else { next };
                second = if along > second { along } else { second };
            }
            if second > most {
                (best, most) = (next, second);
            } else {
                return best;
            }
        }
    }

    /// Returns the same polytope turned, then moved [m], for collision there.
    pub fn moved(mut self, turn: &Matrix3<f64>, shift: &Vector3<f64>) -> Self {
        for vertex in &mut self.vertices {
            *vertex = turn * *vertex + shift;
        }
        for face in &mut self.faces {
            face.normal = turn * face.normal;
            face.offset += face.normal.dot(shift);
        }
        self.reach = furthest(&self.vertices);
        self.find_planes();
        self.find_around();
        self.find_nearby();
        if self.faces.len() >= LISTED {
            let normals: Vec<Vector3<f64>> = self.faces.iter().map(|face| face.normal).collect();
            self.faces_along = ByDirection::of(&normals);
        }
        self
    }

    /// Returns the half sizes of the box about the origin that holds it [m].
    pub fn half(&self) -> [f64; 3] {
        let most = |k: usize| self.vertices.iter().fold(0.0, |most: f64, v| most.max(v[k].abs()));
        [0, 1, 2].map(most)
    }

    /// Returns the distance of the furthest vertex from the origin [m].
    pub fn reach(&self) -> f64 {
        self.reach
    }
}

fn furthest(vertices: &[Vector3<f64>]) -> f64 {
    vertices.iter().map(|v| v.norm()).fold(0.0, f64::max)
}

fn refuse(count: usize, flat: Flat) -> Error {
    let why = match flat {
        Flat::Point => "all of them are one point",
        Flat::Line => "all of them lie on one line",
        Flat::Plane => "all of them lie in one plane",
    };
    let text = format!("the {count} points have no convex hull with a volume: {why}");
    Error::Scene(text.into())
}

/// Returns the vertices with at least three edges of the solid, not only of triangles in the same
/// plane: ascending.
fn corners(surface: &Surface, places: &[Point]) -> Vec<usize> {
    let mut folds = vec![0; places.len()];
    for (corners, across) in surface.triangles.iter().zip(&surface.across) {
        let [a, b, c] = corners.map(|i| &places[i]);
        let plane = super::grid::Plane::through(a, b, c);
        for k in 0..3 {
            let beyond = surface.triangles[across[k]].iter().find(|i| !corners.contains(i));
            let folded = beyond.is_some_and(|i| plane.distance(&places[*i]) < -NOISE);
            folds[corners[k]] += usize::from(folded);
        }
    }
    (0..places.len()).filter(|i| folds[*i] >= 3).collect()
}
