//! A batch is its worlds: in lanes or alone, over any number of threads, to the last
//! step that all of them can do. And arrays from outside are checked before they count.

mod scenes;

use std::panic::{catch_unwind, AssertUnwindSafe};
use std::sync::Arc;

use stepcore::arrays::{Array, Given};
use stepcore::batch::{Batch, Motion, Record, Sampled};
use stepcore::error::Error;
use stepcore::model::Model;
use stepcore::real::{Lanes, Real};
use stepcore::scene::{GeomType, JointType, Scene};
use stepcore::settings::{Integrator, Settings, Solver};

use scenes::Random;

/// One world's arrays.
struct World {
    qpos: Vec<f64>,
    qvel: Vec<f64>,
    act: Vec<f64>,
    ctrl: Vec<f64>,
    applied: Vec<f64>,
    wrenches: Vec<f64>,
    active: Vec<f64>,
}

impl World {
    fn new(model: &Model) -> Self {
        Self {
            qpos: model.qpos0.clone(),
            qvel: vec![0.0; model.nv],
            act: vec![0.0; model.na],
            ctrl: vec![0.0; model.actuators.len()],
            applied: vec![0.0; model.nv],
            wrenches: vec![0.0; 6 * model.bodies.len()],
            active: Array::EqActive.initial(model),
        }
    }
    fn given(&self) -> Given<'_> {
        Given::new(|array| match array {
            Array::Qpos => &self.qpos,
            Array::Qvel => &self.qvel,
            Array::Act => &self.act,
            Array::Ctrl => &self.ctrl,
            Array::QfrcApplied => &self.applied,
            Array::XfrcApplied => &self.wrenches,
            Array::EqActive => &self.active,
            Array::CtrlHistory | Array::MocapPos | Array::MocapQuat => &[],
        })
    }
}

fn batch_of<R: Real>(
    scene: &Scene,
    settings: &Settings,
    worlds: &[World],
    threads: usize,
) -> Batch<R> {
    let model = Arc::new(Model::compile(scene).unwrap());
    let mut batch = Batch::<R>::new(model, settings, worlds.len(), threads).unwrap();
    for (index, world) in worlds.iter().enumerate() {
        batch.check(index, &world.given()).unwrap();
        batch.put(index, &world.given());
    }
    batch
}

fn states<R: Real>(batch: &Batch<R>, worlds: &mut [World]) -> Vec<u64> {
    for (index, world) in worlds.iter_mut().enumerate() {
        let World { qpos, qvel, act, .. } = world;
        for (array, out) in Array::ALL.into_iter().zip([qpos, qvel, act]) {
            batch.take(index, array, out);
        }
    }
    worlds.iter().flat_map(|w| w.qpos.iter().chain(&w.qvel)).map(|x| x.to_bits()).collect()
}

/// Runners at various speeds, 11 of them: one register of lanes and a part of one.
fn runners(model: &Model) -> Vec<World> {
    let mut random = Random(7);
    (0..11)
        .map(|_| {
            let mut world = World::new(model);
            world.qvel.iter_mut().for_each(|v| *v = random.next());
            world.ctrl.iter_mut().for_each(|u| *u = random.next());
            world.applied[2] = random.next();
            world
        })
        .collect()
}

#[test]
fn lanes_and_threads_change_no_bit() {
    let scene = scenes::runner();
    let model = Model::compile(&scene).unwrap();
    let settings = Settings { solver: Solver::Pgs, tolerance: 1e-6, ..Settings::default() };
    let mut seen = Vec::new();
    for threads in [1, 3] {
        let mut worlds = runners(&model);
        let mut pack = batch_of::<Lanes>(&scene, &settings, &worlds, threads);
        pack.step(200).unwrap();
        seen.push(states(&pack, &mut worlds));
        let mut worlds = runners(&model);
        let mut alone = batch_of::<f64>(&scene, &settings, &worlds, threads);
        alone.step(120).unwrap();
        alone.step(80).unwrap();
        seen.push(states(&alone, &mut worlds));
    }
    assert!(seen.iter().all(|bits| *bits == seen[0]));
}

/// Worlds of several models, in any order, are those of a batch of each model.
#[test]
fn worlds_of_several_models_are_worlds_of_each() {
    let heavy = |mass: f64| {
        let mut scene = scenes::runner();
        scene.geoms.iter_mut().skip(1).for_each(|geom| geom.mass = Some(mass));
        scene.geoms[0].friction[0] *= mass;
        scene.joints.iter_mut().for_each(|joint| joint.damping[0] = 0.1 * mass);
        scene.actuators.iter_mut().for_each(|motor| motor.gear[0] *= mass);
        Arc::new(Model::compile(&scene).unwrap())
    };
    let models = vec![heavy(1.0), heavy(1.5), heavy(0.7)];
    let model_of = [0, 1, 0, 2, 1, 1, 0, 0, 2, 1, 0];
    let settings = Settings::default();
    for threads in [1, 3] {
        let mut worlds = runners(&models[0]);
        let mut batch =
            Batch::<Lanes>::of_models(models.clone(), &model_of, &settings, threads).unwrap();
        worlds.iter().enumerate().for_each(|(index, world)| batch.put(index, &world.given()));
        batch.step(150).unwrap();
        let bits = states(&batch, &mut worlds);
        let mut worlds = runners(&models[0]);
        for (world, model) in worlds.iter_mut().zip(model_of) {
            let mut alone = Batch::<f64>::new(models[model].clone(), &settings, 1, 1).unwrap();
            alone.put(0, &world.given());
            alone.step(150).unwrap();
            states(&alone, std::slice::from_mut(world));
        }
        let own = worlds.iter().flat_map(|w| w.qpos.iter().chain(&w.qvel)).map(|x| x.to_bits());
        assert_eq!(bits, own.collect::<Vec<_>>());
    }
}

/// A motion with a sample of the state after each step.
fn motion<'a>(
    worlds: usize,
    samples: usize,
    qpos: &'a mut [f64],
    qvel: &'a mut [f64],
) -> Motion<'a> {
    let record = |array, numbers| Record { what: Sampled::Array(array), numbers };
    Motion {
        every: 1,
        samples,
        first: false,
        ctrl: &[],
        rows: 0,
        hold: 1,
        bound: f64::INFINITY,
        most: u64::MAX,
        home: Vec::new(),
        records: vec![record(Array::Qpos, qpos), record(Array::Qvel, qvel)],
        evaluations: vec![0; worlds],
    }
}

#[test]
fn a_play_in_portions_is_steps_with_its_controls() {
    let scene = scenes::runner();
    let model = Model::compile(&scene).unwrap();
    let (nu, nq, nv, steps) = (model.actuators.len(), model.nq, model.nv, 30);
    let mut worlds = runners(&model);
    let mut random = Random(3);
    let ctrl: Vec<f64> = (0..worlds.len() * steps * nu).map(|_| random.next()).collect();
    let (mut qpos, mut qvel) =
        (vec![0.0; worlds.len() * steps * nq], vec![0.0; worlds.len() * steps * nv]);
    let mut pack = batch_of::<Lanes>(&scene, &Settings::default(), &worlds, 2);
    let mut motion = motion(worlds.len(), steps, &mut qpos, &mut qvel);
    (motion.ctrl, motion.rows) = (&ctrl, steps);
    pack.follow(&mut motion, 0, 13).unwrap();
    pack.follow(&mut motion, 13, steps - 13).unwrap();
    let mut alone = batch_of::<f64>(&scene, &Settings::default(), &worlds, 1);
    for step in 0..steps {
        for (index, world) in worlds.iter_mut().enumerate() {
            world.ctrl.copy_from_slice(&ctrl[(index * steps + step) * nu..][..nu]);
            alone.put(index, &world.given());
        }
        alone.step(1).unwrap();
        states(&alone, &mut worlds);
        for (index, world) in worlds.iter().enumerate() {
            assert_eq!(world.qpos, qpos[(index * steps + step) * nq..][..nq]);
            assert_eq!(world.qvel, qvel[(index * steps + step) * nv..][..nv]);
        }
    }
}

/// A spring that its step is ten times too long for.
fn unstable() -> (Scene, Settings) {
    let mut scene = Scene::default();
    let body = scenes::body(&mut scene, 0, [0.0; 3]);
    scenes::geom(&mut scene, body, GeomType::Sphere, [0.1, 0.0, 0.0]).mass = Some(1.0);
    scenes::joint(&mut scene, body, JointType::Slide, [1.0, 0.0, 0.0]).stiffness[0] = 1e4;
    (scene, Settings { dt: 0.1, integrator: Integrator::SemiImplicit, ..Settings::default() })
}

#[test]
fn all_worlds_stop_before_the_first_that_diverges() {
    let (scene, settings) = unstable();
    let model = Model::compile(&scene).unwrap();
    for threads in [1, 2] {
        let mut worlds: Vec<World> = (0..20).map(|_| World::new(&model)).collect();
        worlds[12].qpos[0] = 1.0;
        worlds[18].qpos[0] = 1e200;
        let mut batch = batch_of::<Lanes>(&scene, &settings, &worlds, threads);
        let Err(Error::Diverged(divergence)) = batch.step(10_000) else {
            panic!("no error of divergence")
        };
        let step = divergence.step;
        assert_eq!(divergence.world, 18);
        assert!(divergence.to_string().contains(" in world 18. "), "{divergence}");
        assert_eq!(batch.time(), step as f64 * 0.1);
        let mut alone = batch_of::<f64>(&scene, &settings, &worlds, 1);
        alone.step(step).unwrap();
        let bits = states(&batch, &mut worlds);
        assert_eq!(bits, states(&alone, &mut worlds));
        assert!(alone.step(1).is_err());
    }
}

/// A defect that panics in the middle of a call leaves every world where its last step left it.
#[test]
fn after_a_panic_the_worlds_are_still_there() {
    let scene = scenes::runner();
    let model = Model::compile(&scene).unwrap();
    let settings = Settings { ledger: true, ..Settings::default() };
    let mut worlds = runners(&model);
    let (n, nq, nv) = (worlds.len(), model.nq, model.nv);
    let mut batch = batch_of::<Lanes>(&scene, &settings, &worlds, 1);
    let (mut qpos, mut qvel) = (vec![0.0; n * nq], vec![0.0; n * nv]);
    batch.step(70).unwrap();
    let ctrl = vec![0.0; model.actuators.len()];
    let mut motion = motion(n, 1, &mut qpos, &mut qvel);
    (motion.ctrl, motion.rows, motion.hold) = (&ctrl, 1, 0);
    let outcome = catch_unwind(AssertUnwindSafe(|| batch.follow(&mut motion, 0, 1)));
    assert!(outcome.is_err(), "a row that is held for no step must not pass");
    batch.step(70).unwrap();
    assert_eq!(batch.time(), 140.0 * settings.dt);
    let bits = states(&batch, &mut worlds);
    let mut whole = batch_of::<Lanes>(&scene, &settings, &runners(&model), 1);
    whole.step(140).unwrap();
    assert_eq!(bits, states(&whole, &mut worlds));
}

#[test]
fn arrays_and_sizes_are_refused_by_name() {
    let (scene, settings) = unstable();
    let model = Arc::new(Model::compile(&scene).unwrap());
    let mut world = World::new(&model);
    world.qvel[0] = f64::NAN;
    let text = world.given().check::<f64>(&model, Some(3)).unwrap_err().to_string();
    assert!(text.starts_with("qvel[0] = NaN: must be finite (joint `joint0`, world 3)"), "{text}");
    world.qvel[0] = 1e39;
    assert!(world.given().check::<f64>(&model, None).is_ok());
    assert!(world.given().check::<f32>(&model, None).is_err());
    for (worlds, threads) in [(0, 1), (usize::MAX / 2, 1), (1, 0), (1, usize::MAX)] {
        assert!(Batch::<f64>::new(model.clone(), &settings, worlds, threads).is_err());
    }
}
