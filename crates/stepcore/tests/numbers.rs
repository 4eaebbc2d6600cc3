//! Numbers that know more than their value (`Dual`: their derivatives; `Counted`: what was
//! done with them) compute the same values as `f64`, bit for bit, under every integrator,
//! law, solver and cone.

mod scenes;

use std::sync::Arc;

use stepcore::model::Model;
use stepcore::real::{Counted, Dual, Real};
use stepcore::scene::Scene;
use stepcore::settings::{Acceleration, Cone, Integrator, Law, Settings, Solver};
use stepcore::sim::Sim;

use scenes::{put, start};

const LAWS: [Law; 5] = [Law::SolRef, Law::Lesson, Law::Relaxed, Law::Rigid, Law::Penalty];

/// Steps both and compares; `mark` gives a number more than its value.
fn same<R: Real>(scene: &Scene, settings: &Settings, steps: usize, mark: impl Fn(&mut R, usize)) {
    let model = Arc::new(Model::compile(scene).unwrap());
    let mut plain = Sim::<f64>::new(model.clone(), settings.clone()).unwrap();
    let mut other = Sim::<R>::new(model.clone(), settings.clone()).unwrap();
    let given = start(&model, 3);
    put(&mut plain, 0, &given);
    put(&mut other, 0, &given);
    for step in 0..steps {
        for (k, v) in other.state.qvel.iter_mut().enumerate() {
            mark(v, k);
        }
        let refused = plain.step(1).is_err();
        assert_eq!(other.step(1).is_err(), refused, "{settings:?}: step {step}");
        if refused {
            return;
        }
        let numbers = plain.state.qvel.iter().chain(&plain.state.qpos);
        for (own, x) in numbers.zip(other.state.qvel.iter().chain(&other.state.qpos)) {
            assert_eq!(own.to_bits(), x.lane(0).to_bits(), "{settings:?}: step {step}");
        }
    }
}

/// Every kind of step on every scene.
fn check<R: Real>(mark: impl Fn(&mut R, usize)) {
    let scenes = [(scenes::tower(3), 12), (scenes::runner(), 12), (scenes::heap(), 6)];
    for (scene, steps) in &scenes {
        for law in LAWS {
            for integrator in Integrator::ALL.iter().copied() {
                for (cone, tolerance) in [(Cone::Pyramidal, 0.0), (Cone::Elliptic, 1e-6)] {
                    let (solver, sweeps, softness) = (Solver::Pgs, 12.into(), 0.1);
                    let settings = Settings {
                        law,
                        integrator,
                        solver,
                        sweeps,
                        tolerance,
                        cone,
                        softness,
                        penalty_stiffness: 1e4,
                        ..Settings::default()
                    };
                    same(scene, &settings, *steps, &mark);
                }
            }
        }
        for cone in [Cone::Pyramidal, Cone::Elliptic] {
            same(scene, &Settings { cone, ..Settings::default() }, *steps, &mark);
        }
        let (solver, acceleration) = (Solver::Pgs, Acceleration::Momentum);
        let settings = Settings { solver, acceleration, ..Settings::default() };
        same(scene, &settings, *steps, &mark);
    }
}

#[test]
fn derivatives_change_no_value() {
    check::<Dual>(|x, k| x.slopes[k % x.slopes.len()] += 1.0);
}

#[test]
fn counting_changes_no_value() {
    check::<Counted>(|_, _| ());
}
