//! Hulls against brute force, closed forms and each other.

use super::hull::{Face, Hull};
use nalgebra::{Matrix3, Rotation3, Vector3};

/// A reproducible sequence of numbers in [0, 1): xorshift64*.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) as f64 / (1_u64 << 53) as f64
    }
    fn point(&mut self) -> [f64; 3] {
        crate::real::array::from_fn(|_| 2.0 * self.next() - 1.0)
    }
}

/// The laws of a closed convex polytope.
fn check(hull: &Hull, points: &[[f64; 3]]) {
    let size = points.iter().flatten().fold(0.0, |m: f64, x| m.max(x.abs()));
    assert_eq!(hull.vertices.len() + hull.faces.len(), hull.edges.len() + 2 + inner(hull));
    assert_eq!(hull.vertices.len() + hull.triangles.len(), hull.triangles.len() * 3 / 2 + 2);
    for face in &hull.faces {
        assert!((face.normal.norm() - 1.0).abs() < 1e-14);
        for p in points {
            assert!(face.normal.dot(&Vector3::from(*p)) <= face.offset + 1e-6 * size);
        }
        let n = face.corners.len();
        assert!(n >= 3 && face.edges.len() == n);
        for k in 0..n {
            let [a, b, c] = [0, 1, 2].map(|j| hull.vertices[face.corners[(k + j) % n]]);
            let across = c - a;
            assert!((b - a).cross(&across).dot(&face.normal) > -3e-6 * size * across.norm());
            let edge = &hull.edges[face.edges[k]];
            let ends = [face.corners[k], face.corners[(k + 1) % n]];
            assert!(edge.ends == ends || edge.ends == [ends[1], ends[0]]);
        }
    }
    // Every point is inside every triangle's plane, up to the grid's rounding.
    for corners in &hull.triangles {
        let [a, b, c] = corners.map(|i| hull.vertices[i]);
        let normal = (b - a).cross(&(c - a));
        let longest = (b - a).norm().max((c - a).norm()).max((c - b).norm());
        let height = normal.norm() / longest;
        for p in points {
            let above = normal.normalize().dot(&(Vector3::from(*p) - a));
            assert!(above <= 1e-10 * size * (1.0 + size / height), "{above} above {corners:?}");
        }
    }
}

/// Vertices that are no corner of a polygon.
fn inner(hull: &Hull) -> usize {
    let corner = |v: &usize| hull.faces.iter().any(|face| face.corners.contains(v));
    (0..hull.vertices.len()).filter(|v| !corner(v)).count()
}

/// Vertices by brute force: some plane through the point and two others has all on one side.
fn extreme(points: &[[f64; 3]]) -> Vec<usize> {
    let at: Vec<Vector3<f64>> = points.iter().map(|p| Vector3::from(*p)).collect();
    let n = at.len();
    let mut found = vec![false; n];
    for i in 0..n {
        for j in i + 1..n {
            for k in j + 1..n {
                let normal = (at[j] - at[i]).cross(&(at[k] - at[i]));
                let mut sides =
                    (0..n).filter(|m| ![i, j, k].contains(m)).map(|m| normal.dot(&(at[m] - at[i])));
                let first = sides.next().unwrap() > 0.0;
                if sides.all(|side| (side > 0.0) == first) {
                    [i, j, k].iter().for_each(|m| found[*m] = true);
                }
            }
        }
    }
    (0..n).filter(|i| found[*i]).collect()
}

#[test]
fn vertices_of_random_points_are_those_of_brute_force() {
    let mut random = Random(7);
    for round in 0..40 {
        let points: Vec<_> = (0..5 + round / 2).map(|_| random.point()).collect();
        let hull = Hull::of(&points).unwrap();
        check(&hull, &points);
        assert_eq!(hull.source, extreme(&points));
    }
}

#[test]
fn clouds_of_every_kind_make_closed_convex_hulls() {
    let mut random = Random(3);
    for round in 0..60 {
        let flat = [1.0, 1e-3, 1e-6][round % 3];
        let turn = Rotation3::from_euler_angles(random.next(), random.next(), random.next());
        let single = round % 2 == 1;
        let place = |p: [f64; 3]| {
            let x = turn * Vector3::new(p[0], p[1], flat * p[2]);
            // As stored in a file in single precision.
            if single { x.map(|c| f64::from(c as f32)) } else { x }.into()
        };
        let points: Vec<[f64; 3]> = (0..200)
            .map(|_| match round % 4 {
                0 => random.point(),
                1 => Vector3::from(random.point()).normalize().into(),
                // A lattice: most points lie in faces and on edges.
                2 => random.point().map(|x| (x * 3.0).round()),
                _ => random.point().map(|x| x.signum() * (1.0 - 1e-9 * x.abs())),
            })
            .map(place)
            .collect();
        check(&Hull::of(&points).unwrap(), &points);
    }
}

#[test]
fn a_cube_with_points_in_faces_and_edges_has_eight_corners_and_six_faces() {
    let grid = |i: usize| [i % 5, i / 5 % 5, i / 25].map(|k| 0.1 * k as f64 + 3.0);
    let points: Vec<_> = (0..125).map(grid).collect();
    let hull = Hull::of(&points).unwrap();
    check(&hull, &points);
    assert_eq!((hull.vertices.len(), hull.faces.len(), hull.edges.len()), (8, 6, 12));
    assert!(hull.faces.iter().all(|face| face.corners.len() == 4));
    assert!(hull.faces.iter().all(|face| face.normal.abs().max() == 1.0));
}

#[test]
fn a_turned_cube_in_single_precision_has_six_faces() {
    let mut random = Random(11);
    for _ in 0..50 {
        let turn = Rotation3::from_euler_angles(random.next(), random.next(), random.next());
        let grid = |i: usize| {
            let p = Vector3::from([i % 4, i / 4 % 4, i / 16].map(|k| k as f64 / 3.0));
            (turn * p).map(|x| f64::from(x as f32)).into()
        };
        let points: Vec<[f64; 3]> = (0..64).map(grid).collect();
        let hull = Hull::of(&points).unwrap();
        check(&hull, &points);
        assert_eq!((hull.faces.len(), hull.edges.len()), (6, 12));
        for face in &hull.faces {
            let own = turn.inverse() * face.normal;
            assert!((own.abs().max() - 1.0).abs() < 1e-7);
        }
    }
}

#[test]
fn prisms_have_two_polygons_and_their_sides() {
    for n in [3, 7, 64, 500] {
        let ring = |i: usize| {
            let angle = std::f64::consts::TAU * (i / 2) as f64 / n as f64;
            [0.04 * angle.cos(), 0.04 * angle.sin(), 0.3 * (i % 2) as f64]
        };
        let points: Vec<_> = (0..2 * n).map(ring).collect();
        let hull = Hull::of(&points).unwrap();
        check(&hull, &points);
        assert_eq!((hull.vertices.len(), hull.faces.len()), (2 * n, n + 2));
    }
}

#[test]
fn a_power_of_two_scales_a_hull_bit_for_bit() {
    let mut random = Random(5);
    let points: Vec<_> = (0..300).map(|_| random.point()).collect();
    let hull = Hull::of(&points).unwrap();
    for power in [-40, -7, 1, 12, 40] {
        let scale = 2.0_f64.powi(power);
        let scaled =
            Hull::of(&points.iter().map(|p| p.map(|x| x * scale)).collect::<Vec<_>>()).unwrap();
        assert_eq!(scaled.triangles, hull.triangles);
        assert_eq!(scaled.edges, hull.edges);
        for (a, b) in hull.vertices.iter().zip(&scaled.vertices) {
            assert_eq!(a * scale, *b);
        }
        for (a, b) in hull.faces.iter().zip(&scaled.faces) {
            assert_eq!((a.normal, a.offset * scale), (b.normal, b.offset));
            assert_eq!(a.corners, b.corners);
        }
    }
}

#[test]
fn the_order_of_points_does_not_matter() {
    let mut random = Random(9);
    let points: Vec<_> = (0..100).map(|_| random.point()).collect();
    let mut turned = points.clone();
    turned.reverse();
    let (a, b) = (Hull::of(&points).unwrap(), Hull::of(&turned).unwrap());
    let mut back: Vec<usize> = b.source.iter().map(|i| 99 - i).collect();
    back.sort_unstable();
    assert_eq!(a.source, back);
    assert_eq!(a.faces.len(), b.faces.len());
}

#[test]
fn the_support_is_the_furthest_vertex() {
    let mut random = Random(13);
    for n in [8, 20, 100, 2000] {
        let points: Vec<[f64; 3]> =
            (0..n).map(|_| Vector3::from(random.point()).normalize().into()).collect();
        let turn = *Rotation3::from_euler_angles(0.2, -0.3, 0.1).matrix();
        let hull = Hull::of(&points).unwrap().moved(&turn, &Vector3::new(0.1, 0.0, -0.2));
        for start in 0..200 {
            let direction = Vector3::from(random.point());
            let along = |v: &Vector3<f64>| v.dot(&direction);
            let most = hull.vertices.iter().map(along).fold(f64::NEG_INFINITY, f64::max);
            assert_eq!(along(&hull.vertices[hull.support(&direction)]), most);
            let from = start % hull.vertices.len();
            assert_eq!(along(&hull.vertices[hull.support_from(from, &direction)]), most);
            let looks = |face: &usize| hull.faces[*face].normal.dot(&direction);
            let first = (0..hull.faces.len()).rev().max_by(|a, b| looks(a).total_cmp(&looks(b)));
            assert_eq!(Some(hull.face(&direction)), first);
        }
    }
}

/// Planes by fours give the same as each face, bit for bit.
#[test]
fn a_point_is_outside_of_the_face_that_it_is_furthest_from() {
    let mut random = Random(19);
    for n in [4, 9, 60] {
        let points: Vec<_> = (0..n).map(|_| random.point()).collect();
        let given = Hull::of(&points).unwrap();
        let turn = *Rotation3::from_euler_angles(-0.4, 0.1, 0.7).matrix();
        for hull in [given.clone(), given.moved(&turn, &Vector3::new(-0.2, 0.3, 0.1))] {
            for _ in 0..50 {
                let p = Vector3::from(random.point());
                let above = |face: &Face| face.normal.dot(&p) - face.offset;
                let most = hull.faces.iter().map(above).fold(f64::NEG_INFINITY, f64::max);
                assert_eq!(hull.outside(&p), most);
            }
        }
    }
}

#[test]
fn at_most_so_many_vertices_and_all_of_them_points() {
    let mut random = Random(17);
    let points: Vec<[f64; 3]> =
        (0..500).map(|_| Vector3::from(random.point()).normalize().into()).collect();
    let mut before = 0.0;
    for most in [4, 5, 20, 100, 500] {
        let hull = Hull::of_at_most(&points, most).unwrap();
        assert_eq!(hull.vertices.len(), most);
        let volume: f64 = hull.triangles.iter().map(|t| pyramid(&hull, t)).sum();
        assert!(volume > before);
        before = volume;
    }
    assert!((before / (4.0 / 3.0 * std::f64::consts::PI) - 1.0).abs() < 0.03);
    assert!(Hull::of_at_most(&points, 3).is_err());
    // Most of these end up inside.
    let cloud: Vec<_> = (0..300).map(|_| random.point()).collect();
    for most in [4, 9, 20] {
        assert_eq!(Hull::of_at_most(&cloud, most).unwrap().vertices.len(), most);
    }
}

fn pyramid(hull: &Hull, corners: &[usize; 3]) -> f64 {
    let [a, b, c] = corners.map(|i| hull.vertices[i]);
    Matrix3::from_columns(&[a, b, c]).determinant() / 6.0
}

#[test]
fn what_has_no_volume_is_refused() {
    let line: Vec<[f64; 3]> =
        (0..9).map(|i| [0.3 * f64::from(i), 0.1 * f64::from(i), 0.0]).collect();
    let plane: Vec<[f64; 3]> =
        (0..9).map(|i| [f64::from(i % 3), f64::from(i / 3), 0.5 * f64::from(i % 3)]).collect();
    for (points, why) in [
        (vec![], "one point"),
        (vec![[1.0, 2.0, 3.0]; 12], "one point"),
        (line, "one line"),
        (plane, "one plane"),
        (vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, f64::NAN, 0.0], [0.0; 3]], "finite"),
    ] {
        let error = format!("{:?}", Hull::of(&points).unwrap_err());
        assert!(error.contains(why), "{error}");
    }
}

#[test]
fn a_block_is_the_hull_of_its_corners() {
    let hull = Hull::block([0.5, 0.25, 0.002]).unwrap();
    assert_eq!((hull.vertices.len(), hull.faces.len(), hull.edges.len()), (8, 6, 12));
    assert_eq!(hull.reach(), Vector3::new(0.5, 0.25, 0.002).norm());
    let turn = *Rotation3::from_euler_angles(0.3, 1.0, -0.4).matrix();
    let moved = hull.moved(&turn, &Vector3::new(1.0, 2.0, 3.0));
    for face in &moved.faces {
        for &corner in &face.corners {
            assert!((face.normal.dot(&moved.vertices[corner]) - face.offset).abs() < 1e-14);
        }
    }
}
