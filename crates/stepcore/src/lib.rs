//! stepcore: a rigid-body physics engine that measures what speed costs in accuracy.
//!
//! # The tour
//!
//! A [`scene::Scene`] is the model's description: bodies, joints, shapes, friction, softness.
//! Compiling it gives a [`model::Model`], constant during a step. [`settings::Settings`] choose the
//! computation. A [`sim::Sim`] holds one state and steps it, and a step is one loop (`step.rs`):
//!
//! 1. **place** (`place/`): joint positions to poses; the mass matrix and its
//!    factors LᵀDL; the smooth forces; and the *guess*, the velocity that the
//!    bodies would have if nothing were in the way.
//! 2. **detect** (`detect/`): every pair of shapes that touch or are about to; `shapes/` computes
//!    where two shapes touch.
//! 3. **solve** (`solve/`): each contact, friction direction, limit, friction loss and
//!    equality is a row: a direction J, a target t, a regulariser c and a set for its
//!    impulse. One system, solved by projected Gauss-Seidel or by Newton, both independent
//!    of a row's origin.
//! 4. **commit** (`commit/`): one file per integrator turns the solved velocity into
//!    the next state. A state that is not finite is never committed.
//!
//! Everything that pushes, stores, dissipates or constrains is in `elements/`, one file each: a
//! spring, an actuator, a limit, a contact. Stages, implicit integrators and observers iterate over
//! its two lists, and repeat none of its formulas; `model/transmission.rs` maps dofs to lengths.
//!
//! Outside the loop: `model/` compiles a scene, `watch/` reads energy, momentum and residuals and
//! names the cause of a failed run, `batch/` steps many worlds over threads, `arrays.rs` copies a
//! user's numbers in and out.
//!
//! Everything is generic over [`real::Real`]: `f64`, `f32`, or [`real::Lanes`], eight (`f32`:
//! sixteen) parallel worlds that equal, bit for bit, the same worlds stepped alone. Two more
//! accompany a world: [`real::Dual`] carries derivatives through the step ([`watch::Linearizer`]),
//! [`real::Counted`] counts its operations ([`watch::Counter`]).
//!
//! ```
//! use std::sync::Arc;
//! use stepcore::{model::Model, scene::*, settings::Settings, sim::Sim};
//!
//! let mut scene = Scene::default();
//! scene.bodies.push(Body { name: "ball".into(), pos: [0.0, 0.0, 0.3], ..Body::default() });
//! scene.joints.push(Joint { body: 1, kind: JointType::Slide, ..Joint::default() });
//! let sphere = Geom { body: 1, size: [0.1, 0.0, 0.0], mass: Some(1.0), ..Geom::default() };
//! scene.geoms.push(sphere);
//! let model = Arc::new(Model::compile(&scene).unwrap());
//! let mut sim = Sim::<f64>::new(model, Settings::default()).unwrap();
//! sim.step(100).unwrap();
//! assert!((sim.state.qvel[0] + 9.81 * 0.2).abs() < 1e-12);
//! ```

#[macro_use]
mod room;
pub mod arrays;
pub mod assets;
pub mod batch;
mod bits;
mod clock;
pub mod commit;
pub mod detect;
pub mod elements;
pub mod error;
pub mod integrator;
pub mod interrupt;
pub mod model;
mod named;
pub mod observer;
pub mod place;
pub mod plan;
#[allow(unsafe_code)]
mod pool;
pub mod post_mortem;
pub mod real;
pub mod scene;
pub mod sensors;
pub mod settings;
pub mod shapes;
pub mod sim;
pub mod sleep;
pub mod solve;
pub mod spatial;
pub mod state;
mod step;
pub mod warm;
pub mod watch;
