//! Whole scenes against closed forms, through the engine's public face.

use std::sync::Arc;
use stepcore::elements::Kind;
use stepcore::error::Error;
use stepcore::model::Model;
use stepcore::scene::{Body, Geom, GeomType, Joint, JointType, Scene};
use stepcore::settings::{Integrator, Law, Settings, Solver};
use stepcore::sim::Sim;
use stepcore::watch::Watched;

const G: f64 = 9.81;

fn sphere(body: usize) -> Geom {
    Geom { body, size: [0.1, 0.0, 0.0], mass: Some(1.0), condim: 1, ..Geom::default() }
}

/// Unit balls of radius 0.1 on vertical slides above a floor, centres at `heights`.
fn balls(heights: &[f64]) -> Scene {
    let mut scene = Scene::default();
    let floor = Geom { kind: GeomType::Plane, condim: 1, ..Geom::default() };
    scene.geoms.push(floor);
    for (index, z) in heights.iter().enumerate() {
        let body = index + 1;
        scene.bodies.push(Body { pos: [0.0, 0.0, *z], ..Body::default() });
        scene.joints.push(Joint { body, kind: JointType::Slide, ..Joint::default() });
        scene.geoms.push(sphere(body));
    }
    scene
}

fn sim(scene: &Scene, settings: Settings) -> Sim<f64> {
    Sim::new(Arc::new(Model::compile(scene).unwrap()), settings).unwrap()
}

fn lesson(law: Law) -> Settings {
    Settings {
        law,
        softness: 0.5,
        solver: Solver::Pgs,
        integrator: Integrator::SemiImplicit,
        warm_start: false,
        tolerance: 0.0,
        ..Settings::default()
    }
}

#[test]
fn a_spring_under_each_integrator() {
    let mut scene = Scene { gravity: [0.0; 3], ..Scene::default() };
    scene.bodies.push(Body::default());
    let joint =
        Joint { body: 1, kind: JointType::Slide, stiffness: [100.0, 0.0, 0.0], ..Joint::default() };
    scene.joints.push(joint);
    scene.geoms.push(sphere(1));
    let table = [
        (Integrator::Explicit, 439_286_205.05, 1e-10),
        (Integrator::SemiImplicit, 1.049_825_516_576_3, 1e-12),
        (Integrator::Midpoint, 1.0, 1e-12),
        (Integrator::Rk4, 0.999_972_257_33, 1e-11),
        // Backward Euler: 1/(1 + ω²dt²) a step.
        (Integrator::Discrete, 1.01_f64.powi(-2000), 1e-11),
    ];
    for (integrator, ratio, tolerance) in table {
        let mut sim = sim(&scene, Settings { dt: 0.01, integrator, ..Settings::default() });
        sim.state.qpos[0] = 1.0;
        sim.step(2000).unwrap();
        let (x, v) = (sim.state.qpos[0], sim.state.qvel[0]);
        let energy = (0.5 * v * v + 50.0 * x * x) / 50.0;
        assert!(
            (energy / ratio - 1.0).abs() < tolerance,
            "{integrator:?}: {energy} against {ratio}"
        );
    }
}

#[test]
fn a_dropped_ball_rests_at_s_m_g_dt2_over_beta() {
    for (dt, softness, beta) in
        [(0.002, 0.5, 0.2), (0.01, 0.5, 0.2), (0.002, 5.0, 0.2), (0.002, 0.5, 1.0)]
    {
        let settings = Settings { dt, softness, beta, ..lesson(Law::Lesson) };
        let mut sim = sim(&balls(&[0.4]), settings);
        sim.step((2.0 / dt) as u64).unwrap();
        let depth = softness * G * dt * dt / beta;
        let rest = sim.state.qpos[0] + 0.3;
        assert!((rest + depth).abs() < 1e-12, "dt {dt}: {rest} against {}", -depth);
    }
}

#[test]
fn a_stack_by_sweeps() {
    let table = [
        (Law::Relaxed, [392.400, 161.164, 34.380, 5.115, 0.152]),
        (Law::Lesson, [392.400, 237.505, 196.929, 196.201, 196.200]),
    ];
    for (law, depths) in table {
        for (sweeps, depth) in [1, 2, 5, 10, 20].into_iter().zip(depths) {
            let mut sim =
                sim(&balls(&[0.1, 0.3]), Settings { sweeps: sweeps.into(), ..lesson(law) });
            sim.step(1000).unwrap();
            let found = -sim.state.qpos[0] * 1e6;
            assert!((found - depth).abs() < 6e-4, "{law:?} {sweeps}: {found} against {depth}");
        }
    }
}

/// IFToMM A01: a unit pendulum from the horizontal; Jacobi's elliptic functions.
#[test]
fn a_pendulum_by_elliptic_functions() {
    let mut scene = Scene { gravity: [0.0, 0.0, -G], ..Scene::default() };
    let inertial = stepcore::scene::Inertial {
        mass: 1.0,
        pos: [1.0, 0.0, 0.0],
        inertia: [0.0; 6],
        axes: None,
    };
    scene.bodies.push(Body { inertial: Some(inertial), ..Body::default() });
    scene.joints.push(Joint { body: 1, axis: [0.0, -1.0, 0.0], ..Joint::default() });
    for (integrator, dt, tolerance) in [
        (Integrator::Rk4, 1e-3, 1e-10),
        (Integrator::Midpoint, 1e-3, 2e-4),
        (Integrator::SemiImplicit, 1e-4, 2e-2),
    ] {
        let mut sim = sim(&scene, Settings { dt, integrator, ..Settings::default() });
        sim.state.qpos[0] = std::f64::consts::PI;
        sim.step((10.0 / dt).round() as u64).unwrap();
        let (s, c) = sim.state.qpos[0].sin_cos();
        let miss = (c + 0.275_087_462_58).hypot(s + 0.961_419_205_10);
        assert!(miss < tolerance, "{integrator:?}: {miss}");
    }
}

/// A free body far from symmetric: energy and angular momentum under rk4.
#[test]
fn a_free_body_keeps_energy_and_angular_momentum() {
    let mut scene = Scene { gravity: [0.0; 3], ..Scene::default() };
    let inertia =
        [0.808_333_333_333_333_3, 0.683_333_333_333_333_3, 0.141_666_666_666_666_67, 0.0, 0.0, 0.0];
    let inertial =
        stepcore::scene::Inertial { mass: 10.0, pos: [0.1, -0.2, 0.3], inertia, axes: None };
    scene.bodies.push(Body { inertial: Some(inertial), ..Body::default() });
    scene.joints.push(Joint { body: 1, kind: JointType::Free, ..Joint::default() });
    let mut sim =
        sim(&scene, Settings { dt: 1e-3, integrator: Integrator::Rk4, ..Settings::default() });
    sim.state.qvel.copy_from_slice(&[0.0, 0.0, 0.0, 0.1, 5.0, 0.1]);
    let (energy, momentum) = (sim.energy().kinetic, sim.momentum());
    sim.step(10_000).unwrap();
    let (after, turned) = (sim.energy().kinetic, sim.momentum());
    assert!((after / energy - 1.0).abs() < 1e-9, "{energy} {after}");
    assert!((turned.ang - momentum.ang).norm() < 1e-8 * momentum.ang.norm());
    assert!((turned.lin - momentum.lin).norm() < 1e-8 * momentum.ang.norm());
}

/// L = Σ r × m v about the world's origin, also of trees that only slide, whose bodies
/// leave the places at which the tree was weighed.
#[test]
fn momentum_of_a_cross_slide() {
    let mut scene = Scene { gravity: [0.0; 3], ..Scene::default() };
    for (parent, axis) in [(0, [1.0, 0.0, 0.0]), (1, [0.0, 1.0, 0.0])] {
        let body = parent + 1;
        scene.bodies.push(Body { parent, ..Body::default() });
        let joint = Joint { body, kind: JointType::Slide, axis, ..Joint::default() };
        scene.joints.push(joint);
        scene.geoms.push(Geom { contype: 0, conaffinity: 0, ..sphere(body) });
    }
    let mut sim = sim(&scene, Settings::default());
    sim.state.qpos = vec![0.5, 2.0];
    sim.state.qvel = vec![3.0, 0.25];
    let momentum = sim.momentum();
    // Masses of 1 kg at (0.5, 0) and (0.5, 2), with velocities (3, 0) and (3, 0.25).
    assert_eq!(momentum.lin.as_slice(), [6.0, 0.25, 0.0]);
    assert_eq!(momentum.ang.as_slice(), [0.0, 0.0, 0.5 * 0.25 - 2.0 * 3.0]);
}

/// The centrifugal force of 1e200 rad/s is beyond the numbers: no NaN is returned silently.
#[test]
fn forward_refuses_what_is_not_finite() {
    let mut scene = Scene::default();
    for parent in 0..2 {
        let (body, name) = (parent + 1, format!("hinge{parent}"));
        scene.bodies.push(Body { parent, pos: [1.0, 0.0, 0.0], ..Body::default() });
        let joint = Joint { name, body, axis: [0.0, 1.0, 0.3], ..Joint::default() };
        scene.joints.push(joint);
        let pos = [0.2, 0.3, 0.0];
        scene.geoms.push(Geom { pos, contype: 0, conaffinity: 0, ..sphere(body) });
    }
    let mut watched = Watched::around(sim(&scene, Settings::default()));
    watched.forward().unwrap();
    watched.sim.state.qvel = vec![1e200, 1.0];
    let Err(Error::Diverged(divergence)) = watched.forward() else {
        panic!("{:?}", watched.sim.qacc);
    };
    let text = divergence.to_string();
    assert!(text.contains(": the acceleration of joint `hinge"), "{text}");
    let element = divergence.post.unwrap().element.unwrap();
    assert_eq!(element.element.kind, Kind::Inertia);
    assert!(element.name.starts_with("inertial force of joint `hinge"), "{element}");
    assert_eq!(watched.sim.state.qvel, [1e200, 1.0]);
    // Alone a `Sim` says what failed, and not why.
    let Err(Error::Diverged(divergence)) = watched.sim.forward() else { panic!("no error") };
    assert!(divergence.post.is_none());
}
