//! A step that is interrupted, wherever that is, leaves the state of the last whole step, from which
//! the run goes on with the bits of one that never was interrupted.

mod scenes;

use std::cell::Cell;
use std::sync::Arc;

use stepcore::error::{Error, Result};
use stepcore::interrupt::while_asking;
use stepcore::model::Model;
use stepcore::scene::{GeomType, JointType, Scene};
use stepcore::settings::{Acceleration, Accuracy, Settings, Solver};
use stepcore::watch::Watched;

thread_local! {
    static LEFT: Cell<u32> = const { Cell::new(0) };
}

/// Interrupts `work` at the nth place where it asks.
fn interrupt_at<T>(nth: u32, work: impl FnOnce() -> Result<T>) -> Result<T> {
    LEFT.set(nth);
    let ends = || {
        LEFT.set(LEFT.get().saturating_sub(1));
        LEFT.get() == 0
    };
    while_asking(ends, work)
}

fn arrays(watched: &Watched<f64>) -> (u64, Vec<f64>, Vec<f64>) {
    let state = &watched.sim.state;
    (state.steps, state.qpos.clone(), state.qvel.clone())
}

/// Interrupts a step wherever it asks, `least` times or more.
fn check(scene: &Scene, most_fixed: usize, settings: &Settings, least: u32) {
    let model = Arc::new(Model::compile_with(scene, most_fixed).unwrap());
    let begun = || {
        let mut watched = Watched::<f64>::new(model.clone(), settings.clone()).unwrap();
        watched.step(20).unwrap();
        watched
    };
    let mut whole = begun();
    let before = arrays(&whole);
    whole.step(5).unwrap();
    for nth in 1.. {
        let mut watched = begun();
        match interrupt_at(nth, || watched.step(1)) {
            Ok(()) => return assert!(nth > least, "it asks {} times", nth - 1),
            Err(error) => assert_eq!(error, Error::Interrupted),
        }
        assert_eq!(arrays(&watched), before);
        watched.step(5).unwrap();
        assert_eq!(arrays(&watched), arrays(&whole), "interrupted at {nth}");
    }
}

fn swept() -> Settings {
    Settings {
        solver: Solver::Pgs,
        acceleration: Acceleration::None,
        sweeps: 2000.into(),
        tolerance: 0.0,
        ..Settings::default()
    }
}

#[test]
fn sweeps() {
    for most_fixed in [0, usize::MAX] {
        check(&scenes::heap(), most_fixed, &swept(), 2);
        let noslip = Settings { sweeps: 2.into(), noslip_iterations: 2000, ..swept() };
        check(&scenes::heap(), most_fixed, &noslip, 2);
    }
}

#[test]
fn parts_within_an_accuracy() {
    let settings = Settings { accuracy: Accuracy(Some(1e-7)), ..Settings::default() };
    check(&scenes::heap(), usize::MAX, &settings, 2);
}

#[test]
fn near_pairs_and_columns() {
    check(&scenes::tower(400), 0, &Settings::default(), 3);
}

#[test]
fn compiling() {
    let mut scene = Scene::default();
    for link in 0..200 {
        let part = scenes::body(&mut scene, link, [0.1, 0.0, 0.0]);
        scenes::joint(&mut scene, part, JointType::Hinge, [0.0, 1.0, 0.0]);
        scenes::geom(&mut scene, part, GeomType::Sphere, [0.02, 0.0, 0.0]);
    }
    assert_eq!(interrupt_at(1, || Model::compile(&scene)).err(), Some(Error::Interrupted));
    assert!(Model::compile(&scene).is_ok());
}
