//! Capsules against boxes, spheres against cylinders: closed forms, brute force and laws.

use super::by_lane::OneWorld;
use super::capsule_box::CapsuleBox;
use super::cylinder::sphere_cylinder;
use super::trial::{assert_slopes, at, bare, constants, same_features, still, Moving, Random};
use super::Touch;
use crate::real::{Lanes, Mask, Real};
use crate::spatial::Pose;
use nalgebra::{Matrix3, Vector3};

fn meet<R: Real>(a: &Pose<R>, sa: &[f64; 3], b: &Pose<R>, sb: &[f64; 3]) -> Vec<Touch<R>> {
    let (sa, sb) = (constants::<R>(sa), constants::<R>(sb));
    let (one, two) = (bare(a, &sa), bare(b, &sb));
    let all: [Touch<R>; 2] = CapsuleBox.touches(&one, &two);
    all.into_iter().filter(|touch| touch.exists.lane(0)).collect()
}

/// Along the world's x axis.
fn lying(x: f64, y: f64, z: f64) -> Pose<f64> {
    let rot = Matrix3::from_columns(&[Vector3::y(), Vector3::z(), Vector3::x()]);
    Pose { pos: Vector3::new(x, y, z), rot }
}

fn close(touch: &Touch<f64>, dist: f64, pos: [f64; 3], normal: [f64; 3]) {
    let off =
        (touch.pos - Vector3::from(pos)).amax() + (touch.normal - Vector3::from(normal)).amax();
    assert!((touch.dist - dist).abs() + off < 1e-14, "{touch:?}");
}

#[test]
fn a_capsule_on_a_box_rests_on_both_ends() {
    let (ground, size, down) = (at(0.0, 0.0, 0.0), [1.0, 1.0, 0.5], [0.0, 0.0, -1.0]);
    let capsule = [0.25, 0.5, 0.0];
    let on = meet(&lying(0.25, 0.0, 0.625), &capsule, &ground, &size);
    assert_eq!(on.len(), 2);
    close(&on[0], -0.125, [-0.25, 0.0, 0.4375], down);
    close(&on[1], -0.125, [0.75, 0.0, 0.4375], down);
    assert_eq!((on[0].feature, on[1].feature), (1.0, 2.0));
    // Beyond the rim: the part that lies on the box.
    let over = meet(&lying(0.75, 0.0, 0.625), &capsule, &ground, &size);
    close(&over[0], -0.125, [0.25, 0.0, 0.4375], down);
    close(&over[1], -0.125, [1.0, 0.0, 0.4375], down);
    // Upright: the lower end alone is near.
    let stands = meet(&at(0.5, 0.5, 1.0), &capsule, &ground, &size);
    close(&stands[0], -0.25, [0.5, 0.5, 0.375], down);
    close(&stands[1], 0.75, [0.5, 0.5, 0.875], down);
    assert_eq!((stands[0].feature, stands[1].feature), (1.0, 2.0));
    // Its axis is in the box: out through the top.
    let deep = meet(&lying(0.0, 0.0, 0.25), &capsule, &ground, &size);
    close(&deep[0], -0.5, [-0.5, 0.0, 0.25], down);
    close(&deep[1], -0.5, [0.5, 0.0, 0.25], down);
    // Along an edge, from outside: both ends of the common stretch.
    let beside = meet(&lying(0.75, 1.15, 0.7), &capsule, &ground, &size);
    assert_eq!(beside.len(), 2);
    close(&beside[0], 0.0, [0.25, 1.0, 0.5], [0.0, -0.6, -0.8]);
    close(&beside[1], 0.0, [1.0, 1.0, 0.5], [0.0, -0.6, -0.8]);
}

/// Distance between the planes across the nearest contact's normal that touch the two shapes, less the
/// contact's distance: 0 for the nearest contact of shapes that are apart.
fn unproven(a: &Pose<f64>, capsule: &[f64; 3], b: &Pose<f64>, block: &[f64; 3]) -> f64 {
    let found = meet(a, capsule, b, block);
    let first = found.iter().min_by(|s, t| s.dist.total_cmp(&t.dist)).unwrap();
    let along = b.rot.transpose() * first.normal;
    let long = capsule[0] + capsule[1] * first.normal.dot(&a.rot.column(2)).abs();
    let reach = long + along.abs().dot(&Vector3::from(*block));
    first.normal.dot(&(b.pos - a.pos)) - reach - first.dist
}

#[test]
fn an_axis_all_but_along_an_edge_and_one_all_but_through_it() {
    let (mut random, block) = (Random(11), at(0.0, 0.0, 0.0));
    let (size, capsule) = ([1.0, 1.0, 0.5], [0.25, 0.5, 0.0]);
    for k in 0..4000 {
        let tilt = 10.0_f64.powi(-1 - k % 9);
        let turn = nalgebra::Rotation3::new(random.vector() * tilt);
        let (y, z) = (1.0 + 0.1 * random.next().abs(), 0.5 + 0.3 * random.next().abs());
        let mut pose = lying(0.8 * random.next(), y, z);
        pose.rot = turn * pose.rot;
        let off = unproven(&pose, &capsule, &block, &size);
        assert!(off.abs() < 1e-11, "{tilt:e}: {off:e}");
        // Across the edge, at this distance from it.
        let away = Vector3::new(0.0, 0.6, 0.8);
        let way = away.cross(&Vector3::new(1.0, random.next(), 0.0)).normalize();
        let rot = Matrix3::from_columns(&[away, way.cross(&away), way]);
        let pos = Vector3::new(0.3, 1.0, 0.5) + away * (0.1 * tilt * tilt) + way * 0.2;
        let off = unproven(&Pose { pos, rot }, &capsule, &block, &size);
        assert!(off.abs() < 1e-11, "{tilt:e}: {off:e}");
    }
}

#[test]
fn distances_and_depths_are_those_of_brute_force() {
    let mut random = Random(1);
    let (mut outside, mut inside) = (0, 0);
    for _ in 0..600 {
        let (a, b) = (random.pose(0.6), random.pose(0.1));
        let (sa, sb) = (random.size(), random.size());
        let least = meet(&a, &sa, &b, &sb).iter().map(|t| t.dist).fold(f64::INFINITY, f64::min);
        let local = |s: f64| b.rot.transpose() * (a.pos + a.rot.column(2) * s - b.pos);
        let far = |p: Vector3<f64>| Vector3::from_fn(|k, _| (p[k].abs() - sb[k]).max(0.0)).norm();
        let steps = 4000;
        let gap = (0..=steps)
            .map(|k| far(local(sa[1] * (2.0 * f64::from(k) / f64::from(steps) - 1.0))))
            .fold(f64::INFINITY, f64::min);
        if gap > 1e-3 {
            outside += 1;
            assert!((least - (gap - sa[0])).abs() < 1e-5, "{least} {gap}");
        } else if gap == 0.0 {
            inside += 1;
            let shortest = (0..4000)
                .map(|_| {
                    let way = random.vector().normalize();
                    let along = b.rot.transpose() * way;
                    let reach = along.abs().dot(&Vector3::from(sb));
                    reach + sa[1] * way.dot(&a.rot.column(2)).abs() - way.dot(&(a.pos - b.pos))
                })
                .fold(f64::INFINITY, f64::min);
            assert!(-least - sa[0] <= shortest * (1.0 + 1e-9), "{least} {shortest}");
        }
    }
    assert!(outside > 100 && inside > 100);
}

#[test]
fn every_case_is_finite_and_scales_bit_for_bit() {
    let mut random = Random(2);
    for case in 0..1200 {
        let (mut a, b) = (random.pose(0.6), random.pose(0.1));
        let (mut sa, mut sb) = (random.size(), random.size());
        match case % 6 {
            1 => a.rot = b.rot,
            2 => a = b,
            3 => sa[1] = 1e-9,
            4 => sb = [1e-4, 1.0, 2e-3],
            5 => {
                a = Pose {
                    pos: b.pos + b.rot.column(2) * (sb[2] + sa[0]),
                    rot: b.rot * lying(0.0, 0.0, 0.0).rot,
                }
            }
            _ => {}
        }
        let one = meet(&a, &sa, &b, &sb);
        assert!(!one.is_empty());
        for touch in &one {
            assert!(touch.dist.is_finite() && touch.pos.iter().all(|x| x.is_finite()), "{case}");
            assert!((touch.normal.norm() - 1.0).abs() < 1e-9, "{case} {touch:?}");
        }
        assert!(one.len() < 2 || one[0].feature != one[1].feature);
        for power in [-40, 5] {
            let k = 2f64.powi(power);
            let scaled = |p: &Pose<f64>| Pose { pos: p.pos * k, rot: p.rot };
            let more = meet(&scaled(&a), &sa.map(|x| x * k), &scaled(&b), &sb.map(|x| x * k));
            assert_eq!(one.len(), more.len());
            for (x, y) in one.iter().zip(&more) {
                assert_eq!((x.dist * k, x.pos * k), (y.dist, y.pos), "{case}");
                assert_eq!((x.normal, x.feature), (y.normal, y.feature), "{case}");
            }
        }
    }
}

/// Slopes against differences, where no feature changes between.
#[test]
fn slopes_are_those_of_differences() {
    let mut random = Random(3);
    let mut compared = 0;
    for _ in 0..400 {
        let (a, b) = (random.pose(0.6), random.pose(0.1));
        let (sa, sb) = (random.size(), random.size());
        let moving = Moving { pose: a, way: random.vector(), turn: random.vector() };
        let slopes = meet(&moving.dual(), &sa, &still(&b), &sb);
        let h = 1e-6;
        let [less, more] = [-h, h].map(|h| meet(&moving.at(h), &sa, &b, &sb));
        let jump = |x: &Touch<f64>, y: &Touch<f64>| (x.normal - y.normal).amax() > 1e-3;
        let jumps = || less.iter().zip(&more).any(|(x, y)| jump(x, y));
        if same_features(&slopes, [&less, &more]) && !jumps() {
            compared += 1;
            assert_slopes(&slopes, [&less, &more], h, 1e-3);
        }
    }
    assert!(compared > 200);
}

#[test]
fn a_sphere_leaves_a_cylinder_by_side_lid_or_rim() {
    let cylinder = at(0.0, 0.0, 0.0);
    let touch = |x, y, z| sphere_cylinder(&at(x, y, z), 0.25, &cylinder, 1.0, 0.5)[0];
    close(&touch(1.5, 0.0, 0.25), 0.25, [1.125, 0.0, 0.25], [-1.0, 0.0, 0.0]);
    close(&touch(0.5, 0.25, -1.0), 0.25, [0.5, 0.25, -0.625], [0.0, 0.0, 1.0]);
    close(&touch(0.0, 4.0, 4.5), 4.75, [0.0, 2.425, 2.4], [0.0, -0.6, -0.8]);
    close(&touch(0.0, 0.0, 0.25), -0.5, [0.0, 0.0, 0.25], [0.0, 0.0, -1.0]);
    close(&touch(0.0, 0.0, 0.0), -0.75, [0.0, 0.0, -0.125], [0.0, 0.0, 1.0]);
    let tall = sphere_cylinder(&at(0.0, 0.0, 0.25), 0.25, &cylinder, 0.25, 2.0)[0];
    close(&tall, -0.5, [0.0, 0.0, 0.25], [1.0, 0.0, 0.0]);
    // In lanes bit for bit.
    let mut random = Random(4);
    for _ in 0..200 {
        let (cylinder, size) = (random.pose(0.1), random.size());
        let poses: Vec<_> = (0..<Lanes>::LANES).map(|_| random.pose(0.5)).collect();
        let gather = |f: &dyn Fn(usize) -> f64| -> Lanes { Lanes(crate::real::array::from_fn(f)) };
        let wide = Pose {
            pos: Vector3::from_fn(|r, _| gather(&|i| poses[i].pos[r])),
            rot: Matrix3::from_fn(|r, c| gather(&|i| poses[i].rot[(r, c)])),
        };
        let same = Pose { pos: cylinder.pos.map(Lanes::of), rot: cylinder.rot.map(Lanes::of) };
        let [r, radius, half] = size.map(Lanes::of);
        let all = sphere_cylinder(&wide, r, &same, radius, half)[0];
        for (lane, pose) in poses.iter().enumerate() {
            let one = sphere_cylinder(pose, size[0], &cylinder, size[1], size[2])[0];
            assert_eq!(one.dist.to_bits(), all.dist.lane(lane).to_bits());
            assert_eq!(one.pos, all.pos.map(|x| x.lane(lane)));
            assert_eq!(one.normal, all.normal.map(|x| x.lane(lane)));
        }
    }
}
