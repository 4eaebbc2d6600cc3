//! The first point where a ray meets a shape: MuJoCo's `mj_ray`, shape by shape.
//!
//! A ray is p + x·d with x ≥ 0, in the frame of the shape; d need not have unit length, and x is in
//! lengths of d. A ray that starts inside a shape hits its surface from within. A plane is visible from
//! its front only and within its half sizes, if these are not 0.

mod flat;
mod round;
mod surface;

use super::height_field::HeightField;
use crate::scene::GeomType;
use nalgebra::Vector3;

pub use surface::Surface;

type V = Vector3<f64>;

/// A ray in the frame of a shape.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    pub from: V,
    pub along: V,
}

/// The point where a ray meets a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// In lengths of the ray's direction.
    pub at: f64,
    /// Outward, of unit length, in the frame of the shape.
    pub normal: V,
}

impl Ray {
    fn at(&self, x: f64) -> V {
        self.from + self.along * x
    }
}

/// Returns the nearer of two hits.
fn nearer(one: Option<Hit>, other: Option<Hit>) -> Option<Hit> {
    match (one, other) {
        (Some(a), Some(b)) => Some(if b.at < a.at { b } else { a }),
        (a, b) => a.or(b),
    }
}

/// Returns the first point of a primitive that the ray meets; None for a mesh or a height field.
pub fn primitive(kind: GeomType, size: &[f64; 3], ray: &Ray) -> Option<Hit> {
    match kind {
        GeomType::Plane => flat::plane(size, ray),
        GeomType::Box => flat::cuboid(&V::from(*size), ray),
        GeomType::Sphere => round::sphere(size[0], &V::zeros(), ray),
        GeomType::Capsule => round::capsule(size[0], size[1], ray),
        GeomType::Cylinder => round::cylinder(size[0], size[1], ray),
        GeomType::Ellipsoid => round::ellipsoid(&V::from(*size), ray),
        GeomType::Mesh | GeomType::HField => None,
    }
}

/// Checks whether a point, in the frame of a primitive, is within it. A plane has no inside.
pub fn inside(kind: GeomType, size: &[f64; 3], point: &V) -> bool {
    let [a, b, _] = *size;
    match kind {
        GeomType::Sphere => point.norm() < a,
        GeomType::Capsule => {
            let along = point.z.clamp(-b, b);
            (point - V::new(0.0, 0.0, along)).norm() < a
        }
        GeomType::Cylinder => point.z.abs() < b && point.xy().norm() < a,
        GeomType::Ellipsoid => point.component_div(&V::from(*size)).norm() < 1.0,
        GeomType::Box => (0..3).all(|k| point[k].abs() < size[k]),
        GeomType::Plane | GeomType::Mesh | GeomType::HField => false,
    }
}

/// Returns the first point of a height field that the ray meets: of its top, its sides or its base.
pub fn height_field(field: &HeightField, ray: &Ray) -> Option<Hit> {
    surface::height_field(field, ray)
}

#[cfg(test)]
mod tests;
