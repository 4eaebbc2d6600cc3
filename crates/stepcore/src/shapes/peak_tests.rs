//! Rims, plates and small shapes at large ones: cases in which a search over directions may miss the
//! answer.

use super::by_lane::by_lane;
use super::convex::{solid, Convex};
use super::epa::Polytope;
use super::gjk::Vertex;
use super::hull::Hull;
use super::separation::Pairing;
use super::touch::Touches;
use super::trial::{at, Random};
use super::Shape;
use crate::scene::GeomType::{self, Box, Cylinder, Ellipsoid, Mesh};
use crate::spatial::{Pose, Quat, V3};

fn pose([x, y, z, w, a, b, c]: [f64; 7]) -> Pose<f64> {
    Pose { pos: V3::new(x, y, z), rot: Quat::of(&[w, a, b, c]).normalized().matrix() }
}

fn touches(kinds: [GeomType; 2], shapes: [Shape<f64>; 2]) -> Touches<f64, 8> {
    let test = Convex { one: kinds[0], two: kinds[1], within: f64::INFINITY, hint: None };
    by_lane(|_| test, &shapes[0], &shapes[1])
}

/// The deepest contact is as deep along its normal as its distance, its points belong to both shapes,
/// and no direction has a larger separation, near the normal or far from it.
fn check(kinds: [GeomType; 2], shapes: [Shape<f64>; 2]) -> f64 {
    let found = touches(kinds, shapes);
    let there = found.iter().filter(|touch| touch.exists);
    let first = there.min_by(|a, b| a.dist.total_cmp(&b.dist)).unwrap();
    let [one, two] = [solid(kinds[0], &shapes[0]), solid(kinds[1], &shapes[1])];
    let pairing = Pairing::new(one, two);
    let tiny = 1e-14 * (one.extent() + two.extent());
    assert!((pairing.apart(&first.normal) - first.dist).abs() < tiny);
    let half = first.normal * (0.5 * first.dist);
    for (solid, point) in [(one, first.pos - half), (two, first.pos + half)] {
        let out = solid.outside(&(point - solid.pose.pos));
        assert!(out < 1e4 * tiny, "{kinds:?}: {out:e}");
    }
    let mut random = Random(5);
    for k in 0..20_000 {
        let spread = 10.0_f64.powi(1 - k % 9);
        let way = (first.normal + random.vector() * spread).normalize();
        let better = pairing.apart(&way) - first.dist;
        assert!(better < tiny, "{kinds:?}: {better:e} at {way:?}, not {:?}", first.normal);
    }
    first.dist
}

/// The cap's normal is nearly the shortest way out; a leaning one, past the rim, is.
#[test]
fn a_small_box_at_the_rim_of_a_large_cylinder() {
    let can = [0.362_351_811, 0.575_998_12, 0.0];
    let chip = [8.414_563e-4, 7.368_969e-4, 4.745_048e-4];
    let p = pose([
        -0.608_944_744,
        0.520_028_075,
        0.974_874_368,
        -0.288_608_909,
        -0.246_620_099,
        -0.385_034_532,
        -0.841_208_555,
    ]);
    let q = pose([
        -1.040_851_131,
        0.529_911_801,
        0.449_650_906,
        0.096_529_936,
        0.947_919_569,
        -0.175_514_089,
        -0.247_639_388,
    ]);
    let shapes = [
        Shape { pose: &p, size: &can, hull: None, field: None },
        Shape { pose: &q, size: &chip, hull: None, field: None },
    ];
    let dist = check([Cylinder, Box], shapes);
    // The cap's normal would give 0.001029.
    assert!((dist + 0.001_025_58).abs() < 1e-8, "{dist}");
}

/// Plates of 4 mm: facets of a mesh as near to one another as the ellipsoid bends, for any axes of the
/// mesh.
#[test]
fn a_plate_ellipsoid_in_a_plate_mesh() {
    let plate = [0.002, 0.233, 0.202];
    let corners: [[f64; 3]; 11] = [
        [-0.0735, 0.3922, 8e-4],
        [0.2678, 0.048, 9e-4],
        [-0.1227, -0.2877, 1e-4],
        [-0.2243, 0.1997, 5e-4],
        [-0.3437, -0.0655, -1e-4],
        [-0.1162, 0.2897, -5e-4],
        [0.1484, 0.1004, -1.4e-3],
        [0.0162, 0.1592, 1.6e-3],
        [-0.0935, 0.162, -1.3e-3],
        [-5e-4, -0.256, 9e-4],
        [-0.2044, -0.2387, 5e-4],
    ];
    let p = pose([0.225, -0.001, -0.106, -0.394, -0.399, -0.344, -0.753]);
    let q = pose([0.09, -0.141, -0.315, 0.716, 0.24, 0.635, -0.162]);
    let mut random = Random(3);
    for _ in 0..12 {
        let turn = random.pose(0.0).rot;
        let turned: Vec<[f64; 3]> =
            corners.iter().map(|c| (turn.transpose() * V3::from(*c)).into()).collect();
        let hull = Hull::of(&turned).unwrap();
        let q = Pose { rot: q.rot * turn, ..q };
        let shapes = [
            Shape { pose: &p, size: &plate, hull: None, field: None },
            Shape { pose: &q, size: &[0.0; 3], hull: Some(&hull), field: None },
        ];
        let dist = check([Ellipsoid, Mesh], shapes);
        assert!((dist + 0.080_828_699_253_122_7).abs() < 1e-14, "{dist}");
    }
}

/// Two cylinders with parallel axes, one next to and above the other: rim to rim, a closed form.
#[test]
fn the_rims_of_upright_cylinders() {
    let mut random = Random(7);
    for _ in 0..300 {
        let (a, b) = (random.size(), random.size());
        let (turn, up) = (random.next() * 3.2, 0.3 * (1.0 + random.next()));
        let aside = 10.0_f64.powf(2.0 * random.next() - 2.0);
        let between = a[0] + b[0] + aside;
        let way = V3::new(turn.cos(), turn.sin(), 0.0);
        let p = at(0.0, 0.0, 0.0);
        let q = Pose { pos: way * between + V3::z() * (a[1] + b[1] + up), ..p };
        let shapes = [
            Shape { pose: &p, size: &a, hull: None, field: None },
            Shape { pose: &q, size: &b, hull: None, field: None },
        ];
        let dist = check([Cylinder, Cylinder], shapes);
        assert!((dist - aside.hypot(up)).abs() < 1e-14 * between, "{dist}");
    }
}

/// A tile, nearly flat on a cap but between the rim and the corners that represent it.
#[test]
fn a_small_tile_over_the_edge_of_a_cap() {
    let (can, tile) = ([0.95, 0.4, 0.0], [1e-3, 2e-3, 5e-4]);
    for k in 0..64 {
        let angle = f64::from(k) * 0.098_174_770_424_681;
        let p = at(0.0, 0.0, 0.0);
        let place = V3::new(angle.cos(), angle.sin(), 0.0) * 0.9495;
        let rot = Quat::of(&[1.0, 0.03, 0.02, 0.3]).normalized().matrix();
        let q = Pose { pos: place + V3::z() * 0.399, rot };
        let shapes = [
            Shape { pose: &p, size: &can, hull: None, field: None },
            Shape { pose: &q, size: &tile, hull: None, field: None },
        ];
        check([Cylinder, Box], shapes);
    }
}

/// The difference of two crossed needles: along the axes it reaches furthest at four corners of one
/// plane. It is flat only if it is as thin along the plane's normal.
#[test]
fn a_plate_askew_has_a_volume() {
    let (a, b) = (V3::new(0.4, 0.12, 0.08), V3::new(0.08, 0.3, 0.27));
    let up = a.cross(&b).normalize();
    for (thick, there) in [(1e-3, true), (1e-9, true), (0.0, false)] {
        let points = [a + b, a - b, b - a, -a - b, up * thick, up * -thick]
            .map(|at| Vertex { at, pieces: [0; 2] });
        let further = |way: &V3<f64>, a: &Vertex, b: &Vertex| b.at.dot(way) > a.at.dot(way);
        let support = |way: &V3<f64>| {
            points.iter().fold(points[0], |far, p| if further(way, &far, p) { *p } else { far })
        };
        for seeds in [&points[..0], &points[..1], &points[..3], &points[..4]] {
            assert_eq!(Polytope::default().start(&support, seeds, 16), there, "{thick}");
        }
    }
}
