//! Boxes against boxes: closed forms, brute force, and laws.

use super::{Boxes, MOST};
use crate::real::{Mask, Real};
use crate::shapes::by_lane::{by_lane, OneWorld};
use crate::shapes::trial::{
    assert_slopes, at, bare, constants, same_features, still, Moving, Random,
};
use crate::shapes::Touch;
use crate::spatial::Pose;
use nalgebra::{Matrix3, Rotation3, Vector3};

type Size = [f64; 3];

fn meet<R: Real>(a: &Pose<R>, sa: &Size, b: &Pose<R>, sb: &Size) -> Vec<Touch<R>> {
    let (sa, sb) = (constants::<R>(sa), constants::<R>(sb));
    let (one, two) = (bare(a, &sa), bare(b, &sb));
    let all: [Touch<R>; MOST] = Boxes { within: f64::INFINITY }.touches(&one, &two);
    all.into_iter().filter(|touch| touch.exists.lane(0)).collect()
}

fn least(touches: &[Touch<f64>]) -> Touch<f64> {
    *touches.iter().min_by(|x, y| x.dist.total_cmp(&y.dist)).unwrap()
}

/// The point of a box nearest to another point.
fn nearest(pose: &Pose<f64>, size: &Size, point: &Vector3<f64>) -> Vector3<f64> {
    let local = pose.rot.transpose() * (point - pose.pos);
    pose.pos + pose.rot * Vector3::from_fn(|k, _| local[k].clamp(-size[k], size[k]))
}

#[test]
fn a_box_on_a_box_keeps_four_corners() {
    let (below, size, small) = (at(0.0, 0.0, 0.0), [1.0, 1.0, 0.5], [0.5, 0.25, 0.25]);
    let features = |b: &Pose<f64>| {
        let touches = meet(&below, &size, b, &small);
        for touch in &touches {
            assert!((touch.dist + 0.125).abs() < 1e-12, "{touch:?}");
            assert_eq!(touch.normal, Vector3::z());
            assert!((touch.pos.z - 0.4375).abs() < 1e-12);
        }
        touches.iter().map(|touch| touch.feature).collect::<Vec<_>>()
    };
    let here = features(&at(0.0, 0.0, 0.625));
    assert_eq!(here, [11.0, 10.0, 8.0, 9.0]);
    assert_eq!(features(&at(0.3, -0.2, 0.625)), here);
    // Beyond the edge two of the corners become two pairs of edges, and always the same two.
    let over = features(&at(0.75, 0.0, 0.625));
    assert_eq!(over.len(), 4);
    assert_eq!(over, features(&at(0.875, 0.0625, 0.625)));
    assert!(over.contains(&10.0) && over.contains(&8.0) && !over.contains(&9.0));
}

#[test]
fn equal_boxes_keep_their_names_whatever_rounding_says() {
    let mut random = Random(3);
    let size = [0.1, 0.1, 0.1];
    for round in 0..200 {
        let shake = if round % 2 == 0 { 1e-16 } else { 1e-7 };
        let b = Pose {
            pos: Vector3::z() * 0.1999 + random.vector() * shake * 0.1,
            rot: Rotation3::new(random.vector() * shake).into_inner(),
        };
        let touches = meet(&at(0.0, 0.0, 0.0), &size, &b, &size);
        let mut names: Vec<_> = touches.iter().map(|touch| touch.feature).collect();
        names.sort_by(f64::total_cmp);
        assert_eq!(names, [4.0, 5.0, 6.0, 7.0], "{touches:?}");
    }
}

#[test]
fn crossed_edges_touch_in_one_point() {
    let eighth = std::f64::consts::FRAC_PI_4;
    let mut a = at(0.0, 0.0, 0.0);
    a.rot = Rotation3::new(Vector3::x() * eighth).into_inner();
    let mut b = at(0.0, 0.0, 2.5);
    b.rot = Rotation3::new(Vector3::y() * eighth).into_inner();
    for (height, expected) in [(2.5, 2.5 - 8.0_f64.sqrt()), (3.0, 3.0 - 8.0_f64.sqrt())] {
        b.pos.z = height;
        let touches = meet(&a, &[1.0; 3], &b, &[1.0; 3]);
        assert_eq!(touches.len(), 1);
        assert!((touches[0].dist - expected).abs() < 1e-14);
        assert!((touches[0].pos - Vector3::z() * 0.5 * height).amax() < 1e-14);
        assert!((touches[0].normal - Vector3::z()).amax() < 1e-14);
    }
}

#[test]
fn corners_apart_are_as_far_as_they_are() {
    let touches = meet(&at(0.0, 0.0, 0.0), &[1.0; 3], &at(4.0, 5.0, 8.0), &[1.0; 3]);
    let touch = touches[0];
    assert_eq!((touches.len(), touch.dist), (1, 7.0));
    assert!((touch.normal - Vector3::new(2.0, 3.0, 6.0) / 7.0).amax() < 1e-15);
    assert!((touch.pos - Vector3::new(2.0, 2.5, 4.0)).amax() < 1e-14);
}

/// Points that alternate between two convex bodies, each moving to the nearest of the other, end at the
/// nearest two (Cheney and Goldstein 1959).
#[test]
fn distances_are_those_of_brute_force() {
    let mut random = Random(5);
    let mut apart = 0;
    for _ in 0..1500 {
        let (a, b) = (random.pose(0.1), random.pose(1.2));
        let (sa, sb) = (random.size(), random.size());
        let (mut p, mut q) = (a.pos, b.pos);
        for _ in 0..4000 {
            q = nearest(&b, &sb, &p);
            p = nearest(&a, &sa, &q);
        }
        let dist = (q - p).norm();
        if dist < 1e-3 {
            continue;
        }
        apart += 1;
        let touches = meet(&a, &sa, &b, &sb);
        let found = least(&touches);
        assert!((found.dist - dist).abs() < 1e-5, "{} {dist}", found.dist);
        assert!((found.normal - (q - p) / dist).amax() < 0.02, "{found:?}");
    }
    assert!(apart > 500);
}

/// The depth is the shortest way out: along the normal they part, and no other direction of many is
/// shorter. A face preferred to an edge may give the depth along another axis, 5 % more.
#[test]
fn depths_are_the_shortest_way_out() {
    let mut random = Random(6);
    let mut deep = 0;
    for _ in 0..800 {
        let (a, b) = (random.pose(0.1), random.pose(0.35));
        let (sa, sb) = (random.size(), random.size());
        let touches = meet(&a, &sa, &b, &sb);
        let found = least(&touches);
        if found.dist >= 0.0 {
            continue;
        }
        deep += 1;
        let reach = |pose: &Pose<f64>, size: &Size, way: &Vector3<f64>| {
            (pose.rot.transpose() * way).abs().dot(&Vector3::from(*size))
        };
        let overlap = |way: &Vector3<f64>| {
            reach(&a, &sa, way) + reach(&b, &sb, way) - way.dot(&(b.pos - a.pos))
        };
        let own = overlap(&found.normal);
        assert!((own + found.dist).abs() < 1e-9 * own || touches.len() > 1);
        let shortest =
            (0..2000).map(|_| overlap(&random.vector().normalize())).fold(f64::INFINITY, f64::min);
        assert!(own <= shortest / 0.94, "{own} {shortest}");
    }
    assert!(deep > 300);
}

#[test]
fn exchanging_the_boxes_turns_the_normals_round() {
    let mut random = Random(7);
    for _ in 0..500 {
        let (a, b) = (random.pose(0.1), random.pose(0.5));
        let (sa, sb) = (random.size(), random.size());
        let (there, back) = (meet(&a, &sa, &b, &sb), meet(&b, &sb, &a, &sa));
        assert_eq!(there.len(), back.len());
        for x in &there {
            let same = |y: &&Touch<f64>| {
                (x.dist - y.dist).abs() + (x.pos - y.pos).amax() + (x.normal + y.normal).amax()
                    < 1e-9
            };
            assert!(back.iter().any(|y| same(&y)), "{x:?} {back:?}");
        }
    }
}

/// Contacts beyond the limit may be left out; all nearer ones are listed.
#[test]
fn nothing_within_the_limit_is_left_out() {
    let mut random = Random(11);
    let (mut told, mut left_out) = (0, 0);
    for _ in 0..2000 {
        let (a, b) = (random.pose(0.1), random.pose(1.2));
        let (sa, sb) = (random.size(), random.size());
        let all = meet(&a, &sa, &b, &sb);
        for within in [0.0, 0.1, 0.5] {
            let some: [Touch<f64>; MOST] = Boxes { within }.touches(&bare(&a, &sa), &bare(&b, &sb));
            let some: Vec<_> = some.into_iter().filter(|touch| touch.exists).collect();
            if some.is_empty() {
                left_out += 1;
                assert!(least(&all).dist >= within);
            } else {
                told += 1;
                let numbers = |t: &Touch<f64>| (t.dist, t.pos, t.normal, t.feature);
                assert!(some.iter().map(numbers).eq(all.iter().map(numbers)));
            }
        }
    }
    assert!(told > 300 && left_out > 300);
}

#[test]
fn names_differ_and_every_case_is_finite() {
    let mut random = Random(8);
    for case in 0..3000 {
        let (a, mut b) = (random.pose(0.2), random.pose(0.5));
        let (sa, mut sb) = (random.size(), random.size());
        match case % 6 {
            1 => b.rot = (Rotation3::new(random.vector() * 1e-9)) * a.rot,
            2 => b.rot = a.rot,
            3 => (b, sb) = (a, sa),
            4 => sb = [2e-3, 1.0, 1e-4],
            5 => b = Pose { pos: a.pos + a.rot.column(2) * (sa[2] + sb[2]), rot: a.rot },
            _ => {}
        }
        let touches = meet(&a, &sa, &b, &sb);
        assert!(!touches.is_empty(), "{case} {a:?} {sa:?} {b:?} {sb:?}");
        for (k, touch) in touches.iter().enumerate() {
            assert!(touch.dist.is_finite() && touch.pos.iter().all(|x| x.is_finite()));
            assert!((touch.normal.norm() - 1.0).abs() < 1e-12);
            assert!(touch.feature >= 0.0 && touch.feature < 256.0);
            let others = touches[..k].iter();
            assert!(others.filter(|other| other.feature == touch.feature).count() == 0);
        }
    }
}

#[test]
fn lengths_scale_by_powers_of_two_bit_for_bit() {
    let mut random = Random(9);
    for case in 0..500 {
        let (a, mut b) = (random.pose(0.2), random.pose(0.6));
        let (sa, sb) = (random.size(), random.size());
        if case % 3 == 0 {
            b.rot = a.rot;
        }
        let one = meet(&a, &sa, &b, &sb);
        for power in [-40, -3, 5, 40] {
            let k = 2f64.powi(power);
            let far = |p: &Pose<f64>| Pose { pos: p.pos * k, rot: p.rot };
            let more = meet(&far(&a), &sa.map(|x| x * k), &far(&b), &sb.map(|x| x * k));
            assert_eq!(one.len(), more.len());
            for (x, y) in one.iter().zip(&more) {
                assert_eq!((x.dist * k, x.pos * k), (y.dist, y.pos));
                assert_eq!((x.normal, x.feature), (y.normal, y.feature));
            }
        }
    }
}

/// Slopes against differences, where no feature changes between.
#[test]
fn slopes_are_those_of_differences() {
    let mut random = Random(10);
    let mut compared = 0;
    for _ in 0..300 {
        let (a, b) = (random.pose(0.1), random.pose(0.5));
        let (sa, sb) = (random.size(), random.size());
        let moving = Moving { pose: b, way: random.vector(), turn: random.vector() };
        let slopes = meet(&still(&a), &sa, &moving.dual(), &sb);
        let h = 1e-6;
        let [less, more] = [-h, h].map(|h| meet(&a, &sa, &moving.at(h), &sb));
        if same_features(&slopes, [&less, &more]) {
            compared += 1;
            assert_slopes(&slopes, [&less, &more], h, 1e-4);
        }
    }
    assert!(compared > 200);
}

/// Two pads of a robot's hand, which seven joints turned: in single precision their axes are
/// parallel to the last digit, and at right angles only nearly.
#[test]
fn pads_of_a_hand_have_normals_in_single_precision() {
    let rot = Matrix3::from_columns(&[
        Vector3::new(0.588_921_3_f32, 0.306_073, -0.747_990_9),
        Vector3::new(0.246_502_74, -0.949_439_5, -0.194_423_59),
        Vector3::new(-0.769_680_1, -0.069_881_62, -0.634_593_25),
    ]);
    // Half a turn about the third axis, but for one digit.
    let mut other = rot * Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0));
    other[(0, 0)] = -0.588_921_37;
    let one = Pose { pos: Vector3::new(-0.360_005_56, -0.436_084_7, 0.145_216_29), rot };
    let two = Vector3::new(-0.366_518_38, -0.441_847_95, 0.145_083_22);
    let two = Pose { pos: two, rot: other };
    let (large, small) = ([0.0085, 0.004, 0.0085], [0.003, 0.002, 0.003]);
    let test = |_| Boxes { within: f64::INFINITY };
    let all: [Touch<f32>; MOST] = by_lane(test, &bare(&one, &large), &bare(&two, &small));
    let found: Vec<_> = all.iter().filter(|touch| touch.exists).collect();
    assert_eq!(found.len(), 4);
    for touch in found {
        assert!((touch.normal - rot.column(1)).norm() < 1e-5, "{touch:?}");
        assert!((touch.dist + 0.002_108).abs() < 1e-6, "{touch:?}");
    }
}
