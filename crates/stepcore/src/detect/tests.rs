//! What is left out must change nothing: steps with and without it are the same bits.

use crate::model::Model;
use crate::real::{Lanes, Real};
use crate::scene::{Body, Geom, GeomType, Joint, JointType, Scene};
use crate::settings::{Law, Settings, Solver};
use crate::sim::Sim;
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
        let pos = std::array::from_fn(|_| random.between(0.0, room));
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
