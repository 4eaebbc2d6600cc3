//! Each ray against the shape's equation: the point found is on the surface, no point before it is, and
//! the normal is the direction in which the surface is left.

use super::*;
use crate::shapes::trial::Random;

/// Negative inside.
fn inside(kind: GeomType, s: &[f64; 3], p: &V) -> f64 {
    let r = p.xy().norm();
    match kind {
        GeomType::Sphere => p.norm() - s[0],
        GeomType::Capsule => (p - V::new(0.0, 0.0, p.z.clamp(-s[1], s[1]))).norm() - s[0],
        GeomType::Cylinder => (r - s[0]).max(p.z.abs() - s[1]),
        GeomType::Ellipsoid => p.component_div(&V::from(*s)).norm() - 1.0,
        _ => (0..3).map(|k| p[k].abs() - s[k]).fold(f64::NEG_INFINITY, f64::max),
    }
}

#[test]
fn the_first_point_of_the_surface_is_found() {
    let mut random = Random(5);
    let kinds = [
        GeomType::Sphere,
        GeomType::Capsule,
        GeomType::Cylinder,
        GeomType::Ellipsoid,
        GeomType::Box,
    ];
    let mut hits = 0;
    for round in 0..2000 {
        let kind = kinds[round % kinds.len()];
        let size = [0; 3].map(|_| 0.4 + 0.3 * random.next());
        let mut vector = |k: f64| V::new(random.next(), random.next(), random.next()) * k;
        let from = vector(1.5);
        // Towards some point in the middle.
        let ray = Ray { from, along: vector(0.8) - from };
        let start = inside(kind, &size, &ray.from);
        let end = match primitive(kind, &size, &ray) {
            Some(hit) => {
                hits += 1;
                let point = ray.at(hit.at);
                assert!(inside(kind, &size, &point).abs() < 1e-9, "{kind:?}");
                assert!((hit.normal.norm() - 1.0).abs() < 1e-12);
                assert!(inside(kind, &size, &(point + hit.normal * 1e-6)) > 0.0, "{kind:?}");
                hit.at
            }
            None => 10.0,
        };
        // Until then the ray stays on its side of the surface.
        for k in 1..200 {
            let now = inside(kind, &size, &ray.at(end * f64::from(k) / 200.0));
            assert!(now * start > -1e-9, "{kind:?} {k}");
        }
    }
    assert!(hits > 500);
}

#[test]
fn a_field_is_met_at_its_top_its_sides_and_its_base() {
    let heights = vec![0.0, 0.2, 0.1, 0.3, 0.4, 0.0, 0.2, 0.1, 0.2];
    let field = HeightField { nrow: 3, ncol: 3, half: [1.0, 0.5], base: 0.3, heights };
    let shoot = |from: [f64; 3], along: [f64; 3]| {
        let (from, along) = (V::from(from), V::from(along));
        height_field(&field, &Ray { from, along })
    };
    // The diagonal from the corner of least x and y: heights 0 and 0.4 at its ends.
    assert!((shoot([-0.5, -0.25, 2.0], [0.0, 0.0, -1.0]).unwrap().at - 1.8).abs() < 1e-12);
    let below = shoot([0.1, 0.1, -2.0], [0.0, 0.0, 2.0]).unwrap();
    assert!((below.at - 0.85).abs() < 1e-12 && below.normal == -V::z());
    // Over x = 1 the edge goes from 0.1 by 0 to 0.2.
    let side = shoot([3.0, -0.4, 0.05], [-1.0, 0.0, 0.0]).unwrap();
    assert!((side.at - 2.0).abs() < 1e-12 && side.normal == V::x());
    let over = shoot([3.0, -0.1, 0.05], [-1.0, 0.0, 0.0]).unwrap();
    assert!(over.at > 2.0, "{over:?}");
    assert!(shoot([3.0, 0.0, 0.5], [-1.0, 0.0, 0.0]).is_none());
}
