//! Rays against triangles of meshes and height fields.

use super::flat::{cuboid, face};
use super::{nearer, Hit, Ray, V};
use crate::shapes::height_field::HeightField;
use nalgebra::Matrix3;
use std::sync::Arc;

/// The triangles of a mesh as its file has them, shared with the scene, and the geom's frame in those
/// coordinates.
#[derive(Clone, Debug, PartialEq)]
pub struct Surface {
    pub vertices: Arc<Vec<[f64; 3]>>,
    pub faces: Arc<Vec<[usize; 3]>>,
    pub centre: V,
    pub turn: Matrix3<f64>,
    /// Corners of the box around all vertices, in the geom's frame.
    pub low: V,
    pub high: V,
}

impl Surface {
    /// Returns the first triangle that the ray meets, from either side.
    pub fn hit(&self, ray: &Ray) -> Option<Hit> {
        if !passes(&self.low, &self.high, ray) {
            return None;
        }
        let from = self.centre + self.turn * ray.from;
        let ray = Ray { from, along: self.turn * ray.along };
        let corner = |i: usize| V::from(self.vertices[i]);
        let hits = self.faces.iter().map(|face| triangle(&face.map(corner), &ray));
        let hit = hits.fold(None, nearer)?;
        Some(Hit { normal: self.turn.transpose() * hit.normal, ..hit })
    }
}

/// Checks whether a ray meets the box between two corners, a little widened.
fn passes(low: &V, high: &V, ray: &Ray) -> bool {
    let room = (high - low) * 1e-6;
    let (mut first, mut last) = (0.0f64, f64::INFINITY);
    for k in 0..3 {
        let (low, high) = (low[k] - room[k] - ray.from[k], high[k] + room[k] - ray.from[k]);
        if ray.along[k] == 0.0 {
            if low > 0.0 || high < 0.0 {
                return false;
            }
            continue;
        }
        let (a, b) = (low / ray.along[k], high / ray.along[k]);
        (first, last) = (first.max(a.min(b)), last.min(a.max(b)));
    }
    first <= last
}

/// T. Möller and B. Trumbore, Fast, minimum storage ray/triangle intersection (1997). The normal
/// belongs to counter-clockwise corners.
fn triangle(corners: &[V; 3], ray: &Ray) -> Option<Hit> {
    let [a, b, c] = corners;
    let (u, v, from) = (b - a, c - a, ray.from - a);
    let across = ray.along.cross(&v);
    let volume = u.dot(&across);
    if volume == 0.0 {
        return None;
    }
    let first = from.dot(&across) / volume;
    let other = from.cross(&u);
    let second = ray.along.dot(&other) / volume;
    let at = v.dot(&other) / volume;
    let inside = first >= 0.0 && second >= 0.0 && first + second <= 1.0;
    (inside && at >= 0.0).then(|| Hit { at, normal: u.cross(&v).normalize() })
}

/// A box of the base, from −base to 0, and over it the field's triangles and its four sides.
pub(super) fn height_field(field: &HeightField, ray: &Ray) -> Option<Hit> {
    let [x, y] = field.half;
    let lifted = |by: f64| Ray { from: ray.from - V::new(0.0, 0.0, by), ..*ray };
    let mut best = cuboid(&V::new(x, y, 0.5 * field.base), &lifted(-0.5 * field.base));
    let top = field.heights.iter().copied().fold(0.0, f64::max);
    let (half, above) = (V::new(x, y, 0.5 * top), lifted(0.5 * top));
    if !passes(&V::new(-x, -y, 0.0), &V::new(x, y, top), ray) {
        return best;
    }
    for (axis, side) in [(0, -1.0), (0, 1.0), (1, -1.0), (1, 1.0)] {
        let hit = face(&half, axis, side, &above);
        let under = |hit: &Hit| ray.at(hit.at).z < edge_height(field, axis, side, &ray.at(hit.at));
        best = nearer(best, hit.filter(under));
    }
    let (rows, cols) = cells_below(field, top, ray);
    for row in rows {
        for col in cols.clone() {
            for upper in [false, true] {
                best = nearer(best, triangle(&field.top(row, col, upper), ray));
            }
        }
    }
    best
}

/// Returns the height of the field along one of its four edges, over a point.
fn edge_height(field: &HeightField, axis: usize, side: f64, point: &V) -> f64 {
    let (count, half, other) = match axis {
        0 => (field.nrow, field.half[1], field.ncol),
        _ => (field.ncol, field.half[0], field.nrow),
    };
    let last = if side > 0.0 { other - 1 } else { 0 };
    let place = (point[1 - axis] / half + 1.0) * 0.5 * (count - 1) as f64;
    let first = (place.max(0.0) as usize).min(count - 2);
    let height = |i: usize| {
        let at = if axis == 0 { i * field.ncol + last } else { last * field.ncol + i };
        field.heights[at]
    };
    let share = place - first as f64;
    height(first) * (1.0 - share) + height(first + 1) * share
}

/// Returns rows and columns of the cells over which the ray is between height 0 and the highest, and
/// one more on each side.
fn cells_below(
    field: &HeightField,
    top: f64,
    ray: &Ray,
) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
    let (mut first, mut last) = (0.0f64, f64::INFINITY);
    for (axis, [low, high]) in
        [[-field.half[0], field.half[0]], [-field.half[1], field.half[1]], [0.0, top]]
            .into_iter()
            .enumerate()
    {
        if ray.along[axis] != 0.0 {
            let ends = [low, high].map(|x| (x - ray.from[axis]) / ray.along[axis]);
            (first, last) = (first.max(ends[0].min(ends[1])), last.min(ends[0].max(ends[1])));
        }
    }
    let ends = [ray.at(first), ray.at(last.max(first))];
    let range = |axis: usize, count: usize| {
        let cell = |p: &V| (p[axis] / field.half[axis] + 1.0) * 0.5 * (count - 1) as f64;
        let (a, b) = (cell(&ends[0]), cell(&ends[1]));
        // An out-of-range float becomes the nearest integer.
        let low = (a.min(b) - 1.0).max(0.0) as usize;
        low..((a.max(b) + 2.0).max(0.0) as usize).min(count - 1)
    };
    (range(1, field.nrow), range(0, field.ncol))
}
