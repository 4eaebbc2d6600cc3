//! The list of a step: the numbers of the stages, to the bit, in as few operations as the scene needs.

mod scenes;

use std::sync::Arc;

use scenes::{body, floor, geom, joint, put, spring, start, tower};
use stepcore::arrays::Array;
use stepcore::batch::Batch;
use stepcore::model::Model;
use stepcore::program::Program;
use stepcore::real::{Lanes, LanesF32, Real};
use stepcore::scene::{GeomType, JointType, Scene};
use stepcore::settings::{Integrator, Law, Settings, Solver};
use stepcore::sim::Sim;

/// Balls on vertical slides without friction.
fn smooth(count: usize) -> Scene {
    let mut scene = tower(count);
    scene.geoms[0].condim = 1;
    scene
}

/// Two limbs that hang and turn, sprung and damped, over a floor that they reach.
fn pendulum() -> Scene {
    let mut scene = floor();
    let upper = body(&mut scene, 0, [0.0, 0.0, 0.5]);
    joint(&mut scene, upper, JointType::Hinge, [0.0, 1.0, 0.0]).damping[0] = 0.02;
    geom(&mut scene, upper, GeomType::Sphere, [0.05, 0.0, 0.0]).pos = [0.2, 0.0, -0.1];
    let lower = body(&mut scene, upper, [0.25, 0.0, -0.1]);
    joint(&mut scene, lower, JointType::Hinge, [0.0, 1.0, 0.0]).stiffness[0] = 1.0;
    geom(&mut scene, lower, GeomType::Sphere, [0.05, 0.0, 0.0]).pos = [0.0, 0.0, -0.3];
    scene
}

fn swept(law: Law, sweeps: u32) -> Settings {
    Settings {
        solver: Solver::Pgs,
        sweeps: sweeps.into(),
        tolerance: 0.0,
        warm_start: false,
        integrator: Integrator::SemiImplicit,
        softness: 0.5,
        max_contacts: 4,
        law,
        ..Settings::default()
    }
}

fn scenes() -> Vec<(&'static str, Scene, Settings)> {
    let mut all = vec![
        ("spring", spring(), Settings::default()),
        ("spring, swept", spring(), swept(Law::Lesson, 1)),
    ];
    for law in [Law::Lesson, Law::Relaxed, Law::Rigid, Law::Penalty, Law::SolRef] {
        all.push(("drop", smooth(1), swept(law, 1)));
        all.push(("stack", smooth(2), swept(law, 4)));
        all.push(("tower", tower(2), swept(law, 3)));
        all.push(("pendulum", pendulum(), swept(law, 3)));
    }
    for integrator in [Integrator::Explicit, Integrator::Euler, Integrator::ImplicitFast] {
        let settings = Settings { integrator, ..swept(Law::Rigid, 2) };
        all.push(("pendulum", pendulum(), settings));
    }
    all
}

fn compiled(scene: &Scene) -> Arc<Model> {
    Arc::new(Model::compile(scene).unwrap())
}

fn bits<R: Real>(numbers: &[R]) -> Vec<u64> {
    numbers.iter().map(|x| x.lane(0).to_bits()).collect()
}

/// In how many scenes a list made steps.
fn same_as_the_stages<R: Real>() -> usize {
    let mut listed = 0;
    for (name, scene, settings) in scenes() {
        let model = compiled(&scene);
        let [mut one, mut other] =
            [0; 2].map(|_| Sim::<R>::new(model.clone(), settings.clone()).unwrap());
        one.use_list();
        listed += usize::from(Program::of::<R>(&model, &settings).is_some());
        for world in 0..4 {
            for sim in [&mut one, &mut other] {
                put(sim, 0, &start(&model, world));
            }
            for call in 0..12 {
                one.step(50).unwrap();
                (0..50).for_each(|_| other.step(1).unwrap());
                let case = format!("{name}, {:?}, world {world}, call {call}", settings.law);
                let [a, b] =
                    [&one, &other].map(|sim| [bits(&sim.state.qpos), bits(&sim.state.qvel)]);
                assert_eq!(a, b, "{case}");
                assert_eq!(bits(&one.qacc), bits(&other.qacc), "{case}");
                assert_eq!(one.effort, other.effort, "{case}");
                assert_eq!(one.state.steps, other.state.steps);
            }
        }
    }
    listed
}

#[test]
fn a_list_has_the_bits_of_the_stages() {
    assert!(same_as_the_stages::<f64>() >= 12);
    assert!(same_as_the_stages::<f32>() >= 12);
}

/// Worlds of a batch, whatever they meet, are those that step alone.
fn a_batch_is_its_worlds<R: Real, One: Real>() {
    for (name, scene, settings) in scenes() {
        let (model, worlds) = (compiled(&scene), 37);
        let mut batch = Batch::<R>::new(model.clone(), &settings, worlds, 2).unwrap();
        let mut sims: Vec<Sim<One>> = vec![];
        for world in 0..worlds {
            let mut sim = Sim::new(model.clone(), settings.clone()).unwrap();
            put(&mut sim, 0, &start(&model, world));
            sims.push(sim);
        }
        for (state, own) in batch.states_mut() {
            for lane in 0..R::LANES {
                let (qpos, qvel, _) = start(&model, own[lane.min(own.len() - 1)]);
                state.qpos.iter_mut().zip(&qpos).for_each(|(to, x)| to.set_lane(lane, *x));
                state.qvel.iter_mut().zip(&qvel).for_each(|(to, x)| to.set_lane(lane, *x));
            }
        }
        for n in [1, 2, 40, 7] {
            batch.step(n).unwrap();
            for (world, sim) in sims.iter_mut().enumerate() {
                (0..n).for_each(|_| sim.step(1).unwrap());
                let mut qpos = vec![0.0; model.nq];
                batch.take(world, Array::Qpos, &mut qpos);
                assert_eq!(bits(&qpos), bits(&sim.state.qpos), "{name}, {:?}", settings.law);
                let qacc: Vec<f64> = batch.qacc(world).collect();
                assert_eq!(bits(&qacc), bits(&sim.qacc), "{name}, {:?}", settings.law);
            }
        }
    }
}

#[test]
fn listed_batches_are_their_worlds() {
    a_batch_is_its_worlds::<Lanes, f64>();
    a_batch_is_its_worlds::<LanesF32, f32>();
    a_batch_is_its_worlds::<f64, f64>();
}

/// What a step costs, in operations: constants are no part of it, and neither is what is not there.
#[test]
fn a_step_is_what_the_scene_requires() {
    let list = |scene: &Scene, settings: &Settings| {
        Program::of::<f64>(&compiled(scene), settings).expect("a list")
    };
    let of_spring = list(&spring(), &swept(Law::Lesson, 1));
    let of_drop = list(&smooth(1), &swept(Law::Lesson, 1));
    let of_stack = list(&smooth(2), &swept(Law::Relaxed, 20));
    for list in [&of_spring, &of_drop, &of_stack] {
        println!("{} operations", list.operations());
        list.lines().iter().take(120).for_each(|line| println!("  {line}"));
    }
    assert_eq!(of_spring.operations(), 5);
    assert_eq!(of_drop.operations(), 25);
    assert!(of_stack.operations() <= 680, "{}", of_stack.operations());
}

/// A list that is of no use is given up, however many sweeps are asked for: looking for it takes no
/// longer than its first entries.
#[test]
fn sweeps_without_end_are_not_written_down() {
    let model = compiled(&tower(2));
    for law in [Law::Lesson, Law::Relaxed, Law::Rigid, Law::SolRef] {
        let endless = swept(law, u32::MAX);
        assert!(Program::of::<f64>(&model, &endless).is_none(), "{law:?}");
        let kept = Settings { warm_start: true, ..endless.clone() };
        assert!(Program::of::<f64>(&model, &kept).is_none(), "{law:?}");
        let within = Settings { tolerance: 1e-9, ..endless };
        assert!(Program::of::<f64>(&model, &within).is_none(), "{law:?}");
    }
}
