//! Skipped work must change nothing: steps with and without it are the same bits.

use super::broad::{Bounds, Broad, Fixed};
use super::Contact;
use crate::assets::Mesh;
use crate::model::Model;
use crate::real::{Lanes, Mask, Real};
use crate::scene::{Body, ExplicitPair, Geom, GeomType, Joint, JointType, Scene};
use crate::settings::{Integrator, Law, Settings, Solver};
use crate::shapes::{Hint, ShapeTest};
use crate::sim::Sim;
use crate::solve::ContactIslands;
use crate::spatial::V3;
use std::sync::Arc;

/// Numbers in [0, 1) that are the same everywhere.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(0x1405_7b7e_f767_814f);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }
}

/// Free balls and capsules over a floor, some with a second body hinged to them.
pub fn scattered(random: &mut Random, count: usize, room: f64) -> Scene {
    let mut scene = Scene::default();
    let geom = |scene: &mut Scene, body, kind, size| {
        let name = format!("geom{}", scene.geoms.len());
        scene.geoms.push(Geom { name, body, kind, size, ..Geom::default() });
    };
    geom(&mut scene, 0, GeomType::Plane, [0.0; 3]);
    for i in 0..count {
        let pos = crate::real::array::from_fn(|_| random.between(0.0, room));
        let body = scene.bodies.len();
        scene.bodies.push(Body { parent: 0, pos, ..Body::default() });
        let name = format!("joint{}", scene.joints.len());
        scene.joints.push(Joint { name, body, kind: JointType::Free, ..Joint::default() });
        let size = [random.between(0.03, 0.12), random.between(0.05, 0.2), 0.0];
        let kind = if random.next() < 0.6 { GeomType::Sphere } else { GeomType::Capsule };
        geom(&mut scene, body, kind, size);
        if i % 5 == 4 {
            let arm = scene.bodies.len();
            let parent = body;
            scene.bodies.push(Body { parent, pos: [0.25, 0.0, 0.0], ..Body::default() });
            let (name, axis) = (format!("joint{}", scene.joints.len()), [0.0, 1.0, 0.0]);
            let kind = JointType::Hinge;
            scene.joints.push(Joint { name, body: arm, kind, axis, ..Joint::default() });
            geom(&mut scene, arm, GeomType::Capsule, [0.04, 0.1, 0.0]);
        }
    }
    scene
}

/// Velocities of up to `most`.
pub fn thrown<R: Real>(random: &mut Random, sim: &mut Sim<R>, most: f64) {
    for v in &mut sim.state.qvel {
        *v = R::of(random.between(-most, most));
    }
}

pub fn bits<R: Real>(sim: &Sim<R>) -> Vec<u64> {
    let numbers = sim.state.qpos.iter().chain(&sim.state.qvel);
    numbers.flat_map(|x| (0..R::LANES).map(|lane| x.lane(lane).to_bits())).collect()
}

fn all_pairs_change_nothing<R: Real>(law: Law) {
    let mut random = Random(7);
    for speed in [0.1, 3.0, 40.0, 800.0] {
        let scene = scattered(&mut random, 14, 1.0);
        let model = Arc::new(Model::compile(&scene).unwrap());
        let solver = Solver::Pgs;
        let settings = Settings { law, solver, sweeps: 10.into(), ..Settings::default() };
        let mut near = Sim::<R>::new(model.clone(), settings.clone()).unwrap();
        thrown(&mut random, &mut near, speed);
        let mut all = Sim::<R>::new(model, settings).unwrap();
        all.detected.exhaustive = true;
        all.state.qvel.clone_from(&near.state.qvel);
        let mut rows = 0;
        for _ in 0..40 {
            match (near.step(1), all.step(1)) {
                (Ok(()), Ok(())) => {}
                // Too fast for the law, and for both.
                (one, two) => {
                    assert!(one.is_err() && two.is_err(), "{speed} m/s");
                    break;
                }
            }
            assert_eq!(near.rows.rows.len(), all.rows.rows.len(), "{speed} m/s");
            assert_eq!(bits(&near), bits(&all), "{speed} m/s");
            rows += near.rows.rows.len();
        }
        assert!(rows > 0, "{speed} m/s: nothing touches");
    }
}

#[test]
fn pairs_that_the_guess_keeps_apart_have_no_rows() {
    for law in [Law::Rigid, Law::Relaxed, Law::Lesson] {
        all_pairs_change_nothing::<f64>(law);
        all_pairs_change_nothing::<f32>(law);
        all_pairs_change_nothing::<Lanes>(law);
    }
}

/// The separating direction of the step before, which is tried first, only saves time.
fn hints_change_nothing<R: Real>() {
    let mut random = Random(23);
    let mut scene = scattered(&mut random, 8, 0.6);
    let on_ball = |_| {
        let point = V3::from_fn(|_, _| random.between(-1.0, 1.0));
        (point * (0.12 / point.norm())).into()
    };
    let vertices = Arc::new((0..80).map(on_ball).collect());
    scene.meshes.push(Mesh { vertices, ..Mesh::default() });
    let kinds = [GeomType::Mesh, GeomType::Cylinder, GeomType::Mesh, GeomType::Ellipsoid];
    for (geom, kind) in scene.geoms.iter_mut().skip(1).zip(kinds.into_iter().cycle()) {
        (geom.kind, geom.size) = (kind, [0.06, 0.1, 0.14]);
        geom.mesh = (kind == GeomType::Mesh).then_some(0);
    }
    let model = Arc::new(Model::compile(&scene).unwrap());
    let [mut known, mut blind] =
        [0; 2].map(|_| Sim::<R>::new(model.clone(), Settings::default()).unwrap());
    thrown(&mut random, &mut known, 1.0);
    blind.state.qvel.clone_from(&known.state.qvel);
    let (mut kept, mut touching) = (0, 0);
    for _ in 0..200 {
        blind.detected.hints.fill(Hint::default());
        known.step(1).unwrap();
        blind.step(1).unwrap();
        assert_eq!(bits(&known), bits(&blind));
        kept += known.detected.hints.iter().filter(|hint| **hint != Hint::default()).count();
        let convex = |contact: &&Contact<R>| matches!(contact.pair.test, ShapeTest::Convex(..));
        touching += known.detected.contacts.iter().filter(convex).count();
    }
    assert!(kept > 0 && touching > 0, "{kept} hints, {touching} contacts");
}

#[test]
fn what_the_step_before_found_changes_no_bit() {
    hints_change_nothing::<f64>();
    hints_change_nothing::<f32>();
    hints_change_nothing::<Lanes>();
}

#[test]
fn the_broad_phase_finds_what_comparing_all_boxes_finds() {
    let mut random = Random(11);
    let mut broad = Broad::default();
    for case in 0..60 {
        let count = 1 + (random.next() * 400.0) as usize;
        let room = random.between(0.5, 20.0);
        let spread = [0.0, 3.0, 12.0][case % 3];
        let scale = 2.0_f64.powf(random.between(-30.0, 30.0));
        let mut boxes: Vec<Bounds> = (0..count)
            .map(|geom| {
                let half = 0.1 * 2.0_f64.powf(random.between(-spread, spread));
                let mut centre = [0.0; 3].map(|_: f64| random.between(-room, room));
                // Some corners are shared, and some boxes are huge or NaN.
                if random.next() < 0.3 {
                    centre = centre.map(f64::round);
                }
                let mut bounds = Bounds {
                    low: centre.map(|x| scale * (x - half)),
                    high: centre.map(|x| scale * (x + half)),
                    geom: geom as u32,
                    fixed: random.next() < 0.2,
                };
                if random.next() < 0.01 {
                    bounds.high[1] = f64::INFINITY;
                }
                if random.next() < 0.01 {
                    bounds.low[0] = f64::NAN;
                }
                bounds
            })
            .collect();
        broad.find(boxes.iter().copied());
        broad.found.pairs.sort_unstable();
        broad.found.pairs.dedup();
        let mut all = vec![];
        for (k, one) in boxes.iter().enumerate() {
            all.extend(
                boxes[k + 1..]
                    .iter()
                    .filter(|two| one.overlaps(two))
                    .map(|two| (one.geom, two.geom)),
            );
        }
        assert_eq!(broad.found.pairs, all, "case {case}");
        boxes.iter_mut().for_each(|bounds| bounds.fixed = true);
        let fixed = Fixed::of(&boxes);
        for one in boxes.iter().map(|bounds| Bounds { fixed: false, ..*bounds }) {
            let mut found = vec![];
            fixed.overlapped(&one, |two| found.extend(one.overlaps(two).then_some(two.geom)));
            found.sort_unstable();
            let overlapped = boxes.iter().filter(|two| one.overlaps(two)).map(|two| two.geom);
            assert_eq!(found, overlapped.collect::<Vec<_>>(), "case {case}");
        }
    }
}

/// The same scene with all its pairs in a list, and as a pile; both with live islands.
fn two_ways<R: Real>(scene: &Scene, settings: &Settings) -> [Sim<R>; 2] {
    [usize::MAX, 0].map(|most| {
        let model = Arc::new(Model::compile_with(scene, most).unwrap());
        assert_eq!(model.dynamic_pairs.is_some(), most == 0);
        let mut sim = Sim::new(model, settings.clone()).unwrap();
        sim.rows.contact_islands = Some(ContactIslands::default());
        sim
    })
}

/// Slow bodies are searched for now and then, fast ones in every step; the pairs found are the same.
#[test]
fn kept_pairs_are_those_of_a_new_search() {
    for (speed, room, most) in [(0.05, 5.0, 20), (50.0, 0.9, 30)] {
        let mut random = Random(5);
        let mut scene = scattered(&mut random, 40, room);
        scene.gravity = [0.0; 3];
        let [_, mut sim] = two_ways::<f64>(&scene, &Settings::default());
        thrown(&mut random, &mut sim, speed);
        let mut searches = 0;
        for _ in 0..30 {
            sim.forward().unwrap();
            searches += usize::from(!sim.detected.kept.served);
            let found = |detected: &super::Detected<f64>| {
                let contacts = detected.contacts.iter();
                contacts.map(|c| (c.pair.index, c.part, c.dist.to_bits())).collect::<Vec<_>>()
            };
            assert_eq!(found(&sim.detected), found(&sim.detect_again()), "{speed} m/s");
            sim.step(1).unwrap();
        }
        assert!((1..=most).contains(&searches), "{speed} m/s: {searches} searches");
    }
}

fn a_heap_is_its_list<R: Real>(settings: &Settings, speed: f64, steps: u64) {
    let mut random = Random(23);
    for count in [9, 40] {
        let scene = scattered(&mut random, count, 0.9);
        let [mut list, mut heap] = two_ways::<R>(&scene, settings);
        thrown(&mut random, &mut list, speed);
        heap.state.qvel.clone_from(&list.state.qvel);
        let what = (settings.law, settings.solver, settings.integrator, count);
        let mut rows = 0;
        for _ in 0..steps {
            match (list.step(1), heap.step(1)) {
                (Ok(()), Ok(())) => {}
                (one, two) => {
                    assert!(one.is_err() && two.is_err(), "{what:?}");
                    break;
                }
            }
            let [one, two] = [&list, &heap].map(|sim| {
                let geoms = |c: &super::Contact<R>| (c.pair.geom1, c.pair.geom2, c.part);
                let alive = sim.detected.contacts.iter().filter(|c| c.mask.any());
                alive.map(geoms).collect::<Vec<_>>()
            });
            assert_eq!(one, two, "{what:?}");
            assert_eq!(bits(&list), bits(&heap), "{what:?}");
            rows += one.len();
            for (one, two) in list.rows.blocks.iter().zip(&heap.rows.blocks) {
                assert_eq!((one.island, one.rank), (two.island, two.rank));
                let [one, two] = [(&list, one), (&heap, two)]
                    .map(|(sim, block)| sim.model().element_name(block.element));
                assert_eq!(one, two);
            }
        }
        assert!(rows > 0, "{what:?}: nothing touches");
    }
}

#[test]
fn a_heap_steps_as_with_all_its_pairs_in_a_list() {
    let base = Settings { sweeps: 20.into(), ..Settings::default() };
    for solver in [Solver::Pgs, Solver::Newton] {
        let settings = Settings { solver, ..base.clone() };
        a_heap_is_its_list::<f64>(&settings, 2.0, 60);
        a_heap_is_its_list::<f32>(&settings, 2.0, 40);
    }
    for law in [Law::Rigid, Law::Relaxed, Law::Lesson, Law::Penalty] {
        let settings = Settings { law, solver: Solver::Pgs, ..base.clone() };
        a_heap_is_its_list::<f64>(&settings, 2.0, 40);
        a_heap_is_its_list::<f64>(&settings, 60.0, 10);
        a_heap_is_its_list::<f32>(&settings, 2.0, 20);
    }
    for integrator in [Integrator::ImplicitFast, Integrator::Rk4, Integrator::Midpoint] {
        let settings = Settings { integrator, ..base.clone() };
        a_heap_is_its_list::<f64>(&settings, 1.0, 10);
    }
}

#[test]
fn numbers_of_pairs_count_up_as_the_list_does() {
    let mut random = Random(5);
    let mut scene = scattered(&mut random, 12, 2.0);
    for (k, geom) in scene.geoms.iter_mut().enumerate() {
        geom.friction[0] = 0.3 + 0.2 * (k % 3) as f64;
        geom.contype = 1 << (k % 2);
        geom.conaffinity = [1, 3, 2][k % 3];
        geom.condim = if k % 4 == 0 { 1 } else { 3 };
    }
    scene.excludes.push([1, 3]);
    scene.pairs.push(ExplicitPair { geom1: 5, geom2: 2, ..ExplicitPair::default() });
    let [list, heap] = [usize::MAX, 0].map(|most| Model::compile_with(&scene, most).unwrap());
    let numbers = heap.dynamic_pairs.as_ref().unwrap();
    let mut last = None;
    for pair in &list.pairs {
        let number = heap.number(numbers, pair.geom1, pair.geom2);
        assert!(number.is_some() && last < number);
        last = number;
        let index = number.unwrap() as usize;
        assert_eq!(heap.contact_geoms(index), Some((pair.geom1, pair.geom2)));
        let near = heap.pair(index).unwrap();
        assert_eq!(heap.material(&near), list.material(pair));
        assert_eq!((near.test, near.still), (pair.test, pair.still));
        assert_eq!((near.mass, near.invweight), (pair.mass, pair.invweight));
    }
    let count = (0..numbers.numbers()).filter(|n| heap.contact_geoms(*n).is_some()).count();
    assert_eq!(count, list.pairs.len());
}

#[test]
fn pairs_are_counted_as_going_through_them_counts() {
    let mut random = Random(31);
    for _ in 0..20 {
        let mut scene = scattered(&mut random, 15, 2.0);
        let bodies = scene.bodies.len();
        for geom in &mut scene.geoms {
            geom.contype = (random.next() * 4.0) as u32;
            geom.conaffinity = (random.next() * 4.0) as u32;
        }
        for _ in 0..5 {
            let [one, two] = [(); 2].map(|()| (random.next() * bodies as f64) as usize);
            if one != two {
                scene.excludes.push([one, two]);
            }
        }
        for _ in 0..4 {
            let [geom1, geom2] =
                [(); 2].map(|()| 1 + (random.next() * (bodies - 1) as f64) as usize);
            let known = |p: &ExplicitPair| [geom1, geom2].contains(&p.geom1);
            if scene.geoms[geom1].body != scene.geoms[geom2].body && !scene.pairs.iter().any(known)
            {
                scene.pairs.push(ExplicitPair { geom1, geom2, ..ExplicitPair::default() });
            }
        }
        scene.features.filterparent = random.next() < 0.5;
        let [list, heap] = [usize::MAX, 0].map(|most| Model::compile_with(&scene, most).unwrap());
        let tally = heap.tally();
        assert_eq!(tally.meet.values().sum::<usize>(), list.pairs.len());
        for pair in &list.pairs {
            let kinds = (list.geoms[pair.geom1].kind, list.geoms[pair.geom2].kind);
            assert!(tally.meet.contains_key(&kinds));
        }
        let counts = |unmet: &std::collections::BTreeMap<_, crate::plan::Unmet>| {
            unmet.iter().map(|(why, unmet)| (*why, unmet.count)).collect::<Vec<_>>()
        };
        assert_eq!(counts(&heap.unmet()), counts(&list.unmet()));
        for (why, unmet) in heap.unmet() {
            assert!(!unmet.examples.is_empty(), "{why:?}");
        }
    }
}
