//! How many machine instructions a step of each scene takes, counted by callgrind: no scene gets
//! slower for what another needs. Counts are those of `--release` on x86-64; a scene that has
//! become quicker gets a new line in `instructions.txt`:
//!
//!     cargo test --release -p stepcore --test instructions -- --nocapture

mod scenes;

use std::env::{current_exe, var};
use std::process::Command;
use std::sync::Arc;

use scenes::{body, floor, geom, heap, joint, put, runner, spring, start, tower};
use stepcore::model::Model;
use stepcore::scene::{GeomType, JointType, Scene};
use stepcore::settings::{Acceleration, Settings, Solver};
use stepcore::sim::Sim;

/// Name, and instructions a step.
const COUNTS: &str = include_str!("instructions.txt");
/// Where someone builds with another level of optimisation.
const LEVEL: Option<&str> = option_env!("CARGO_PROFILE_RELEASE_OPT_LEVEL");
/// Other flags, compilers and units of code generation make other code of the same formulas: of two
/// builds (64 units with AVX2, and 16 without) one took 8 % more for the chain.
const TOLERANCE: f64 = 0.1;
/// Before what is counted: contacts and working space have come.
const SETTLE: u64 = 100;

/// Free bodies in a row over the floor, so high.
fn free(kind: GeomType, count: usize, height: f64) -> Scene {
    let mut scene = floor();
    for i in 0..count {
        let part = body(&mut scene, 0, [0.5 * i as f64, 0.0, height]);
        joint(&mut scene, part, JointType::Free, [0.0, 0.0, 1.0]);
        geom(&mut scene, part, kind, [0.1, 0.1, 0.1]);
    }
    scene
}

/// Balls on vertical slides, the lowest so high over the floor.
fn sliding(count: usize, lift: f64) -> Scene {
    let mut scene = tower(count);
    scene.bodies.iter_mut().skip(1).for_each(|body| body.pos[2] += lift);
    scene
}

fn chain(links: usize) -> Scene {
    let mut scene = Scene::default();
    for link in 0..links {
        let part = body(&mut scene, link, [if link > 0 { 0.1 } else { 0.0 }, 0.0, 0.0]);
        let axis = if link % 2 == 0 { [0.0, 1.0, 0.0] } else { [1.0, 0.0, 0.0] };
        joint(&mut scene, part, JointType::Hinge, axis).damping[0] = 0.1;
        let limb = scenes::limb(&mut scene, part, [0.0; 3], [0.1, 0.0, 0.0], 0.02);
        (limb.contype, limb.conaffinity) = (0, 0);
    }
    scene
}

/// A scene, its settings, and over how many steps it is counted.
fn case(name: &str) -> (Scene, Settings, u64) {
    let newton = Settings::default();
    let swept = Settings {
        solver: Solver::Pgs,
        acceleration: Acceleration::None,
        sweeps: 20.into(),
        tolerance: 0.0,
        ..Settings::default()
    };
    match name {
        "spring" => (spring(), newton, 1000),
        "ball in the air" => (sliding(1, 1e3), newton, 1000),
        "ball on the floor" => (sliding(1, 0.0), newton, 1000),
        "stack of two balls" => (sliding(2, 0.0), newton, 1000),
        "stack of two balls, swept" => (sliding(2, 0.0), swept, 1000),
        "free ball in the air" => (free(GeomType::Sphere, 1, 1e3), newton, 1000),
        "ten free boxes in the air" => (free(GeomType::Box, 10, 1e3), newton, 200),
        "free box on the floor" => (free(GeomType::Box, 1, 0.1), newton, 200),
        "chain of eight hinges" => (chain(8), newton, 200),
        "planar runner" => (runner(), newton, 200),
        "every pair and row" => (heap(), newton, 50),
        _ => panic!("no scene {name}"),
    }
}

#[test]
#[ignore = "what callgrind runs"]
fn play() {
    let [name, times] = ["STEPCORE_SCENE", "STEPCORE_TIMES"].map(|key| var(key).unwrap());
    let (scene, settings, steps) = case(&name);
    let model = Arc::new(Model::compile(&scene).unwrap());
    let mut sim = Sim::<f64>::new(model.clone(), settings).unwrap();
    if matches!(name.as_str(), "planar runner" | "every pair and row" | "chain of eight hinges") {
        put(&mut sim, 0, &start(&model, 1));
    }
    sim.step(SETTLE).unwrap();
    sim.step(times.parse::<u64>().unwrap() * steps).unwrap();
}

/// None without valgrind.
fn instructions(name: &str, times: u64) -> Option<f64> {
    let run = Command::new("valgrind")
        .args(["--tool=callgrind", "--callgrind-out-file=/dev/null"])
        .arg(current_exe().unwrap())
        .args(["play", "--exact", "--ignored"])
        .envs([("STEPCORE_SCENE", name), ("STEPCORE_TIMES", &times.to_string())])
        .output()
        .ok()?;
    let text = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success(), "{name}: {text}");
    let collected = text.lines().find_map(|line| line.split_once("Collected : "));
    Some(collected.unwrap().1.trim().parse().unwrap())
}

#[test]
fn no_scene_takes_more_instructions_than_it_did() {
    let other_level = LEVEL.is_some_and(|level| level != "3");
    if cfg!(debug_assertions) || cfg!(not(target_arch = "x86_64")) || other_level {
        return eprintln!("not counted: the counts are those of optimised code on x86-64");
    }
    let mut worse = vec![];
    for line in COUNTS.lines() {
        let (name, expected) = line.rsplit_once(' ').unwrap();
        let (name, expected) = (name.trim(), expected.parse::<f64>().unwrap());
        let (Some(once), Some(twice)) = (instructions(name, 1), instructions(name, 2)) else {
            return eprintln!("not counted: valgrind is absent");
        };
        let count = (twice - once) / case(name).2 as f64;
        println!("{name:28} {count:.0}");
        if count > expected * (1.0 + TOLERANCE) {
            worse.push(format!("{name}: {count:.0}, expected {expected}"));
        }
    }
    assert!(worse.is_empty(), "{worse:#?}");
}
