//! The convex routine: closed forms, laws of every pair, lanes, slopes, and degenerate shapes.

use super::by_lane::by_lane;
use super::convex::Convex;
use super::hull::Hull;
use super::touch::{Touch, Touches};
use super::trial::constants;
use super::Shape;
use crate::real::{Constant, Dual, Lanes, Mask, Real};
use crate::scene::GeomType::{self, Box, Capsule, Cylinder, Ellipsoid, Mesh, Sphere};
use crate::spatial::{Pose, Quat, M3, V3};

const PAIRS: [(GeomType, GeomType); 16] = [
    (Sphere, Ellipsoid),
    (Sphere, Mesh),
    (Capsule, Ellipsoid),
    (Capsule, Cylinder),
    (Capsule, Box),
    (Capsule, Mesh),
    (Ellipsoid, Ellipsoid),
    (Ellipsoid, Cylinder),
    (Ellipsoid, Box),
    (Ellipsoid, Mesh),
    (Cylinder, Cylinder),
    (Cylinder, Box),
    (Cylinder, Mesh),
    (Box, Box),
    (Box, Mesh),
    (Mesh, Mesh),
];

/// A reproducible sequence of numbers in [−1, 1).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
    fn vector(&mut self) -> V3<f64> {
        V3::from_fn(|_, _| self.next())
    }
    fn pose(&mut self, reach: f64) -> Pose<f64> {
        let q = [0; 4].map(|_| self.next());
        Pose { pos: self.vector() * reach, rot: Quat::of(&q).normalized().matrix() }
    }
    fn size(&mut self) -> [f64; 3] {
        [0; 3].map(|_| 0.6 + 0.5 * self.next())
    }
    fn hull(&mut self) -> Hull {
        let points: Vec<[f64; 3]> = (0..14).map(|_| self.vector().into()).collect();
        Hull::of(&points).unwrap()
    }
}

fn touch<R: Real>(kinds: (GeomType, GeomType), one: &Shape<R>, two: &Shape<R>) -> Touches<R, 8> {
    touch_within(kinds, f64::INFINITY, one, two)
}

fn touch_within<R: Real>(
    (a, b): (GeomType, GeomType),
    within: f64,
    one: &Shape<R>,
    two: &Shape<R>,
) -> Touches<R, 8> {
    by_lane(|_| Convex { one: a, two: b, within, hint: None }, one, two)
}

fn deepest(touches: &[Touch<f64>]) -> Touch<f64> {
    let there = touches.iter().filter(|touch| touch.exists);
    *there.min_by(|a, b| a.dist.total_cmp(&b.dist)).unwrap()
}

fn shape<'a, R: Real>(
    pose: &'a Pose<R>,
    size: &'a [R::Value; 3],
    hull: Option<&'a Hull>,
) -> Shape<'a, R> {
    Shape { pose, size, hull, field: None }
}

fn at(pos: [f64; 3], turn: [f64; 4]) -> Pose<f64> {
    Pose { pos: pos.into(), rot: Quat::of(&turn).normalized().matrix() }
}

/// Two shapes of these types at random.
struct Case {
    kinds: (GeomType, GeomType),
    poses: [Pose<f64>; 2],
    sizes: [[f64; 3]; 2],
    hulls: [Hull; 2],
}

impl Case {
    fn random(random: &mut Random, kinds: (GeomType, GeomType), reach: f64) -> Self {
        let poses = [random.pose(reach), random.pose(reach)];
        let sizes = [random.size(), random.size()];
        Self { kinds, poses, sizes, hulls: [random.hull(), random.hull()] }
    }
    fn shape<'a, R: Real<Value = f64>>(&'a self, i: usize, pose: &'a Pose<R>) -> Shape<'a, R> {
        shape(pose, &self.sizes[i], Some(&self.hulls[i]))
    }
    fn touches(&self) -> Touches<f64, 8> {
        let [p, q] = &self.poses;
        touch(self.kinds, &self.shape(0, p), &self.shape(1, q))
    }
}

fn cases(reach: f64, each: usize) -> impl Iterator<Item = Case> {
    let mut random = Random(3);
    PAIRS
        .into_iter()
        .flat_map(move |kinds| std::iter::repeat_n(kinds, each))
        .map(move |kinds| Case::random(&mut random, kinds, reach))
}

const IDENTITY: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

#[test]
fn round_ellipsoids_are_spheres() {
    let mut random = Random(1);
    for reach in [0.05, 0.5, 3.0] {
        for _ in 0..100 {
            let (p, q) = (random.pose(reach), random.pose(reach));
            let (r, s) = (random.size()[0], random.size()[0]);
            let found =
                touch((Ellipsoid, Ellipsoid), &shape(&p, &[r; 3], None), &shape(&q, &[s; 3], None));
            let between = q.pos - p.pos;
            let first = deepest(&found);
            assert!((first.dist - (between.norm() - r - s)).abs() < 1e-14 * (1.0 + reach));
            assert!((first.normal - between.normalize()).norm() < 1e-13);
        }
    }
}

#[test]
fn cylinders_end_to_end_and_side_by_side() {
    let (a, b) = ([0.3, 0.5, 0.0], [0.2, 0.4, 0.0]);
    for gap in [0.1, 0.0, -0.01] {
        let (p, q) = (at([0.0; 3], IDENTITY), at([0.05, 0.02, 0.9 + gap], IDENTITY));
        let found = touch((Cylinder, Cylinder), &shape(&p, &a, None), &shape(&q, &b, None));
        assert_eq!(found.iter().filter(|t| t.exists).count(), 8);
        for t in found {
            assert!((t.dist - gap).abs() < 1e-15 && t.normal == V3::z(), "{t:?}");
        }
        let q = at([0.3, 0.4 + gap * 0.8, 0.3], IDENTITY);
        let found = touch((Cylinder, Cylinder), &shape(&p, &a, None), &shape(&q, &b, None));
        let dist = (0.09 + (0.4 + 0.8 * gap) * (0.4 + 0.8 * gap)).sqrt() - 0.5;
        let there: Vec<_> = found.iter().filter(|t| t.exists).collect();
        assert_eq!(there.len(), 2);
        // From the later start to the earlier end.
        for (t, z) in there.iter().zip([-0.1, 0.5]) {
            assert!((t.dist - dist).abs() < 1e-15 && (t.pos.z - z).abs() < 1e-15, "{t:?}");
        }
    }
}

#[test]
fn a_cylinder_lies_on_a_box_along_a_line_and_stands_on_its_rim() {
    let (block, can) = ([1.0, 1.0, 0.5], [0.2, 0.4, 0.0]);
    let lying = at([0.1, 0.2, 0.699], [1.0, 1.0, 0.0, 0.0]);
    let floor = at([0.0; 3], IDENTITY);
    let found = touch((Cylinder, Box), &shape(&lying, &can, None), &shape(&floor, &block, None));
    let there: Vec<_> = found.iter().filter(|t| t.exists).collect();
    assert_eq!(there.len(), 2);
    for t in &there {
        assert!((t.dist + 0.001).abs() < 1e-15 && (t.normal + V3::z()).norm() < 1e-15);
        assert!(((t.pos.y - 0.2).abs() - 0.4).abs() < 1e-15);
    }
    let standing = at([0.1, 0.2, 0.899], IDENTITY);
    let found = touch((Cylinder, Box), &shape(&standing, &can, None), &shape(&floor, &block, None));
    assert!(found.iter().all(|t| t.exists && (t.dist + 0.001).abs() < 1e-15));
    // Leaning, its lowest point is among them.
    let leaning = at([0.1, 0.2, 0.899], [1.0, 1e-3, 3e-3, 0.0]);
    let found = touch((Cylinder, Box), &shape(&leaning, &can, None), &shape(&floor, &block, None));
    let up = leaning.axis(2);
    let lowest = 0.899 - 0.4 * up.z - 0.2 * (up.x * up.x + up.y * up.y).sqrt() - 0.5;
    assert!((deepest(&found).dist - lowest).abs() < 1e-15);
}

#[test]
fn a_hull_of_a_box_is_that_box() {
    let mut random = Random(5);
    for _ in 0..200 {
        let (p, q) = (random.pose(0.8), random.pose(0.8));
        let (a, b) = (random.size(), random.size());
        let hull = Hull::block(b).unwrap();
        let one = shape(&p, &a, None);
        let boxes = touch((Box, Box), &one, &shape(&q, &b, None));
        let mesh = touch((Box, Mesh), &one, &shape(&q, &b, Some(&hull)));
        let (x, y) = (deepest(&boxes), deepest(&mesh));
        assert!((x.dist - y.dist).abs() < 1e-14 && (x.normal - y.normal).norm() < 1e-12);
        let count = |t: &[Touch<f64>]| t.iter().filter(|t| t.exists).count();
        assert_eq!(count(&boxes), count(&mesh));
    }
}

#[test]
fn lengths_in_another_unit_scale_bit_for_bit() {
    for case in cases(0.9, 20) {
        for power in [-13, 1, 10] {
            let factor = 2.0_f64.powi(power);
            let scaled = |pose: &Pose<f64>| Pose { pos: pose.pos * factor, rot: pose.rot };
            let hull = |hull: &Hull| {
                let points: Vec<[f64; 3]> =
                    hull.vertices.iter().map(|v| (v * factor).into()).collect();
                Hull::of(&points).unwrap()
            };
            let other = Case {
                kinds: case.kinds,
                poses: [0, 1].map(|i| scaled(&case.poses[i])),
                sizes: case.sizes.map(|size| size.map(|x| factor * x)),
                hulls: [0, 1].map(|i| hull(&case.hulls[i])),
            };
            for (t, u) in case.touches().iter().zip(other.touches()) {
                assert_eq!(t.exists, u.exists, "{:?}", case.kinds);
                if t.exists {
                    assert_eq!(
                        (factor * t.dist, t.normal, t.feature),
                        (u.dist, u.normal, u.feature)
                    );
                    assert_eq!(factor * t.pos, u.pos);
                }
            }
        }
    }
}

#[test]
fn the_other_order_and_a_shift_show_the_same() {
    for mut case in cases(0.9, 30).filter(|case| case.kinds.0 == case.kinds.1) {
        let ours = deepest(&case.touches());
        let [p, q] = &case.poses;
        let back = touch(case.kinds, &case.shape(1, q), &case.shape(0, p));
        let back = deepest(&back);
        assert!((ours.dist - back.dist).abs() < 1e-13, "{:?}", case.kinds);
        for pose in &mut case.poses {
            pose.pos += V3::new(4.0, -8.0, 2.0);
        }
        assert!((ours.dist - deepest(&case.touches()).dist).abs() < 1e-13);
    }
}

#[test]
fn looking_for_near_contacts_alone_finds_the_same_ones() {
    let (mut near, mut none) = (0, 0);
    for case in cases(2.0, 100) {
        let all = case.touches();
        let [p, q] = &case.poses;
        for within in [-0.1, 0.0, 0.2] {
            let (one, two) = (case.shape(0, p), case.shape(1, q));
            let found = touch_within(case.kinds, within, &one, &two);
            if !found[0].exists {
                none += 1;
                assert!(all.iter().all(|t| !t.exists || t.dist >= within), "{:?}", case.kinds);
                continue;
            }
            near += 1;
            for (t, u) in found.iter().zip(&all) {
                assert_eq!(t.exists, u.exists);
                assert_eq!(
                    (t.dist, t.pos, t.normal, t.feature),
                    (u.dist, u.pos, u.normal, u.feature)
                );
            }
        }
    }
    assert!(near > 500 && none > 1000, "{near} {none}");
}

#[test]
fn lanes_are_scalars_bit_for_bit() {
    let mut random = Random(9);
    for kinds in PAIRS {
        let mut case = Case::random(&mut random, kinds, 0.8);
        let worlds: Vec<[Pose<f64>; 2]> =
            (0..<Lanes>::LANES).map(|_| [random.pose(0.8), random.pose(0.8)]).collect();
        let wide = |i: usize| {
            let mut pose: Pose<Lanes> = Pose { pos: V3::zeros(), rot: M3::zeros() };
            for (lane, world) in worlds.iter().enumerate() {
                (0..3).for_each(|k| pose.pos[k].set_lane(lane, world[i].pos[k]));
                (0..9).for_each(|k| pose.rot[k].set_lane(lane, world[i].rot[k]));
            }
            pose
        };
        let (p, q) = (wide(0), wide(1));
        let sizes = case.sizes.map(|size| size.map(|x| Constant::by_lane(&[x])));
        let own = |i: usize, pose| shape(pose, &sizes[i], Some(&case.hulls[i]));
        let lanes = touch(kinds, &own(0, &p), &own(1, &q));
        for (lane, world) in worlds.iter().enumerate() {
            case.poses = *world;
            for (t, u) in case.touches().iter().zip(&lanes) {
                assert_eq!(t.exists, u.exists.lane(lane));
                assert_eq!((t.dist, t.feature), (u.dist.lane(lane), u.feature.lane(lane)));
                assert_eq!(
                    (t.pos, t.normal),
                    (u.pos.map(|x| x.lane(lane)), u.normal.map(|x| x.lane(lane)))
                );
            }
        }
    }
}

/// A pose that moves and turns at these rates, after `time`; and with its slopes.
fn moving(pose: &Pose<f64>, rates: &[V3<f64>; 2], time: f64) -> Pose<f64> {
    let turn = Quat::exp(&(rates[1] * time)).matrix();
    Pose { pos: pose.pos + rates[0] * time, rot: turn * pose.rot }
}

fn dual(pose: &Pose<f64>, rates: &[V3<f64>; 2]) -> Pose<Dual> {
    let mut out: Pose<Dual> = Pose { pos: pose.pos.map(Dual::of), rot: pose.rot.map(Dual::of) };
    for k in 0..3 {
        out.pos[k].slopes[0] = rates[0][k];
        let axis = pose.axis(k);
        let slope = rates[1].cross(&axis);
        (0..3).for_each(|i| out.rot[(i, k)].slopes[0] = slope[i]);
    }
    out
}

#[test]
fn slopes_are_those_of_finite_differences() {
    let mut random = Random(21);
    let mut compared = 0;
    for case in cases(0.9, 30) {
        let rates = [0, 1].map(|_| [random.vector(), random.vector()]);
        let [p, q] = [0, 1].map(|i| dual(&case.poses[i], &rates[i]));
        let sizes = case.sizes.each_ref().map(constants::<Dual>);
        let [one, two] = case.hulls.each_ref().map(Some);
        let with = touch(case.kinds, &shape(&p, &sizes[0], one), &shape(&q, &sizes[1], two));
        let h = 1e-6;
        let [before, after] = [-h, h].map(|time| {
            let [p, q] = [0, 1].map(|i| moving(&case.poses[i], &rates[i], time));
            touch(case.kinds, &case.shape(0, &p), &case.shape(1, &q))
        });
        for ((t, a), b) in with.iter().zip(before).zip(after) {
            // Skips cases in which another place takes over in between.
            let same = t.exists && a.exists && b.exists && a.feature == b.feature;
            let near = (a.normal - b.normal).norm() < 1e-4 && (a.pos - b.pos).norm() < 1e-4;
            if !(same && near) {
                continue;
            }
            compared += 1;
            let close = |slope: f64, low: f64, high: f64| {
                let want = (high - low) / (2.0 * h);
                assert!(
                    (slope - want).abs() < 1e-6 * (1.0 + want.abs()),
                    "{:?}: {slope} {want}",
                    case.kinds
                );
            };
            close(t.dist.slopes[0], a.dist, b.dist);
            for k in 0..3 {
                close(t.normal[k].slopes[0], a.normal[k], b.normal[k]);
                close(t.pos[k].slopes[0], a.pos[k], b.pos[k]);
            }
        }
    }
    assert!(compared > 300, "{compared}");
}

#[test]
fn what_is_nearly_nothing_has_finite_contacts() {
    let thin = [[1e-4, 1e3, 1.0], [1e3, 1e-4, 1e-4], [1e-4; 3], [1e3; 3], [1.0, 1.0, 1e-6]];
    let places =
        [[0.0; 3], [1e-12, 0.0, 0.0], [0.0, 0.0, 1.0], [1e-300, 0.0, 0.0], [500.0, 1.0, 1e-4]];
    for kinds in PAIRS {
        for a in thin {
            for b in thin {
                let hulls = [a, b].map(|size| Hull::block(size).ok());
                for place in places {
                    for turn in [
                        IDENTITY,
                        [1.0, 1.0, 0.0, 0.0],
                        [1.0, 1e-9, 0.0, 1e-5],
                        [0.3, 0.5, -0.7, 0.2],
                    ] {
                        let (p, q) = (at([0.0; 3], IDENTITY), at(place, turn));
                        let [x, y] = [hulls[0].as_ref(), hulls[1].as_ref()];
                        let found = touch(kinds, &shape(&p, &a, x), &shape(&q, &b, y));
                        assert!(found[0].exists);
                        for t in found.iter().filter(|t| t.exists) {
                            let numbers = [t.dist, t.pos.x, t.pos.y, t.pos.z];
                            assert!(numbers.iter().all(|x| x.is_finite()), "{kinds:?} {a:?} {b:?}");
                            assert!((t.normal.norm() - 1.0).abs() < 1e-12, "{kinds:?} {t:?}");
                        }
                    }
                }
            }
        }
    }
}
