//! Volume, centre and inertia of a mesh, by the pyramids from a point to its triangles.
//!
//! MuJoCo documentation, XML reference, asset/mesh and mesh/inertia; J. O'Rourke, Computational
//! Geometry in C, section 1.3.8.

use super::principal;
use crate::scene::MeshInertia;
use crate::spatial::rotation;
use nalgebra::{Matrix3, Vector3};

type Triangle = [Vector3<f64>; 3];

/// A mesh of uniform density in the frame of its principal axes.
#[derive(Clone, Debug)]
pub struct Solid {
    /// Volume [m³], or area of a shell [m²].
    pub measure: f64,
    /// Its frame in the coordinates of its file: centre of mass [m], and w x y z.
    pub centre: Vector3<f64>,
    pub quat: [f64; 4],
    /// Inertia at unit mass, about the centre in this frame [m²].
    pub inertia: Matrix3<f64>,
    /// Corners of the box around all vertices, in this frame [m].
    pub low: Vector3<f64>,
    pub high: Vector3<f64>,
}

/// The reason why a mesh has no mass properties.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Unsolid {
    /// No volume, or no area.
    Nothing,
    /// Its triangles are seen from inside.
    InsideOut,
}

impl Solid {
    pub fn of(
        vertices: &[[f64; 3]],
        faces: &[[usize; 3]],
        inertia: MeshInertia,
    ) -> Result<Self, Unsolid> {
        let corner = |i: usize| Vector3::from(vertices[i]);
        let mut triangles: Vec<Triangle> = faces.iter().map(|face| face.map(corner)).collect();
        let (area, middle) = surface(&triangles);
        if !(area > 0.0 && area.is_finite()) {
            return Err(Unsolid::Nothing);
        }
        // Pyramids from the middle of the surface give the centre; pyramids from there the rest.
        let (measure, centre) = centre(&triangles, &middle, inertia);
        check(measure, area)?;
        for triangle in &mut triangles {
            triangle.iter_mut().for_each(|corner| *corner -= centre);
        }
        let (measure, full) = second(&triangles, inertia);
        check(measure, area)?;
        let quat = principal::axes(&full);
        let own = principal::seen_from(quat, &full);
        let back = rotation(quat).transpose();
        let places = || vertices.iter().map(|v| back * (Vector3::from(*v) - centre));
        let low = places().fold(Vector3::repeat(f64::INFINITY), |a, b| a.inf(&b));
        let high = places().fold(Vector3::repeat(f64::NEG_INFINITY), |a, b| a.sup(&b));
        Ok(Self { measure, centre, quat, inertia: own / measure, low, high })
    }
}

/// Refuses a volume that is only rounding next to the largest volume that this area could enclose.
fn check(measure: f64, area: f64) -> Result<(), Unsolid> {
    let least = 1e-15 * area * area.sqrt();
    match measure {
        m if !m.is_finite() || m.abs() <= least => Err(Unsolid::Nothing),
        m if m < 0.0 => Err(Unsolid::InsideOut),
        _ => Ok(()),
    }
}

/// Middle of a triangle, and its normal times its area.
fn facing(triangle: &Triangle) -> (Vector3<f64>, Vector3<f64>) {
    let [a, b, c] = triangle;
    ((a + b + c) / 3.0, (b - a).cross(&(c - a)) * 0.5)
}

/// Area of all triangles, and its centroid.
fn surface(triangles: &[Triangle]) -> (f64, Vector3<f64>) {
    let mut total = 0.0;
    let mut middle = Vector3::zeros();
    for triangle in triangles {
        let (centre, across) = facing(triangle);
        total += across.norm();
        middle += centre * across.norm();
    }
    (total, middle / total)
}

/// The weight of a triangle: the area for a shell, else the volume of the pyramid from `tip`.
fn weight(triangle: &Triangle, tip: &Vector3<f64>, inertia: MeshInertia) -> f64 {
    let (centre, across) = facing(triangle);
    let pyramid = || (centre - tip).dot(&across) / 3.0;
    match inertia {
        MeshInertia::Shell => across.norm(),
        MeshInertia::Legacy => pyramid().abs(),
        MeshInertia::Convex | MeshInertia::Exact => pyramid(),
    }
}

/// The measure and the centre of mass. A pyramid's centre is a quarter of its height above the
/// base.
fn centre(triangles: &[Triangle], tip: &Vector3<f64>, inertia: MeshInertia) -> (f64, Vector3<f64>) {
    let mut total = 0.0;
    let mut moment = Vector3::zeros();
    for triangle in triangles {
        let share = weight(triangle, tip, inertia);
        let (middle, _) = facing(triangle);
        let at = if inertia == MeshInertia::Shell { middle } else { middle * 0.75 + tip * 0.25 };
        total += share;
        moment += at * share;
    }
    (total, moment / total)
}

/// The measure, and the inertia about the origin at unit density. The mean of x xᵀ over a
/// triangle with corners a, b, c is (s sᵀ + a aᵀ + b bᵀ + c cᵀ)/12 with s = a + b + c; over the
/// pyramid from the origin to it, 12/20 of that.
fn second(triangles: &[Triangle], inertia: MeshInertia) -> (f64, Matrix3<f64>) {
    let parts = if inertia == MeshInertia::Shell { 12.0 } else { 20.0 };
    let mut total = 0.0;
    let mut second = Matrix3::zeros();
    for triangle in triangles {
        let share = weight(triangle, &Vector3::zeros(), inertia);
        let [a, b, c] = triangle;
        let s = a + b + c;
        let mean = s * s.transpose() + a * a.transpose() + b * b.transpose() + c * c.transpose();
        total += share;
        second += mean * (share / parts);
    }
    (total, Matrix3::identity() * second.trace() - second)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block() -> (Vec<[f64; 3]>, Vec<[usize; 3]>) {
        let half = [0.3, 0.1, 0.2];
        let vertex = |i: usize| {
            crate::real::array::from_fn(
                |k| if i >> k & 1 == 1 { half[k] } else { -half[k] } + k as f64,
            )
        };
        let vertices: Vec<[f64; 3]> = (0..8).map(vertex).collect();
        let hull = crate::shapes::hull::Hull::of(&vertices).unwrap();
        (vertices, hull.triangles)
    }

    #[test]
    fn a_block_weighs_what_its_formula_says_in_every_mode() {
        let (vertices, faces) = block();
        let (a, b, c) = (0.3_f64, 0.1, 0.2);
        for inertia in [MeshInertia::Exact, MeshInertia::Legacy, MeshInertia::Convex] {
            let solid = Solid::of(&vertices, &faces, inertia).unwrap();
            assert!((solid.measure / (8.0 * a * b * c) - 1.0).abs() < 1e-14);
            assert!((solid.centre - Vector3::new(0.0, 1.0, 2.0)).norm() < 1e-14);
            let moments = [a * a + c * c, a * a + b * b, b * b + c * c].map(|m| m / 3.0);
            for k in 0..3 {
                assert!((solid.inertia[(k, k)] / moments[k] - 1.0).abs() < 1e-13);
            }
        }
        let shell = Solid::of(&vertices, &faces, MeshInertia::Shell).unwrap();
        assert!((shell.measure / (8.0 * (a * b + b * c + c * a)) - 1.0).abs() < 1e-14);
    }

    #[test]
    fn nothing_and_inside_out_are_refused() {
        let (vertices, mut faces) = block();
        let flat: Vec<[f64; 3]> = vertices.iter().map(|v| [v[0], v[1], 0.5]).collect();
        assert_eq!(Solid::of(&flat, &faces, MeshInertia::Exact).unwrap_err(), Unsolid::Nothing);
        faces.iter_mut().for_each(|face| face.swap(0, 1));
        let out = Solid::of(&vertices, &faces, MeshInertia::Exact);
        assert_eq!(out.unwrap_err(), Unsolid::InsideOut);
        assert!(Solid::of(&vertices, &faces, MeshInertia::Legacy).is_ok());
    }
}
