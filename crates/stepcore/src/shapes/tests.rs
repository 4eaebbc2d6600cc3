//! Tests of the shape pairs: closed forms, laws that hold for every pair, and
//! numbers of MuJoCo 4.0.0 where its choice is one of several.

use super::capsule::capsule_capsule;
use super::plane::{plane_box, plane_capsule, plane_cylinder, plane_ellipsoid, plane_sphere};
use super::sphere::{sphere_box, sphere_capsule, sphere_sphere};
use super::touch::Touch;
use super::trial::{at, Random};
use crate::detect::tangents;
use crate::real::{Lanes, Mask, Real, WIDTH};
use crate::spatial::Pose;
use nalgebra::{Matrix3, Rotation3, Vector3};

type Size = [f64; 3];

#[derive(Clone, Copy, Debug, PartialEq)]
enum Pair {
    PlaneSphere,
    PlaneCapsule,
    PlaneEllipsoid,
    PlaneCylinder,
    PlaneBox,
    SphereSphere,
    SphereCapsule,
    SphereBox,
    CapsuleCapsule,
}
use Pair::*;
const PAIRS: [Pair; 9] = [
    PlaneSphere,
    PlaneCapsule,
    PlaneEllipsoid,
    PlaneCylinder,
    PlaneBox,
    SphereSphere,
    SphereCapsule,
    SphereBox,
    CapsuleCapsule,
];

fn touch<R: Real>(pair: Pair, a: &Pose<R>, sa: [R; 3], b: &Pose<R>, sb: [R; 3]) -> Vec<Touch<R>> {
    match pair {
        PlaneSphere => plane_sphere(a, b, sb[0]).to_vec(),
        PlaneCapsule => plane_capsule(a, b, sb[0], sb[1]).to_vec(),
        PlaneEllipsoid => plane_ellipsoid(a, b, sb.into()).to_vec(),
        PlaneCylinder => plane_cylinder(a, b, sb[0], sb[1]).to_vec(),
        PlaneBox => plane_box(a, b, sb.into()).to_vec(),
        SphereSphere => sphere_sphere(a, sa[0], b, sb[0]).to_vec(),
        SphereCapsule => sphere_capsule(a, sa[0], b, sb[0], sb[1]).to_vec(),
        SphereBox => sphere_box(a, sa[0], b, sb.into()).to_vec(),
        CapsuleCapsule => capsule_capsule(a, sa[0], sa[1], b, sb[0], sb[1]).to_vec(),
    }
}

/// Every number of a contact and its frame, in one lane.
fn numbers<R: Real>(pair: Pair, b: &Pose<R>, touches: &[Touch<R>], lane: usize) -> Vec<f64> {
    let axis = b.axis(2);
    let mut out = Vec::new();
    for touch in touches {
        let (y, z) = tangents(&touch.normal, (pair == PlaneCapsule).then_some(&axis));
        out.push(f64::from(touch.exists.lane(lane)));
        out.push(touch.dist.lane(lane));
        out.push(touch.feature.lane(lane));
        for v in [touch.pos, touch.normal, y, z] {
            out.extend(v.iter().map(|x| x.lane(lane)));
        }
    }
    out
}

impl Random {
    /// Two poses: any, nearly parallel, parallel, in one place, or with a zero length.
    fn scene(&mut self, case: usize) -> (Pose<f64>, Size, Pose<f64>, Size) {
        let turn = Rotation3::new(self.vector() * 3.0);
        let a = Pose { pos: self.vector(), rot: turn.into_inner() };
        let mut b = Pose { pos: self.vector(), rot: Rotation3::new(self.vector() * 3.0).into() };
        let (sa, mut sb) = (self.size(), self.size());
        match case % 6 {
            1 => b.rot = (Rotation3::new(self.vector() * 1e-4) * turn).into(),
            2 => b.rot = a.rot,
            3 => b = a,
            4 => sb[1] = 0.0,
            5 => b.pos = a.pos + self.vector() * 0.1,
            _ => {}
        }
        (a, sa, b, sb)
    }
}

#[test]
fn lanes_are_scalars_bit_for_bit() {
    let mut random = Random(1);
    for pair in PAIRS {
        for round in 0..200 {
            let scenes: Vec<_> = (0..WIDTH).map(|i| random.scene(i * (round % 3))).collect();
            let gather =
                |f: &dyn Fn(usize) -> f64| -> Lanes { Lanes(crate::real::array::from_fn(f)) };
            let pose = |of: &dyn Fn(usize) -> Pose<f64>| Pose {
                pos: Vector3::from_fn(|r, _| gather(&|i| of(i).pos[r])),
                rot: Matrix3::from_fn(|r, c| gather(&|i| of(i).rot[(r, c)])),
            };
            let sa = crate::real::array::from_fn(|k| gather(&|i| scenes[i].1[k]));
            let sb = crate::real::array::from_fn(|k| gather(&|i| scenes[i].3[k]));
            let (a, b) = (pose(&|i| scenes[i].0), pose(&|i| scenes[i].2));
            let wide = touch(pair, &a, sa, &b, sb);
            for (i, (a, sa, b, sb)) in scenes.iter().enumerate() {
                let bits = |v: Vec<f64>| v.into_iter().map(f64::to_bits).collect::<Vec<_>>();
                let alone = numbers(pair, b, &touch(pair, a, *sa, b, *sb), 0);
                let lane = numbers(pair, &pose(&|i| scenes[i].2), &wide, i);
                assert_eq!(bits(alone), bits(lane), "{pair:?}, lane {i}");
            }
        }
    }
}

#[test]
fn every_case_is_finite_and_framed() {
    let mut random = Random(2);
    for pair in PAIRS {
        for case in 0..1200 {
            let (a, sa, b, sb) = random.scene(case);
            let touches = touch(pair, &a, sa, &b, sb);
            assert!(touches[0].exists);
            assert!(numbers(pair, &b, &touches, 0).iter().all(|x| x.is_finite()));
            let axis = b.axis(2);
            for touch in touches {
                let hint = (pair == PlaneCapsule).then_some(&axis);
                let (y, z) = tangents(&touch.normal, hint);
                let frame = Matrix3::from_columns(&[touch.normal, y, z]);
                let off = frame.transpose() * frame - Matrix3::identity();
                assert!(off.amax() < 1e-12, "{pair:?}, case {case}: {frame}");
                assert!(frame.determinant() > 0.0);
            }
        }
    }
}

#[test]
fn lengths_scale_by_powers_of_two_bit_for_bit() {
    let mut random = Random(3);
    for pair in PAIRS {
        for case in 0..600 {
            let (a, sa, b, sb) = random.scene(case);
            let one = touch(pair, &a, sa, &b, sb);
            for power in [-40, -3, 5, 40] {
                let k = 2f64.powi(power);
                let far = |p: &Pose<f64>| Pose { pos: p.pos * k, rot: p.rot };
                let more = touch(pair, &far(&a), sa.map(|x| x * k), &far(&b), sb.map(|x| x * k));
                for (x, y) in one.iter().zip(&more) {
                    assert_eq!((x.dist * k, x.pos * k), (y.dist, y.pos), "{pair:?}, {case}");
                    assert_eq!((x.normal, x.exists), (y.normal, y.exists), "{pair:?}, {case}");
                }
            }
        }
    }
}

#[test]
fn exchanging_like_shapes_turns_the_normal_round() {
    let mut random = Random(4);
    for pair in [SphereSphere, CapsuleCapsule] {
        for case in [0, 2, 4, 5].repeat(100) {
            let (a, sa, b, sb) = random.scene(case);
            let (there, back) = (touch(pair, &a, sa, &b, sb), touch(pair, &b, sb, &a, sa));
            assert_eq!(there.len(), back.len());
            assert!(there.iter().zip(&back).all(|(x, y)| x.exists == y.exists));
            for x in there.iter().filter(|x| x.exists) {
                let found = back.iter().filter(|y| y.exists).any(|y| {
                    let same = (x.dist - y.dist).abs() + (x.pos - y.pos).amax();
                    same + (x.normal + y.normal).amax() < 1e-9
                });
                assert!(found, "{pair:?}, case {case}");
            }
        }
    }
}

#[test]
fn single_precision_agrees() {
    let mut random = Random(5);
    for pair in PAIRS {
        for _ in 0..200 {
            let (a, sa, b, sb) = random.scene(0);
            let low =
                |p: &Pose<f64>| Pose { pos: p.pos.map(|x| x as f32), rot: p.rot.map(|x| x as f32) };
            let small = |s: Size| s.map(|x| x as f32);
            let f32s = touch(pair, &low(&a), small(sa), &low(&b), small(sb));
            let f64s = touch(pair, &a, sa, &b, sb);
            assert!((f64::from(f32s[0].dist) - f64s[0].dist).abs() < 2e-6);
        }
    }
}

fn close(touches: &[Touch<f64>], slot: usize, dist: f64, pos: [f64; 3], normal: [f64; 3]) {
    let touch = &touches[slot];
    let off =
        (touch.pos - Vector3::from(pos)).amax() + (touch.normal - Vector3::from(normal)).amax();
    assert!(touch.exists && (touch.dist - dist).abs() + off < 1e-15, "{touch:?}");
}

#[test]
fn closed_forms() {
    let z = [0.0, 0.0, 1.0];
    let ground = at(0.0, 0.0, 0.0);
    close(&plane_sphere(&ground, &at(1.0, 2.0, 0.5), 1.0), 0, -0.5, [1.0, 2.0, -0.25], z);
    let upright = plane_capsule(&ground, &at(0.0, 0.0, 1.0), 0.5, 0.75);
    close(&upright, 0, 1.25, [0.0, 0.0, 0.625], z);
    close(&upright, 1, -0.25, [0.0, 0.0, -0.125], z);
    close(&sphere_sphere(&ground, 1.0, &at(0.0, 0.0, 2.5), 1.0), 0, 0.5, [0.0, 0.0, 1.25], z);
    let beside = sphere_capsule(&at(-1.0, 0.0, 0.5), 0.25, &ground, 0.25, 1.0);
    close(&beside, 0, 0.5, [-0.5, 0.0, 0.5], [1.0, 0.0, 0.0]);
    let above = sphere_capsule(&at(0.0, 0.0, 2.0), 0.25, &ground, 0.25, 1.0);
    close(&above, 0, 0.5, [0.0, 0.0, 1.5], [0.0, 0.0, -1.0]);
    let half = Vector3::new(1.0, 1.0, 0.5);
    let over = sphere_box(&at(0.0, 0.0, 1.0), 0.25, &ground, half);
    close(&over, 0, 0.25, [0.0, 0.0, 0.625], [0.0, 0.0, -1.0]);
    let corner = sphere_box(&at(4.0, 5.0, 0.5), 1.0, &ground, half);
    close(&corner, 0, 4.0, [2.2, 2.6, 0.5], [-0.6, -0.8, 0.0]);
    // Centre inside: out through the nearest face; among equal ones −x comes first.
    let inside = sphere_box(&at(0.0, 0.0, 0.25), 0.25, &ground, half);
    close(&inside, 0, -0.5, [0.0, 0.0, 0.25], [0.0, 0.0, -1.0]);
    let middle = sphere_box(&ground, 0.5, &ground, Vector3::new(1.0, 1.0, 1.0));
    close(&middle, 0, -1.5, [-0.25, 0.0, 0.0], [1.0, 0.0, 0.0]);
}

#[test]
fn closed_forms_on_a_plane() {
    let (ground, z) = (at(0.0, 0.0, 0.0), [0.0, 0.0, 1.0]);
    let half = Vector3::new(1.0, 0.75, 0.5);
    let mut turned = at(0.0, 0.0, 1.0);
    close(&plane_ellipsoid(&ground, &turned, half), 0, 0.5, [0.0, 0.0, 0.25], z);
    let lower = plane_box(&ground, &turned, half);
    for (k, (x, y)) in [(-1.0, -0.75), (1.0, -0.75), (-1.0, 0.75), (1.0, 0.75)].iter().enumerate() {
        close(&lower, k, 0.5, [*x, *y, 0.25], z);
        assert_eq!(lower[k].feature, k as f64);
    }
    // Standing on its upper end, a cylinder rests on the corners of a triangle; lying, on two.
    turned.rot = Matrix3::from_columns(&[Vector3::x(), -Vector3::y(), -Vector3::z()]);
    let stands = plane_cylinder(&ground, &turned, 1.0, 0.5);
    let side = 0.75_f64.sqrt();
    for (k, dist, x, y) in [(0, 0.5, 1.0, 0.0), (1, 1.5, 1.0, 0.0), (2, 0.5, -0.5, side)] {
        close(&stands, k, dist, [x, y, 0.5 * dist], z);
    }
    close(&stands, 3, 0.5, [-0.5, -side, 0.25], z);
    turned.rot = Matrix3::from_columns(&[Vector3::y(), Vector3::z(), Vector3::x()]);
    let lies = plane_cylinder(&ground, &turned, 1.0, 0.5);
    close(&lies, 0, 0.0, [0.5, 0.0, 0.0], z);
    close(&lies, 1, 0.0, [-0.5, 0.0, 0.0], z);
    close(&lies, 2, 1.5, [0.5, -side, 0.75], z);
}

#[test]
fn the_lowest_point_on_a_plane_is_the_nearest_of_all() {
    let mut random = Random(6);
    for _ in 0..300 {
        let (plane, _, body, size) = random.scene(0);
        let normal = plane.axis(2);
        let height = |at: Vector3<f64>| normal.dot(&(body.pos + body.rot * at - plane.pos));
        let least = |pair| {
            let touches = touch(pair, &plane, size, &body, size);
            touches.iter().map(|touch| touch.dist).fold(f64::INFINITY, f64::min)
        };
        let mut lowest = [f64::INFINITY; 3];
        for i in 0..200 {
            let around = 2.0 * std::f64::consts::PI * f64::from(i) / 200.0;
            let (s, c) = around.sin_cos();
            for end in [-size[1], size[1]] {
                let rim = Vector3::new(size[0] * c, size[0] * s, end);
                lowest[0] = lowest[0].min(height(rim));
            }
            for k in 0..=100 {
                let (s2, c2) = (0.01 * f64::from(k) * std::f64::consts::PI).sin_cos();
                let skin = Vector3::new(size[0] * c * s2, size[1] * s * s2, size[2] * c2);
                lowest[1] = lowest[1].min(height(skin));
            }
        }
        for k in 0..8 {
            let sign = |bit: usize| if k & bit == 0 { -1.0 } else { 1.0 };
            let corner = Vector3::new(sign(1) * size[0], sign(2) * size[1], sign(4) * size[2]);
            lowest[2] = lowest[2].min(height(corner));
        }
        for (pair, sampled, coarse) in [
            (PlaneCylinder, lowest[0], 3e-4),
            (PlaneEllipsoid, lowest[1], 3e-4),
            (PlaneBox, lowest[2], 0.0),
        ] {
            let off = sampled - least(pair);
            assert!(off > -1e-12 && off < coarse + 1e-12, "{pair:?}: {off}");
        }
    }
}

#[test]
fn capsules_side_by_side_touch_twice() {
    let x = [1.0, 0.0, 0.0];
    let a = at(0.0, 0.0, 0.0);
    let shifted = capsule_capsule(&a, 0.25, 1.0, &at(1.0, 0.0, 0.5), 0.25, 1.0);
    close(&shifted, 0, 0.5, [0.5, 0.0, -0.5], x);
    close(&shifted, 1, 0.5, [0.5, 0.0, 1.0], x);
    // One behind the other: twice the same place.
    let behind = capsule_capsule(&a, 0.5, 1.0, &at(3.0, 0.0, 6.0), 0.5, 1.0);
    for slot in 0..2 {
        close(&behind, slot, 4.0, [1.5, 0.0, 3.0], [0.6, 0.0, 0.8]);
    }
    // The angle alone decides: 1e-4 rad, whatever the lengths.
    for (angle, second) in [(0.9999e-4, true), (1.0001e-4, false)] {
        for half in [1e-3, 1.0, 1e3] {
            let mut b = at(1.0, 0.0, 0.0);
            b.rot = Rotation3::new(Vector3::x() * angle).into();
            assert_eq!(capsule_capsule(&a, 0.1, half, &b, 0.1, 1.0)[1].exists, second);
        }
    }
}

#[test]
fn normals_of_coincident_centres_are_across_the_axes() {
    let (a, mut b) = (at(0.0, 0.0, 0.0), at(0.0, 0.0, 0.0));
    close(&sphere_sphere(&a, 0.5, &b, 0.5), 0, -1.0, [0.0; 3], [1.0, 0.0, 0.0]);
    b.rot = Rotation3::new(Vector3::new(0.0, 0.25, 0.0)).into();
    close(&sphere_sphere(&a, 0.5, &b, 0.5), 0, -1.0, [0.0; 3], [0.0, 1.0, 0.0]);
    close(&sphere_capsule(&b, 0.5, &a, 0.5, 1.0), 0, -1.0, [0.0; 3], [0.0, -1.0, 0.0]);
    close(&capsule_capsule(&a, 0.5, 0.0, &b, 0.5, 0.0), 0, -1.0, [0.0; 3], [0.0, 1.0, 0.0]);
}

#[test]
fn an_upright_capsule_has_tangents_too() {
    let z = Vector3::z();
    assert_eq!(tangents(&z, Some(&z)), (Vector3::x(), Vector3::y()));
    let x = Vector3::x();
    assert_eq!(tangents(&x, Some(&x)), (Vector3::y(), z));
    assert_eq!(tangents::<f64>(&z, None), (Vector3::y(), -x));
    assert_eq!(tangents::<f64>(&Vector3::y(), None), (z, x));
}
