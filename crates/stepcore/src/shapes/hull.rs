//! `Hull`: a convex polytope in its own frame.

pub use super::facets::{Edge, Face};

use super::facets;
use super::grid::{Grid, Point, NOISE};
use super::quickhull::{surface, Flat, Surface};
use crate::error::{Error, Result};
use nalgebra::{Matrix3, Vector3};

/// From this many vertices on the support function climbs instead of looking at every vertex.
const CLIMB: usize = 32;

/// Directions fall into so many by so many cells on each side of a cube.
const CELLS: usize = 8;

/// A convex polytope.
#[derive(Clone, Debug, PartialEq)]
pub struct Hull {
    /// Its corners [m], in the order of the points that they were made from.
    pub vertices: Vec<Vector3<f64>>,
    /// Which of those points each one is.
    pub source: Vec<usize>,
    /// Its surface in triangles of vertices, counter-clockwise from outside.
    pub triangles: Vec<[usize; 3]>,
    /// Its surface in polygons: triangles that lie in one plane but for rounding are one face.
    pub faces: Vec<Face>,
    /// Where two faces meet.
    pub edges: Vec<Edge>,
    /// Ends of triangles' edges: vertex v's neighbours are `adjacent[starts[v]..starts[v + 1]]`.
    starts: Vec<usize>,
    adjacent: Vec<usize>,
    /// By cell of directions the vertex furthest along the middle of the cell, from which the others
    /// of the cell are climbed to; empty where nobody climbs.
    nearby: Vec<usize>,
    /// Distance of the furthest vertex from the origin [m].
    reach: f64,
}

impl Hull {
    /// The hull of points [m]. Those that are within 1e-11 of the largest extent of what is left
    /// without them are left out.
    pub fn of(points: &[[f64; 3]]) -> Result<Self> {
        Self::of_at_most(points, usize::MAX)
    }

    /// The hull of at most `most` of the points (at least 4), those added first that are furthest
    /// outside: MuJoCo's `maxhullvert`.
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
            // Points inside, and corners that turned out to lie in a face or on an edge.
            if kept.len() == on_grid.len() {
                break surface;
            }
            source = kept.iter().map(|i| source[*i]).collect();
            on_grid = kept.iter().map(|i| on_grid[*i]).collect();
        };
        let vertices = source.iter().map(|i| Vector3::from(points[*i])).collect();
        Ok(Self::with_faces(vertices, source, surface, grid.half))
    }

    /// A box of these half sizes [m].
    pub fn block(half: [f64; 3]) -> Result<Self> {
        let sign =
            |i: usize, axis: usize| if i >> axis & 1 == 1 { half[axis] } else { -half[axis] };
        let corner = |i: usize| std::array::from_fn(|axis| sign(i, axis));
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
        let nearby = Vec::new();
        let mut hull =
            Self { vertices, source, triangles, faces, edges, starts, adjacent, nearby, reach };
        for i in 0..hull.faces.len() {
            let normal = hull.faces[i].normal;
            let furthest = hull.support_from(hull.faces[i].corners[0], &normal);
            hull.faces[i].offset = normal.dot(&hull.vertices[furthest]);
        }
        hull.find_nearby();
        hull
    }

    fn find_nearby(&mut self) {
        self.nearby.clear();
        if self.vertices.len() < CLIMB {
            return;
        }
        let mut last = 0;
        for index in 0..6 * CELLS * CELLS {
            last = self.support_from(last, &middle(index));
            self.nearby.push(last);
        }
    }

    /// The vertices at the other ends of a vertex's edges.
    pub fn neighbours(&self, vertex: usize) -> &[usize] {
        &self.adjacent[self.starts[vertex]..self.starts[vertex + 1]]
    }

    /// The vertex furthest along a direction; the first of several, where there are few.
    pub fn support(&self, direction: &Vector3<f64>) -> usize {
        if self.vertices.len() >= CLIMB {
            return self.support_from(self.nearby[cell(direction)], direction);
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

    /// The same by hill climbing from a vertex: on a convex surface a vertex that is as far as its
    /// neighbours is the furthest.
    pub fn support_from(&self, start: usize, direction: &Vector3<f64>) -> usize {
        let mut best = (start, self.vertices[start].dot(direction));
        loop {
            let before = best.0;
            for &next in self.neighbours(before) {
                let along = self.vertices[next].dot(direction);
                // Nobody can tell beforehand: two choices, and no branch to be taken wrongly.
                let further = along > best.1;
                best.0 = if further { next } else { best.0 };
                best.1 = if further { along } else { best.1 };
            }
            if best.0 == before {
                return before;
            }
        }
    }

    /// The same polytope turned, then moved [m].
    pub fn moved(mut self, turn: &Matrix3<f64>, shift: &Vector3<f64>) -> Self {
        for vertex in &mut self.vertices {
            *vertex = turn * *vertex + shift;
        }
        for face in &mut self.faces {
            face.normal = turn * face.normal;
            face.offset += face.normal.dot(shift);
        }
        self.reach = furthest(&self.vertices);
        self.find_nearby();
        self
    }

    /// Half sizes of the box about the origin that holds it [m].
    pub fn half(&self) -> [f64; 3] {
        let most = |k: usize| self.vertices.iter().fold(0.0, |most: f64, v| most.max(v[k].abs()));
        [0, 1, 2].map(most)
    }

    /// Distance of the furthest vertex from the origin [m].
    pub fn reach(&self) -> f64 {
        self.reach
    }
}

/// The cell of a direction: the side of the cube through which it leaves, and where.
fn cell(direction: &Vector3<f64>) -> usize {
    let k = direction.iamax();
    let scale = 0.5 * CELLS as f64 / direction[k].abs();
    // Of no direction, and of a number that is none, the first.
    let grid = |x: f64| ((x * scale + 0.5 * CELLS as f64) as usize).min(CELLS - 1);
    let side = 2 * k + usize::from(direction[k] < 0.0);
    (side * CELLS + grid(direction[(k + 1) % 3])) * CELLS + grid(direction[(k + 2) % 3])
}

/// The direction in the middle of a cell.
fn middle(cell: usize) -> Vector3<f64> {
    let (side, row, column) = (cell / (CELLS * CELLS), cell / CELLS % CELLS, cell % CELLS);
    let grid = |place: usize| (2 * place + 1) as f64 / CELLS as f64 - 1.0;
    let (k, mut direction) = (side / 2, Vector3::zeros());
    direction[k] = if side % 2 == 1 { -1.0 } else { 1.0 };
    direction[(k + 1) % 3] = grid(row);
    direction[(k + 2) % 3] = grid(column);
    direction
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

/// Vertices at which at least three edges meet that are edges of the solid, not only of triangles
/// in the same plane: ascending.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_a_cell_lies_in_it() {
        for index in 0..6 * CELLS * CELLS {
            assert_eq!(cell(&(3e-5 * middle(index))), index);
        }
        assert!(cell(&Vector3::zeros()) < 6 * CELLS * CELLS);
        assert!(cell(&Vector3::repeat(f64::NAN)) < 6 * CELLS * CELLS);
        assert!(cell(&Vector3::new(f64::INFINITY, 1.0, 0.0)) < 6 * CELLS * CELLS);
    }
}
