//! Who watches a `Sim`: what a Rust user may rely on, and what is left after a panic.

mod scenes;

use std::panic::{catch_unwind, AssertUnwindSafe};
use std::sync::Arc;

use stepcore::error::Error;
use stepcore::model::Model;
use stepcore::scene::{GeomType, JointType, Scene};
use stepcore::settings::{Integrator, Settings};
use stepcore::sim::Sim;
use stepcore::watch::Watched;

/// A mass of 1 kg on a spring along x.
fn spring(stiffness: f64) -> Arc<Model> {
    let mut scene = Scene::default();
    let body = scenes::body(&mut scene, 0, [0.0; 3]);
    scenes::geom(&mut scene, body, GeomType::Sphere, [0.1, 0.0, 0.0]).mass = Some(1.0);
    scenes::joint(&mut scene, body, JointType::Slide, [1.0, 0.0, 0.0]).stiffness[0] = stiffness;
    Arc::new(Model::compile(&scene).unwrap())
}

/// F = m a, whichever array the force was written to.
#[test]
fn an_applied_force_acts_however_it_was_set() {
    let settings = Settings { integrator: Integrator::SemiImplicit, ..Settings::default() };
    let mut sim = Sim::<f64>::new(spring(0.0), settings).unwrap();
    sim.inputs.apply(|qfrc, _| qfrc[0] = 3.0);
    sim.forward().unwrap();
    assert_eq!(sim.qacc, [3.0]);
    sim.inputs.apply(|qfrc, xfrc| (qfrc[0], xfrc[6]) = (0.0, 5.0));
    sim.forward().unwrap();
    assert_eq!(sim.qacc, [5.0]);
    sim.inputs.apply(|_, xfrc| xfrc[6] = 0.0);
    assert!(!sim.inputs.applied());
}

/// Explicit Euler multiplies the energy of this spring by 1 + ω²dt² = 1.01 a step; the ledger
/// says so at its second milestone at the latest, with a replay from its first.
#[test]
fn a_ledger_outlives_a_panic() {
    let settings = Settings {
        dt: 0.01,
        integrator: Integrator::Explicit,
        ledger: true,
        ..Settings::default()
    };
    let mut watched = Watched::<f64>::new(spring(100.0), settings).unwrap();
    watched.sim.state.qpos[0] = 0.1;
    // The next step balances the ledger first, and panics there.
    watched.step(64).unwrap();
    let qvel = std::mem::take(&mut watched.sim.state.qvel);
    let outcome = catch_unwind(AssertUnwindSafe(|| watched.step(1)));
    assert!(outcome.is_err(), "a state without velocities must not pass");
    watched.sim.state.qvel = qvel;
    let Err(Error::Diverged(divergence)) = watched.step(1000) else { panic!("no error") };
    let post = divergence.post.unwrap();
    assert!(divergence.step <= 192 && post.steps + post.start.steps == divergence.step);
    assert_eq!(post.element.unwrap().name, "spring of joint `joint0`");
}

/// Whoever watches changes nothing.
#[test]
fn a_watched_world_moves_like_one_that_nobody_watches() {
    for integrator in [Integrator::Euler, Integrator::Midpoint, Integrator::Rk4] {
        for scene in [scenes::runner(), scenes::heap()] {
            let model = Arc::new(Model::compile(&scene).unwrap());
            let settings = Settings { integrator, ledger: true, ..Settings::default() };
            let mut alone = Sim::<f64>::new(model.clone(), settings.clone()).unwrap();
            let mut watched = Watched::around(Sim::<f64>::new(model, settings).unwrap());
            alone.step(100).unwrap();
            watched.step(99).unwrap();
            watched.taped_step(0).unwrap();
            assert_eq!(alone.state, watched.sim.state, "{integrator:?}");
        }
    }
}
