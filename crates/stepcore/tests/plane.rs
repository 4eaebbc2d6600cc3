//! Trees that move in a plane: their poses, mass matrix and bias force are those of space, to rounding.

mod scenes;

use std::sync::Arc;

use scenes::{body, geom, joint, Random};
use stepcore::model::Model;
use stepcore::place::Placed;
use stepcore::scene::{GeomType, Inertial, JointType, Scene};
use stepcore::settings::{Integrator, Settings};
use stepcore::sim::Sim;

/// The frame's z axis along a world axis.
const FRAMES: [[f64; 4]; 3] = [[0.5, 0.5, 0.5, 0.5], [0.5, -0.5, -0.5, -0.5], [1.0, 0.0, 0.0, 0.0]];

/// A branching tree in the plane across its frame's z axis: slides and hinges in any order, turned
/// and flipped frames, bodies out of the plane, inertias without symmetry, a body that is fixed.
fn tree(frame: [f64; 4], random: &mut Random) -> Scene {
    let mut scene = Scene { gravity: [1.0, -2.0, -9.0], ..Scene::default() };
    let base = body(&mut scene, 0, [0.3, -0.2, 0.5]);
    scene.bodies[base].quat = frame;
    for (k, parent) in [0, 1, 2, 2, 4, 1, 6, 7, 6].into_iter().enumerate() {
        let pos = [random.next(), random.next(), random.next()];
        let link = body(&mut scene, base + parent, pos);
        scene.bodies[link].quat = match k % 3 {
            0 => [1.0, 0.0, 0.0, 0.0],
            1 => [0.8, 0.0, 0.0, 0.6],
            _ => [0.0, 1.0, 0.0, 0.0],
        };
        let inertia =
            [1.1, 1.3, 1.6, 0.1 * random.next(), 0.1 * random.next(), 0.1 * random.next()];
        let pos = [random.next(), random.next(), random.next()];
        scene.bodies[link].inertial =
            Some(Inertial { mass: 1.5 + random.next(), pos, inertia, axes: None });
        let size = [0.1, 0.2, 0.3];
        let own = geom(&mut scene, link, GeomType::Box, size);
        (own.pos, own.quat) = (pos, [0.2, -0.4, 0.8, 0.4]);
        if k % 4 == 0 {
            joint(&mut scene, link, JointType::Slide, [0.6, 0.8, 0.0]);
        }
        if k != 5 {
            let hinge = joint(&mut scene, link, JointType::Hinge, [0.0, 0.0, 1.0]);
            hinge.pos = [random.next(), random.next(), random.next()];
        }
        if k == 6 {
            joint(&mut scene, link, JointType::Hinge, [0.0, 0.0, -1.0]).armature = 0.3;
        }
    }
    scene
}

/// The mass matrix, the bias force, and poses and motions at a random state.
fn dynamics(model: &Model, settings: &Settings, seed: u64) -> [Vec<f64>; 3] {
    let mut random = Random(seed);
    let mut sim = Sim::<f64>::new(Arc::new(model.clone()), settings.clone()).unwrap();
    sim.state.qpos.iter_mut().for_each(|q| *q = 3.0 * random.next());
    sim.state.qvel.iter_mut().for_each(|v| *v = 5.0 * random.next());
    sim.refresh();
    let Placed { xpos, xquat, xmat, motion, geom, mass, bias, .. } = &sim.placed;
    let mut placed = Vec::new();
    xpos.iter().for_each(|pos| placed.extend(pos.iter()));
    xquat.iter().for_each(|quat| placed.extend(quat.v.iter().chain([&quat.w])));
    xmat.iter().for_each(|rot| placed.extend(rot.iter()));
    motion.iter().for_each(|motion| placed.extend(motion.ang.iter().chain(motion.lin.iter())));
    geom.iter().for_each(|pose| placed.extend(pose.pos.iter().chain(pose.rot.iter())));
    [mass.clone(), bias.clone(), placed]
}

/// The same model, as if it left its plane.
fn in_space(model: &Model) -> Model {
    let mut model = model.clone();
    model.trees[0].plane = None;
    model.geoms.iter_mut().for_each(|geom| geom.in_plane = None);
    model
}

fn near(a: &[f64], b: &[f64]) {
    let size = b.iter().fold(0.0_f64, |size, x| size.max(x.abs()));
    for (a, b) in a.iter().zip(b) {
        assert!((a - b).abs() <= 1e-13 * size, "{a} {b}");
    }
}

#[test]
fn a_plane_gives_what_space_gives() {
    for (normal, frame) in FRAMES.into_iter().enumerate() {
        let mut random = Random(normal as u64);
        for coriolis in [true, false] {
            let mut scene = tree(frame, &mut random);
            scene.features.coriolis = coriolis;
            let model = Model::compile(&scene).unwrap();
            assert_eq!(model.trees[0].plane.as_ref().map(|plane| plane.normal), Some(normal));
            let in_space = in_space(&model);
            for seed in 0..20 {
                for integrator in [Integrator::Euler, Integrator::Implicit] {
                    let settings = Settings { integrator, ..Settings::default() };
                    let found = dynamics(&model, &settings, seed);
                    let truth = dynamics(&in_space, &settings, seed);
                    found.iter().zip(&truth).for_each(|(found, truth)| near(found, truth));
                }
            }
        }
    }
}

/// What reads bodies in space reads the same in a plane.
#[test]
fn momentum_is_that_of_space() {
    let model = Model::compile(&tree(FRAMES[0], &mut Random(5))).unwrap();
    let in_space = in_space(&model);
    let momentum = |model: &Model| {
        let mut sim = Sim::<f64>::new(Arc::new(model.clone()), Settings::default()).unwrap();
        sim.state.qvel.iter_mut().enumerate().for_each(|(k, v)| *v = k as f64);
        let momentum = sim.momentum();
        momentum.ang.iter().chain(momentum.lin.iter()).copied().collect::<Vec<_>>()
    };
    near(&momentum(&model), &momentum(&in_space));
}

#[test]
fn what_leaves_the_plane_is_in_space() {
    let plane_of = |change: &dyn Fn(&mut Scene)| {
        let mut scene = tree(FRAMES[2], &mut Random(1));
        change(&mut scene);
        Model::compile(&scene).unwrap().trees[0].plane.clone()
    };
    assert!(plane_of(&|_| {}).is_some());
    assert_eq!(plane_of(&|scene| scene.joints[3].axis = [0.0, 1e-9, 1.0]), None);
    assert_eq!(plane_of(&|scene| scene.joints[0].axis = [0.6, 0.8, 1e-9]), None);
    assert_eq!(plane_of(&|scene| scene.joints[8].kind = JointType::Ball), None);
}
