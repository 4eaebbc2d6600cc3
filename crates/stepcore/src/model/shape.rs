//! Volume, surface and inertia of the shapes, solid or as a thin shell.

use crate::real::elementary::pow;
use crate::scene::{Geom, GeomType};
use nalgebra::Vector3;
use std::f64::consts::PI;

/// Volume of the solid, or area of its surface.
pub fn measure(g: &Geom) -> f64 {
    let [a, b, c] = g.size;
    match (g.kind, g.shell_inertia) {
        // A mesh's measure is in its `Solid`.
        (GeomType::Plane | GeomType::HField | GeomType::Mesh, _) => 0.0,
        (GeomType::Sphere, false) => 4.0 / 3.0 * PI * a * a * a,
        (GeomType::Sphere, true) => 4.0 * PI * a * a,
        (GeomType::Capsule, false) => PI * a * a * (2.0 * b + 4.0 / 3.0 * a),
        (GeomType::Capsule, true) => 4.0 * PI * a * (b + a),
        (GeomType::Cylinder, false) => 2.0 * PI * a * a * b,
        (GeomType::Cylinder, true) => 2.0 * PI * a * (2.0 * b + a),
        (GeomType::Box, false) => 8.0 * a * b * c,
        (GeomType::Box, true) => 8.0 * (a * b + b * c + c * a),
        (GeomType::Ellipsoid, false) => 4.0 / 3.0 * PI * a * b * c,
        // Thomsen's approximation, within 1.1 % of the elliptic integral.
        (GeomType::Ellipsoid, true) => {
            const P: f64 = 1.6075;
            let mean = (pow(a * b, P) + pow(b * c, P) + pow(c * a, P)) / 3.0;
            4.0 * PI * pow(mean, 1.0 / P)
        }
    }
}

/// Principal moments of a shape of unit mass, about its centre, in its axes.
pub fn unit_inertia(g: &Geom) -> Vector3<f64> {
    let [a, b, c] = g.size;
    let round = |across: f64, along: f64| Vector3::new(across, across, along);
    let moments = |xx: f64, yy: f64, zz: f64| Vector3::new(yy + zz, xx + zz, xx + yy);
    match (g.kind, g.shell_inertia) {
        (GeomType::Plane | GeomType::HField | GeomType::Mesh, _) => Vector3::zeros(),
        (GeomType::Sphere, false) => round(0.4 * a * a, 0.4 * a * a),
        (GeomType::Sphere, true) => round(2.0 / 3.0 * a * a, 2.0 / 3.0 * a * a),
        // A tube or rod, and two halves of a sphere whose centres of mass lie
        // 3/8 a (solid) or 1/2 a (shell) beyond its ends.
        (GeomType::Capsule, false) => {
            let (rod, caps) =
                (2.0 * b / (2.0 * b + 4.0 / 3.0 * a), 4.0 / 3.0 * a / (2.0 * b + 4.0 / 3.0 * a));
            let across =
                rod * (a * a / 4.0 + b * b / 3.0) + caps * (0.4 * a * a + b * b + 0.75 * a * b);
            round(across, rod * a * a / 2.0 + caps * 0.4 * a * a)
        }
        (GeomType::Capsule, true) => {
            let (tube, caps) = (b / (a + b), a / (a + b));
            let across =
                tube * (a * a / 2.0 + b * b / 3.0) + caps * (2.0 / 3.0 * a * a + b * b + a * b);
            round(across, tube * a * a + caps * (2.0 / 3.0 * a * a))
        }
        (GeomType::Cylinder, false) => round(a * a / 4.0 + b * b / 3.0, a * a / 2.0),
        (GeomType::Cylinder, true) => {
            let (tube, lids) = (2.0 * b / (2.0 * b + a), a / (2.0 * b + a));
            let across = tube * (a * a / 2.0 + b * b / 3.0) + lids * (a * a / 4.0 + b * b);
            round(across, tube * a * a + lids * a * a / 2.0)
        }
        (GeomType::Box, false) => moments(a * a / 3.0, b * b / 3.0, c * c / 3.0),
        // On the two faces across an axis its coordinate is the half size, on
        // the other four its square averages a third of that.
        (GeomType::Box, true) => {
            let (x, y, z) = (b * c, c * a, a * b);
            let mean =
                |s: f64, across: f64| s * s * (across + (x + y + z - across) / 3.0) / (x + y + z);
            moments(mean(a, x), mean(b, y), mean(c, z))
        }
        (GeomType::Ellipsoid, false) => moments(a * a / 5.0, b * b / 5.0, c * c / 5.0),
        // The gain of an ellipsoid while its half axes all grow by the same small length: the limit
        // of the difference that MuJoCo takes.
        (GeomType::Ellipsoid, true) => {
            let area = a * b + b * c + c * a;
            let gain = |s: f64, t: f64, u: f64| (s * s * area + 2.0 * s * s * t * u) / (5.0 * area);
            moments(gain(a, b, c), gain(b, c, a), gain(c, a, b))
        }
    }
}
