//! A step allocates nothing once every buffer has been as full as it will get.
//!
//! Each scene runs once to fill the buffers, is put back to its start and runs the
//! same steps again: they hold no more contacts than before, so nothing may grow.

#![allow(unsafe_code)]

mod scenes;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Arc;

use stepcore::batch::{Batch, Motion, Record, Sampled};
use stepcore::integrator::Stages;
use stepcore::model::Model;
use stepcore::real::{Lanes, Real};
use stepcore::settings::{Acceleration, Cone, Integrator, Law, Settings, Solver};
use stepcore::watch::Watched;

struct Counting;

thread_local! {
    /// Allocations of this thread; each test runs on one of its own.
    static COUNT: Cell<u64> = const { Cell::new(0) };
    /// Bytes that it holds.
    static HELD: Cell<i64> = const { Cell::new(0) };
}

fn note(count: u64, bytes: i64) {
    // A thread that is being torn down has no counter left, and nothing to count.
    let _ = COUNT.try_with(|total| total.set(total.get() + count));
    let _ = HELD.try_with(|total| total.set(total.get() + bytes));
}

// SAFETY: every call goes to the system's allocator unchanged; the counter holds no memory.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        note(1, layout.size() as i64);
        // SAFETY: the caller's.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        note(0, -(layout.size() as i64));
        // SAFETY: the caller's.
        unsafe { System.dealloc(at, layout) };
    }
    unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        note(1, size as i64 - layout.size() as i64);
        // SAFETY: the caller's.
        unsafe { System.realloc(at, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

const STEPS: u64 = 60;

/// Allocations of the second of two equal runs, and the rows at its end.
fn allocations<R: Real>(model: Model, settings: &Settings) -> (u64, usize) {
    let model = Arc::new(model);
    let mut watched = Watched::<R>::new(model, settings.clone()).unwrap();
    for ctrl in &mut watched.sim.inputs.ctrl {
        *ctrl = R::of(0.3);
    }
    let start = watched.sim.state.clone();
    watched.step(STEPS).unwrap();
    // Field by field: the snapshot must not replace the buffers that have grown.
    let state = &mut watched.sim.state;
    state.steps = start.steps;
    state.qpos.copy_from_slice(&start.qpos);
    state.qvel.copy_from_slice(&start.qvel);
    state.warm.clear();
    let before = COUNT.with(Cell::get);
    watched.step(STEPS).unwrap();
    (COUNT.with(Cell::get) - before, watched.sim.rows.rows.len())
}

fn check<R: Real>(settings: &Settings) {
    // Ten trees in an island are a heap to Newton's method.
    for (name, scene) in [
        ("tower", scenes::tower(4)),
        ("high tower", scenes::tower(10)),
        ("runner", scenes::runner()),
        ("heap", scenes::heap()),
    ] {
        // With its pairs in a list; and found as they come near, one world at a time.
        for most in if R::LANES > 1 { &[usize::MAX][..] } else { &[usize::MAX, 0] } {
            let model = Model::compile_with(&scene, *most).unwrap();
            let (count, rows) = allocations::<R>(model, settings);
            let (law, integrator) = (settings.law.name(), settings.integrator.name());
            assert!(settings.law == Law::Penalty || rows > 0, "{name} {law}: nothing touches");
            assert_eq!(count, 0, "{name} {law} {integrator} {most}: allocations in {STEPS} steps");
        }
    }
}

fn settings(law: Law, integrator: Integrator) -> Settings {
    let solver = Solver::Pgs;
    Settings {
        law,
        integrator,
        solver,
        sweeps: 20.into(),
        penalty_stiffness: 1e4,
        ..Settings::default()
    }
}

#[test]
fn the_counter_counts() {
    let before = COUNT.with(Cell::get);
    let list = std::hint::black_box(vec![1.0; 100]);
    assert!(COUNT.with(Cell::get) > before && list.len() == 100);
}

#[test]
fn no_integrator_allocates() {
    for integrator in Integrator::ALL {
        // Midpoint may refuse a step of soft contacts.
        let middle = integrator.scheme().stages == Stages::Middle;
        check::<f64>(&settings(if middle { Law::Rigid } else { Law::SolRef }, *integrator));
    }
}

#[test]
fn neither_noslip_nor_stiction_allocates() {
    let euler = settings(Law::SolRef, Integrator::Euler);
    check::<f64>(&Settings { noslip_iterations: 5, ..euler.clone() });
    check::<f64>(&Settings { stiction: true, ..euler });
}

#[test]
fn no_law_allocates() {
    for law in [Law::Lesson, Law::Relaxed, Law::Rigid, Law::Penalty] {
        for integrator in [Integrator::SemiImplicit, Integrator::Rk4] {
            check::<f64>(&settings(law, integrator));
        }
    }
}

#[test]
fn no_solver_or_cone_allocates() {
    let euler = settings(Law::SolRef, Integrator::Euler);
    check::<f64>(&Settings { cone: Cone::Elliptic, ..euler.clone() });
    check::<f64>(&Settings { acceleration: Acceleration::Momentum, ..euler.clone() });
    check::<f64>(&Settings { solver: Solver::Newton, ..euler.clone() });
    check::<f64>(&Settings { solver: Solver::Newton, cone: Cone::Elliptic, ..euler });
}

#[test]
fn no_number_allocates() {
    let settings = settings(Law::SolRef, Integrator::Euler);
    check::<f32>(&settings);
    check::<Lanes>(&settings);
}

/// What a motion allocates does not depend on how long it is, nor on how often it is sampled.
#[test]
fn a_motion_allocates_once() {
    let model = Arc::new(Model::compile(&scenes::runner()).unwrap());
    let settings = settings(Law::SolRef, Integrator::Euler);
    let mut batch = Batch::<Lanes>::new(model.clone(), &settings, 8, 1).unwrap();
    let counts = [4 * STEPS, STEPS, 2 * STEPS].map(|steps| {
        let samples = steps as usize + 1;
        let size = |what: &Sampled| what.shape(&model).iter().product::<usize>();
        let mut lists = Sampled::ALL.map(|what| vec![0.0; 8 * samples * size(&what)]);
        let both = Sampled::ALL.into_iter().zip(&mut lists);
        let mut motion = Motion {
            every: 1,
            samples,
            first: true,
            ctrl: &[],
            rows: 0,
            hold: 1,
            bound: 1e3,
            most: u64::MAX,
            home: vec![0.0; 8 * size(&Sampled::Position)],
            records: both.map(|(what, numbers)| Record { what, numbers }).collect(),
            evaluations: vec![0; 8],
        };
        let before = COUNT.with(Cell::get);
        batch.follow(&mut motion, 0, steps as usize).unwrap();
        COUNT.with(Cell::get) - before
    });
    // The first makes room. A contact that begins later may make some for itself; steps and samples do not.
    assert!(counts[2] < counts[1] + STEPS / 10, "{counts:?}");
}

/// `Batch::bytes` is too, but for what threads need among themselves.
#[test]
fn a_batch_knows_its_memory() {
    let settings = settings(Law::SolRef, Integrator::Euler);
    for scene in [scenes::tower(2), scenes::runner()] {
        let model = Arc::new(Model::compile(&scene).unwrap());
        let before = HELD.with(Cell::get);
        let batch = Box::new(Batch::<Lanes>::new(model.clone(), &settings, 800, 1).unwrap());
        let held = (HELD.with(Cell::get) - before) as f64;
        let told = batch.bytes() as f64;
        assert!((0.98..=1.0).contains(&(told / held)), "{told} of {held}");
    }
}

/// `Watched::bytes` is what the allocator has given out, whatever ran before.
#[test]
fn a_sim_knows_its_memory() {
    let euler = settings(Law::SolRef, Integrator::Euler);
    for settings in [
        settings(Law::Rigid, Integrator::Rk4),
        Settings { ledger: true, ..euler.clone() },
        Settings { acceleration: Acceleration::Momentum, ..euler.clone() },
        Settings { solver: Solver::Newton, ..euler.clone() },
        Settings { solver: Solver::Newton, cone: Cone::Elliptic, ..euler },
    ] {
        for scene in [scenes::tower(4), scenes::tower(10), scenes::runner(), scenes::heap()] {
            let model = Arc::new(Model::compile(&scene).unwrap());
            let own = model.clone();
            let before = HELD.with(Cell::get);
            let mut watched = Box::new(Watched::<f64>::new(own, settings.clone()).unwrap());
            watched.step(STEPS).unwrap();
            assert_eq!((HELD.with(Cell::get) - before) as usize, watched.bytes());
        }
    }
}

#[test]
fn no_ledger_allocates() {
    let on = Settings { ledger: true, ..settings(Law::SolRef, Integrator::Euler) };
    check::<f64>(&on);
    check::<Lanes>(&Settings { integrator: Integrator::Rk4, ..on.clone() });
    check::<f64>(&Settings { law: Law::Penalty, ..on });
}
