//! Machine code of a step: the numbers of the stages, to the bit, in as few operations as the scene needs.

mod scenes;

use std::sync::Arc;

use scenes::{body, floor, geom, joint, put, spring, start, tower};
use stepcore::arrays::Array;
use stepcore::batch::Batch;
use stepcore::compile::Compiled;
use stepcore::model::Model;
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

fn code<R: Real>(model: &Arc<Model>, settings: &Settings) -> Option<Arc<Compiled>> {
    Compiled::of::<R>(&[model.clone()].into(), settings, usize::MAX)
}

fn bits<R: Real>(numbers: &[R]) -> Vec<u64> {
    numbers.iter().map(|x| x.lane(0).to_bits()).collect()
}

/// In how many scenes there is code.
fn same_as_the_stages<R: Real>() -> usize {
    let mut compiled_scenes = 0;
    for (name, scene, settings) in scenes() {
        let model = compiled(&scene);
        let [mut one, mut other] =
            [0; 2].map(|_| Sim::<R>::new(model.clone(), settings.clone()).unwrap());
        one.use_code();
        compiled_scenes += usize::from(code::<R>(&model, &settings).is_some());
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
    compiled_scenes
}

#[test]
fn code_has_the_bits_of_the_stages() {
    assert!(same_as_the_stages::<f64>() >= 20);
    assert!(same_as_the_stages::<f32>() >= 20);
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
fn compiled_batches_are_their_worlds() {
    std::env::set_var("STEPCORE_COMPILE", "now");
    a_batch_is_its_worlds::<Lanes, f64>();
    a_batch_is_its_worlds::<LanesF32, f32>();
    a_batch_is_its_worlds::<f64, f64>();
}

/// What a step costs, in operations: constants are no part of it, and neither is what is not there.
#[test]
fn a_step_is_what_the_scene_requires() {
    let of = |scene: &Scene, settings: &Settings| {
        code::<f64>(&compiled(scene), settings).expect("machine code")
    };
    let of_spring = of(&spring(), &swept(Law::Lesson, 1));
    let of_drop = of(&smooth(1), &swept(Law::Lesson, 1));
    let of_stack = of(&smooth(2), &swept(Law::Relaxed, 20));
    for code in [&of_spring, &of_drop, &of_stack] {
        println!("{} operations", code.operations);
        code.lines::<f64>().iter().take(120).for_each(|line| println!("  {line}"));
    }
    // Of each line of state two are its acceleration, which is kept.
    assert!(of_spring.lines::<f64>().len() <= 10, "{}", of_spring.lines::<f64>().len());
    assert!(of_drop.lines::<f64>().len() <= 46, "{}", of_drop.lines::<f64>().len());
    assert!(of_stack.operations <= 290, "{}", of_stack.operations);
}
