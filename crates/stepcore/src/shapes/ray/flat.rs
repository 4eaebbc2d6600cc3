//! Rays against a plane and a box.

use super::{nearer, Hit, Ray, V};

/// Returns the hit on the front of a plane z = 0.
pub(super) fn plane(size: &[f64; 3], ray: &Ray) -> Option<Hit> {
    if ray.along.z >= 0.0 {
        return None;
    }
    let at = -ray.from.z / ray.along.z;
    let point = ray.at(at);
    let within = |x: f64, half: f64| half <= 0.0 || x.abs() <= half;
    let seen = at >= 0.0 && within(point.x, size[0]) && within(point.y, size[1]);
    seen.then_some(Hit { at, normal: V::z() })
}

/// A face of a box about the origin: axis 0 to 2, side −1 or 1.
pub(super) fn face(half: &V, axis: usize, side: f64, ray: &Ray) -> Option<Hit> {
    if ray.along[axis] == 0.0 {
        return None;
    }
    let at = (side * half[axis] - ray.from[axis]) / ray.along[axis];
    let point = ray.at(at);
    let within = (0..3).all(|k| k == axis || point[k].abs() <= half[k]);
    let mut normal = V::zeros();
    normal[axis] = side;
    (at >= 0.0 && within).then_some(Hit { at, normal })
}

/// A box about the origin.
pub(super) fn cuboid(half: &V, ray: &Ray) -> Option<Hit> {
    let faces = (0..3).flat_map(|axis| [-1.0, 1.0].map(|side| (axis, side)));
    faces.map(|(axis, side)| face(half, axis, side, ray)).fold(None, nearer)
}
