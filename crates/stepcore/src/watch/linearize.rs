//! The step as a linear map: how the state after it moves with the state before it.
//!
//! One step of a `Sim<Dual>`, from the same state and inputs, as often as there are
//! directions, a few at a time. Tangent coordinates x = (dq, dv, dw) have nv, nv and na entries: dq
//! moves positions as a velocity of that size moves them in a unit of time (`advance`), so
//! that a turn is a rotation vector in the body's own axes; dw are activations. The impulses that the solver
//! starts from are held.

use std::ops::Range;
use std::sync::Arc;

use super::watched::explained;
use super::zeros;
use crate::arrays::{Array, Plain};
use crate::elements::{Element, Kind};
use crate::error::{Error, Result};
use crate::model::{differ_in_numbers, Model, SideBySide};
use crate::real::{Dual, Real, AROUND, WAYS};
use crate::scene::JointType;
use crate::sim::Sim;
use crate::solve::Differentiated;
use crate::state::State;

/// The models around that of a parameter's own value; see `AROUND`.
pub type Around = [Arc<Model>; AROUND];

/// A linearisation under way: ∂x⁺/∂x, ∂x⁺/∂ctrl and ∂x⁺/∂parameter at one state.
pub struct Linearizer {
    sim: Sim<Dual>,
    start: State<Dual>,
    ctrl: Vec<Dual>,
    parameters: Vec<Around>,
    /// Columns before those of parameters.
    own: usize,
    done: usize,
    /// 2 nv + na rows of 2 nv + na + nu numbers and one a parameter: A, B and P beside each other, P by the
    /// distance of the models around.
    pub matrix: Vec<f64>,
}

/// Derivatives start and end here; every one is found by its place.
#[derive(Clone, Copy)]
pub(super) enum Direction {
    Position(usize),
    Velocity(usize),
    Activation(usize),
    Control(usize),
}

impl Linearizer {
    /// At the present state and inputs of a world, with its settings, computed in `f64`; by these
    /// parameters too. Refuses one around which models differ in more than numbers.
    pub fn new<R: Real>(from: &Sim<R>, parameters: Vec<Around>) -> Result<Self> {
        from.settings.check_fixed("linearize")?;
        let alike = |around: &Around| around.iter().all(|m| differ_in_numbers(from.model(), m));
        if let Some(nth) = parameters.iter().position(|around| !alike(around)) {
            let limit = "one that steps read as a number, neither zero nor infinite";
            return Err(Error::value("parameter", nth, limit));
        }
        Self::of(&from.plain(), parameters)
    }

    fn of(from: &Plain, parameters: Vec<Around>) -> Result<Self> {
        let sim = differentiated(from)?;
        let model = sim.model();
        let rows = 2 * model.nv + model.na;
        let own = rows + model.actuators.len();
        Ok(Self {
            start: sim.state.clone(),
            ctrl: sim.inputs.ctrl.clone(),
            sim,
            own,
            done: 0,
            matrix: zeros("linearize", rows, own + parameters.len())?,
            parameters,
        })
    }

    fn width(&self) -> usize {
        self.own + self.parameters.len()
    }

    /// Steps that it takes in all.
    pub fn steps(&self) -> u64 {
        (self.own.div_ceil(WAYS) + self.parameters.len().div_ceil(WAYS)) as u64
    }

    /// Elements at which the derivatives are those of one side: a row of theirs is exactly where it
    /// becomes active.
    pub fn degenerate(&self) -> &[Element] {
        self.sim.solver.degenerate()
    }

    /// Takes the next `n` of them.
    #[inline] // A failure is explained in plain numbers, whose step is compiled where this is called.
    pub fn advance(&mut self, n: u64) -> Result<()> {
        for _ in 0..n {
            self.step().map_err(|error| explained(&self.sim, error))?;
            self.read_all()?;
        }
        Ok(())
    }

    /// The directions of the next step; those of parameters begin with one.
    fn ways(&self) -> Range<usize> {
        let end = if self.done < self.own { self.own } else { self.width() };
        self.done..(self.done + WAYS).min(end)
    }

    fn step(&mut self) -> Result<()> {
        self.sim.state.clone_from(&self.start);
        self.sim.inputs.ctrl.copy_from_slice(&self.ctrl);
        if self.done < self.own {
            for way in self.ways() {
                Direction::nth(self.sim.model(), way).seed(&mut self.sim, way - self.done);
            }
        } else {
            self.sim.take_models(&self.around()?);
        }
        self.sim.step(1)
    }

    /// The model, and those around the parameters of the next step.
    fn around(&self) -> Result<SideBySide<Dual>> {
        let own = self.sim.model().clone();
        let mut models = vec![own; 1 + AROUND * WAYS];
        for (slot, way) in self.ways().enumerate() {
            let place = 1 + AROUND * slot;
            models[place..place + AROUND].clone_from_slice(&self.parameters[way - self.own]);
        }
        SideBySide::new(models)
    }

    fn read_all(&mut self) -> Result<()> {
        let ways = self.ways();
        for way in ways.clone() {
            self.read(way, way - self.done)?;
        }
        self.done = ways.end;
        Ok(())
    }

    /// One column, from the state after the step.
    fn read(&mut self, column: usize, slot: usize) -> Result<()> {
        let (nv, width) = (self.sim.model.nv, self.width());
        let state = &self.sim.state;
        for dof in 0..nv {
            let (place, axis) = coordinate(self.sim.model(), dof);
            let dq = match axis {
                None => state.qpos[place].slopes[slot],
                // 2 q̄ · dq / |q|².
                Some(axis) => {
                    let q: [f64; 4] = core::array::from_fn(|k| state.qpos[place + k].value);
                    let d: [f64; 4] = core::array::from_fn(|k| state.qpos[place + k].slopes[slot]);
                    let [i, j] = [(axis + 1) % 3 + 1, (axis + 2) % 3 + 1];
                    let k = axis + 1;
                    let turn = q[0] * d[k] - q[k] * d[0] - q[i] * d[j] + q[j] * d[i];
                    2.0 * turn / q.iter().map(|x| x * x).sum::<f64>()
                }
            };
            let dv = state.qvel[dof].slopes[slot];
            if !(dq.is_finite() && dv.is_finite()) {
                return Err(self.steep(dof));
            }
            self.matrix[dof * width + column] = dq;
            self.matrix[(nv + dof) * width + column] = dv;
        }
        for (entry, act) in state.act.iter().enumerate() {
            if !act.slopes[slot].is_finite() {
                let model = self.sim.model();
                let owner = model.element_name(Array::Act.owner(model, entry));
                return Err(self.infinite(format!("derivative of act[{entry}] of {owner}")));
            }
            self.matrix[(2 * nv + entry) * width + column] = act.slopes[slot];
        }
        Ok(())
    }

    fn steep(&self, dof: usize) -> Error {
        let joint = self.sim.model().dofs[dof].joint;
        let joint = self.sim.model().element_name(Element::whole(Kind::Joint, joint));
        self.infinite(format!("derivative of dof {dof} of {joint}"))
    }

    fn infinite(&self, field: String) -> Error {
        let limit = "finite: the step is not differentiable at this state";
        Error::value(field, "infinite", limit)
    }
}

/// The same world in numbers that carry derivatives, its rows solved and differentiated.
pub(super) fn differentiated(from: &Plain) -> Result<Sim<Dual>> {
    // Asleep nothing answers: what is differentiated is the world awake.
    let mut sim = from.awake::<Dual>()?;
    sim.solver = Box::new(Differentiated::new());
    Ok(sim)
}

impl Direction {
    /// They are numbered as the columns of A and B: positions, velocities, activations, controls.
    pub(super) fn nth(model: &Model, way: usize) -> Self {
        let (nv, na) = (model.nv, model.na);
        if way < nv {
            Self::Position(way)
        } else if way < 2 * nv {
            Self::Velocity(way - nv)
        } else if way < 2 * nv + na {
            Self::Activation(way - 2 * nv)
        } else {
            Self::Control(way - 2 * nv - na)
        }
    }

    /// Lets the derivatives in a slot be those in this direction.
    pub(super) fn seed(self, sim: &mut Sim<Dual>, slot: usize) {
        match self {
            Self::Velocity(dof) => sim.state.qvel[dof].slopes[slot] = 1.0,
            Self::Activation(entry) => sim.state.act[entry].slopes[slot] = 1.0,
            Self::Control(index) => sim.inputs.ctrl[index].slopes[slot] = 1.0,
            Self::Position(dof) => {
                let (place, axis) = coordinate(sim.model(), dof);
                let qpos = &mut sim.state.qpos[place..];
                let Some(axis) = axis else {
                    qpos[0].slopes[slot] = 1.0;
                    return;
                };
                // q · (0, e/2).
                let [w, x, y, z] = core::array::from_fn(|k| 0.5 * qpos[k].value);
                let slopes = [[-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]][axis];
                for (entry, slope) in qpos.iter_mut().zip(slopes) {
                    entry.slopes[slot] = slope;
                }
            }
        }
    }
}

/// Where a dof's position is in qpos, or its quaternion and the axis of that.
fn coordinate(model: &Model, dof: usize) -> (usize, Option<usize>) {
    let joint = &model.joints[model.dofs[dof].joint];
    let within = dof - joint.dof;
    match joint.kind {
        JointType::Slide | JointType::Hinge => (joint.qpos, None),
        JointType::Ball => (joint.qpos, Some(within)),
        JointType::Free if within < 3 => (joint.qpos + within, None),
        JointType::Free => (joint.qpos + 3, Some(within - 3)),
    }
}
