//! The plan is what a step executes: operations are those of what it lists, and what it leaves out
//! costs none.

mod scenes;

use std::sync::Arc;

use scenes::{body, floor, geom, joint, limb, put, start};
use stepcore::model::Model;
use stepcore::plan::Plan;
use stepcore::real::{Counted, Stage};
use stepcore::scene::{Actuator, GeomType, JointType, Scene, Site, Stop, Target, Tendon};
use stepcore::settings::{Integrator, Settings};
use stepcore::sim::Sim;

type Counts = [u64; Stage::ALL.len()];

/// Three limbs about crossed axes over a floor, and a free ball.
fn base() -> Scene {
    let mut scene = floor();
    let mut parent = 0;
    for (link, axis) in [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]].into_iter().enumerate()
    {
        let pos = if link > 0 { [0.3, 0.0, 0.0] } else { [0.0, 0.0, 2.0] };
        parent = body(&mut scene, parent, pos);
        joint(&mut scene, parent, JointType::Hinge, axis);
        limb(&mut scene, parent, [0.0; 3], [0.3, 0.0, 0.0], 0.03);
    }
    let ball = body(&mut scene, 0, [2.0, 0.0, 1.0]);
    joint(&mut scene, ball, JointType::Free, [0.0, 0.0, 1.0]);
    geom(&mut scene, ball, GeomType::Sphere, [0.1, 0.0, 0.0]);
    scene
}

/// Operations of a step, by stage.
fn counts(scene: &Scene, integrator: Integrator) -> Counts {
    let model = Arc::new(Model::compile(scene).unwrap());
    let settings = Settings { integrator, ..Settings::default() };
    let mut sim = Sim::<Counted>::new(model.clone(), settings).unwrap();
    put(&mut sim, 0, &start(&model, 3));
    sim.step(1).unwrap();
    Counted::take();
    sim.step(1).unwrap();
    Counted::take()
}

fn motor(joint: usize) -> Actuator {
    let gear = [2.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    Actuator { name: "motor".into(), target: Target::Joint(joint), gear, ..Actuator::default() }
}

const INTEGRATORS: [Integrator; 4] =
    [Integrator::Euler, Integrator::ImplicitFast, Integrator::Discrete, Integrator::Rk4];

type Change = fn(&mut Scene);

#[test]
fn what_does_nothing_costs_nothing() {
    let idle: [(&str, Change); 8] = [
        ("a tendon that nothing pulls", |scene| {
            let path =
                vec![Stop::Joint { joint: 0, coef: 1.0 }, Stop::Joint { joint: 2, coef: -1.0 }];
            scene.tendons.push(Tendon { name: "slack".into(), path, ..Tendon::default() });
        }),
        ("an actuator that is left out", |scene| {
            scene.actuators.push(Actuator { enabled: false, ..motor(0) });
        }),
        ("a site", |scene| {
            scene.sites.push(Site {
                name: String::new(),
                body: 2,
                pos: [0.1, 0.0, 0.0],
                quat: [1.0, 0.0, 0.0, 0.0],
                kind: GeomType::Sphere,
                size: [0.01; 3],
            });
        }),
        ("a geom that meets nothing", |scene| {
            let ghost = geom(scene, 4, GeomType::Box, [0.01; 3]);
            (ghost.contype, ghost.conaffinity, ghost.mass) = (0, 0, Some(0.0));
        }),
        ("a spring without stiffness", |scene| scene.joints[0].stiffness = [0.0; 3]),
        ("springs that are switched off", |scene| {
            scene.joints[1].stiffness[0] = 3.0;
            scene.features.spring = false;
        }),
        ("dampers that are switched off", |scene| {
            scene.joints[1].damping[0] = 3.0;
            scene.features.damper = false;
        }),
        ("friction losses that are switched off", |scene| {
            scene.joints[0].frictionloss = 3.0;
            scene.features.frictionloss = false;
        }),
    ];
    for integrator in INTEGRATORS {
        let expected = counts(&base(), integrator);
        for (what, add) in idle {
            let mut scene = base();
            add(&mut scene);
            assert_eq!(counts(&scene, integrator), expected, "{what}, {}", integrator.name());
        }
    }
}

/// Forces are a sum over the plan's lists: each element adds its own operations, and no others.
#[test]
fn each_force_adds_its_own_operations() {
    let acting: [(&str, Change); 5] = [
        ("dampers", |scene| scene.joints[0].damping[0] = 0.2),
        ("springs", |scene| scene.joints[1].stiffness = [2.0, 1.0, 0.0]),
        ("dampers", |scene| scene.joints[2].damping = [0.1, 0.0, 0.3]),
        ("springs", |scene| scene.joints[3].stiffness[0] = 1.0),
        ("actuators", |scene| scene.actuators.push(motor(1))),
    ];
    let forces = Stage::ALL.iter().position(|stage| *stage == Stage::Forces).unwrap();
    let of = |scene: &Scene| counts(scene, Integrator::SemiImplicit)[forces];
    let none = of(&base());
    let (mut all, mut sum) = (base(), none);
    for (name, add) in acting {
        let mut scene = base();
        add(&mut scene);
        add(&mut all);
        let own = of(&scene) - none;
        assert!(own > 0, "{name}");
        sum += own;
        let (model, settings) = (Model::compile(&scene).unwrap(), Settings::default());
        let entries = Plan::of(&model, &settings).entries(&model, &settings);
        let entry = entries.iter().find(|entry| entry.used && entry.name == name);
        assert_eq!(entry.unwrap().count, 1, "{name}");
    }
    assert_eq!(of(&all), sum);
}
