//! Rays against spheres, capsules, cylinders and ellipsoids: roots of a x² + 2 b x + c.

use super::{nearer, Hit, Ray, V};

/// Returns both roots, the smaller first; None if the ray misses or touches.
fn roots(a: f64, b: f64, c: f64) -> Option<[f64; 2]> {
    let square = b * b - a * c;
    if square <= 0.0 || a == 0.0 {
        return None;
    }
    let root = square.sqrt();
    Some([(-b - root) / a, (-b + root) / a])
}

/// Returns the first point ahead that `accept` takes.
fn first(roots: Option<[f64; 2]>, ray: &Ray, accept: impl Fn(&V) -> bool) -> Option<(f64, V)> {
    let ahead = roots?.into_iter().filter(|at| *at >= 0.0);
    ahead.map(|at| (at, ray.at(at))).find(|(_, point)| accept(point))
}

/// The part of a sphere that `accept` takes.
fn sphere_part(radius: f64, centre: &V, ray: &Ray, accept: impl Fn(&V) -> bool) -> Option<Hit> {
    let (from, along) = (ray.from - centre, ray.along);
    let found = roots(along.dot(&along), along.dot(&from), from.dot(&from) - radius * radius);
    first(found, ray, accept).map(|(at, point)| Hit { at, normal: (point - centre) / radius })
}

pub(super) fn sphere(radius: f64, centre: &V, ray: &Ray) -> Option<Hit> {
    sphere_part(radius, centre, ray, |_| true)
}

/// The round side of a cylinder about z. Only the first of the two points ahead is tested: the side is
/// never visible through an open end.
fn side(radius: f64, half: f64, ray: &Ray) -> Option<Hit> {
    let (p, d) = (ray.from.xy(), ray.along.xy());
    let found = roots(d.dot(&d), d.dot(&p), p.dot(&p) - radius * radius);
    let (at, point) = first(found, ray, |_| true)?;
    let normal = V::new(point.x / radius, point.y / radius, 0.0);
    (point.z.abs() <= half).then_some(Hit { at, normal })
}

pub(super) fn capsule(radius: f64, half: f64, ray: &Ray) -> Option<Hit> {
    let cap = |end: f64| {
        let centre = V::new(0.0, 0.0, end * half);
        sphere_part(radius, &centre, ray, |point| point.z * end >= half)
    };
    nearer(nearer(side(radius, half, ray), cap(1.0)), cap(-1.0))
}

pub(super) fn cylinder(radius: f64, half: f64, ray: &Ray) -> Option<Hit> {
    let end = |end: f64| {
        if ray.along.z == 0.0 {
            return None;
        }
        let at = (end * half - ray.from.z) / ray.along.z;
        let point = ray.at(at).xy();
        let normal = V::new(0.0, 0.0, end);
        (at >= 0.0 && point.dot(&point) <= radius * radius).then_some(Hit { at, normal })
    };
    nearer(nearer(end(-1.0), end(1.0)), side(radius, half, ray))
}

pub(super) fn ellipsoid(size: &V, ray: &Ray) -> Option<Hit> {
    let unit = |v: &V| v.component_div(size);
    let (p, d) = (unit(&ray.from), unit(&ray.along));
    let found = roots(d.dot(&d), d.dot(&p), p.dot(&p) - 1.0);
    let (at, point) = first(found, ray, |_| true)?;
    // The gradient of Σ (x/s)².
    Some(Hit { at, normal: unit(&unit(&point)).normalize() })
}
