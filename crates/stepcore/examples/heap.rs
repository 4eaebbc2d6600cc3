//! How long a heap's step takes, for a profiler: spheres or boxes in a box without a lid, capsules
//! on a floor, or a tower of boxes.
//!
//!     cargo run --release -p stepcore --example heap -- 100 newton 200
//!
//! The number of bodies, the solver, the steps that are timed after 500 steps of settling; then
//! `momentum`, the tolerance, `capsules`, `boxes` or `tower`, and the threads that share a step. Times against other engines are `benches/heaps.py`'s.

use std::sync::Arc;
use std::time::Instant;

use stepcore::model::Model;
use stepcore::scene::{Body, Geom, GeomType, Joint, JointType, Scene};
use stepcore::settings::{Acceleration, Settings, Solver};
use stepcore::sim::Sim;

const RADIUS: f64 = 0.05;

fn heap(count: usize, shape: &str) -> Scene {
    let mut scene = Scene::default();
    if shape == "tower" {
        plane(&mut scene, [0.0; 3], [0.0, 0.0, 1.0]);
        for i in 0..count {
            let along = |k: usize| 0.02 * RADIUS * ((k * i % 5) as f64 - 2.0);
            let pos = [along(7), along(3), (2 * i + 1) as f64 * RADIUS];
            body(&mut scene, GeomType::Box, pos, [1.0, 0.0, 0.0, 0.0]);
        }
        return scene;
    }
    let capsules = shape == "capsules";
    let kind = match shape {
        "capsules" => GeomType::Capsule,
        "boxes" => GeomType::Box,
        _ => GeomType::Sphere,
    };
    let side = (1..).find(|side| side * side * side >= count).unwrap_or(1);
    let half = 1.15 * RADIUS * side as f64;
    plane(&mut scene, [0.0; 3], [0.0, 0.0, 1.0]);
    let walls = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)];
    for (x, y) in walls.into_iter().filter(|_| !capsules) {
        plane(&mut scene, [-x * half, -y * half, 0.0], [x, y, 0.0]);
    }
    let mut seed = 1u64;
    let mut jitter = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((seed >> 11) as f64 / (1u64 << 52) as f64 - 1.0) * 0.05 * RADIUS
    };
    for i in 0..count {
        let at = |k: usize| (2 * k + 1) as f64;
        let (x, y, z) = (at(i % side), at(i / side % side), at(i / (side * side)));
        let wide = if capsules { 1.6 } else { 1.0 };
        let pos = [
            wide * x * half / side as f64 - half + jitter(),
            wide * y * half / side as f64 - half + jitter(),
            (z * 1.2 + (wide - 1.0) * 3.0 * z) * RADIUS + jitter(),
        ];
        let quat = match kind {
            GeomType::Capsule => [1.0; 4].map(|_| 20.0 * jitter()),
            GeomType::Box => [1.0, 0.0, 0.0, 0.0],
            _ => [0.5; 4],
        };
        body(&mut scene, kind, pos, quat);
    }
    scene
}

fn body(scene: &mut Scene, kind: GeomType, pos: [f64; 3], quat: [f64; 4]) {
    scene.bodies.push(Body { pos, quat, ..Body::default() });
    let body = scene.bodies.len() - 1;
    scene.joints.push(Joint {
        name: format!("free{body}"),
        body,
        kind: JointType::Free,
        ..Joint::default()
    });
    let size = if kind == GeomType::Box { [RADIUS; 3] } else { [RADIUS, 1.6 * RADIUS, 0.0] };
    scene.geoms.push(Geom {
        name: format!("geom{body}"),
        body,
        kind,
        size,
        mass: Some(1.0),
        ..Geom::default()
    });
}

/// A plane through `pos` whose normal is the unit vector `up`.
fn plane(scene: &mut Scene, pos: [f64; 3], up: [f64; 3]) {
    scene.geoms.push(Geom {
        name: format!("plane{}", scene.geoms.len()),
        kind: GeomType::Plane,
        size: [0.0; 3],
        pos,
        quat: [1.0 + up[2], -up[1], up[0], 0.0],
        ..Geom::default()
    });
}

fn main() {
    let words: Vec<String> = std::env::args().collect();
    let word = |at: usize, other: &str| words.get(at).map_or(other.to_string(), String::clone);
    let count = word(1, "100").parse().expect("a number of spheres");
    let steps: u64 = word(3, "200").parse().expect("a number of steps");
    let settings = Settings {
        dt: 0.002,
        solver: if word(2, "newton") == "pgs" { Solver::Pgs } else { Solver::Newton },
        acceleration: if word(4, "") == "momentum" {
            Acceleration::Momentum
        } else {
            Acceleration::None
        },
        tolerance: word(5, "1e-8").parse().expect("a tolerance"),
        sweeps: 500.into(),
        ..Settings::default()
    };
    let model = Arc::new(Model::compile(&heap(count, &word(6, "spheres"))).expect("a scene"));
    let mut sim = Sim::<f64>::new(model, settings).expect("settings");
    let threads = word(7, "1").parse().expect("a number of threads");
    sim.use_threads(threads).expect("threads");
    sim.step(500).expect("a finite state");
    let (mut sweeps, mut rows, mut least) = (0, 0, f64::INFINITY);
    let start = Instant::now();
    for _ in 0..steps {
        let begin = Instant::now();
        sim.step(1).expect("a finite state");
        least = begin.elapsed().as_secs_f64().min(least);
        sweeps += u64::from(sim.effort.sweeps);
        rows += sim.rows.rows.len();
    }
    let spent = start.elapsed().as_secs_f64() / steps as f64;
    let (sweeps, rows) = (sweeps as f64 / steps as f64, rows as f64 / steps as f64);
    let sum: f64 = sim.state.qpos.iter().sum();
    println!(
        "{:.1} us a step, the quickest {:.1}, {rows:.1} rows, {sweeps:.2} sweeps or iterations, {:.2} ns a row and sweep, \
         sum {sum:.12}",
        spent * 1e6,
        least * 1e6,
        spent * 1e9 / (rows * sweeps)
    );
}
