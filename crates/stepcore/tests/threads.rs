//! Threads that share the steps of one world change no bit.

mod scenes;

use std::sync::Arc;
use stepcore::model::Model;
use stepcore::scene::{GeomType, JointType, Scene};
use stepcore::settings::{Cone, Integrator, Law, Settings, Solver};
use stepcore::sim::Sim;

/// Columns of bodies side by side, islands of their own at first; more pairs than are listed.
fn columns() -> Scene {
    let mut scene = scenes::floor();
    for i in 0..648 {
        let (x, y, z) = (i % 9, i / 9 % 9, i / 81);
        let off = 0.004 * ((3 * i) % 5) as f64;
        let pos = [0.25 * x as f64 + off, 0.25 * y as f64 - off, 0.1 + 0.2 * z as f64];
        let part = scenes::body(&mut scene, 0, pos);
        scenes::joint(&mut scene, part, JointType::Free, [0.0, 0.0, 1.0]);
        if i % 10 == 9 {
            scenes::geom(&mut scene, part, GeomType::Sphere, [0.1, 0.0, 0.0]);
        } else {
            scenes::geom(&mut scene, part, GeomType::Box, [0.1, 0.1, 0.1]);
        }
    }
    scene
}

/// Bits of all that a run leaves, and the most rows of a step.
fn run(model: &Arc<Model>, settings: &Settings, threads: usize) -> (Vec<u64>, usize, usize) {
    let mut sim = Sim::<f64>::new(model.clone(), settings.clone()).unwrap();
    sim.use_threads(threads).unwrap();
    // The columns fall over each other.
    for k in (0..sim.state.qvel.len()).step_by(6) {
        sim.state.qvel[k] = 0.3 * ((k % 11) as f64 - 5.0);
    }
    let mut bits = vec![];
    for _ in 0..40 {
        sim.step(1).unwrap();
        bits.extend(sim.rows.rows.iter().map(|row| row.impulse.to_bits()));
        bits.extend(sim.detected.contacts.iter().map(|contact| contact.dist.to_bits()));
        bits.push(u64::from(sim.effort.sweeps) + sim.effort.row_updates);
        bits.push(sim.effort.decrement.to_bits());
    }
    bits.extend(sim.state.qpos.iter().chain(&sim.state.qvel).map(|x| x.to_bits()));
    (bits, sim.effort.most_rows, sim.detected.contacts.len())
}

fn same_bits(settings: Settings) {
    let model = Arc::new(Model::compile(&columns()).unwrap());
    assert!(model.dynamic_pairs.is_some());
    let (alone, rows, contacts) = run(&model, &settings, 1);
    assert!(rows >= 4096 && contacts >= 1024, "{rows} rows, {contacts} contacts: nothing to share");
    for threads in [2, 3, 5] {
        assert!(run(&model, &settings, threads).0 == alone, "{threads} threads, {settings:?}");
    }
}

#[test]
fn newton_has_the_same_bits_with_any_number_of_threads() {
    same_bits(Settings::default());
    let cone = Settings { cone: Cone::Elliptic, stiction: true, ..Settings::default() };
    same_bits(cone);
}

#[test]
fn sweeps_have_the_same_bits_with_any_number_of_threads() {
    let pgs = Settings { solver: Solver::Pgs, sweeps: 30.into(), ..Settings::default() };
    same_bits(pgs.clone());
    // Under laws on the guess contacts are judged one after another; detection is shared.
    same_bits(Settings { law: Law::Rigid, integrator: Integrator::SemiImplicit, ..pgs });
}
