//! The step as a linear map: the change of the state after it with the state before it.
//!
//! A `Sim<Dual>` repeats one step from the same state and inputs until all directions are done, a
//! few at a time. Tangent coordinates x = (dq, dv, dw, dc) have nv, nv, na and nhistory entries: dq
//! moves positions as a velocity of that size moves them in a unit of time (`advance`), so that a
//! rotation is a rotation vector in the body's axes; dw are activations, dc past controls. The
//! solver's initial impulses are held constant.

use std::collections::BTreeSet;
use std::ops::Range;
use std::sync::Arc;

use super::watched::{explained, Explain};
use super::zeros;
use crate::arrays::{Array, Given, Givens, Plain};
use crate::elements::{Element, Kind};
use crate::error::{Error, Result};
use crate::model::{differ_in_numbers, Model, SideBySide};
use crate::real::{Dual, Real, AROUND, WAYS};
use crate::room::Room;
use crate::scene::JointType;
use crate::sim::Sim;
use crate::solve::Differentiated;
use crate::state::State;

/// The models around a parameter's value; see `AROUND`.
pub type Around = [Arc<Model>; AROUND];

/// A model, and the models around the value of each parameter of the derivatives.
pub struct Neighbourhood {
    pub model: Arc<Model>,
    pub parameters: Vec<Around>,
}

impl Neighbourhood {
    /// Whether these are the same models.
    fn is(&self, other: &Self) -> bool {
        let all = |of: &Self| of.parameters.iter().flatten().cloned().collect::<Vec<_>>();
        let (own, others) = (all(self), all(other));
        Arc::ptr_eq(&self.model, &other.model)
            && own.len() == others.len()
            && own.iter().zip(&others).all(|(a, b)| Arc::ptr_eq(a, b))
    }

    /// The first way of the parameters, behind `own` other ways. Parameters share a step with the
    /// last of those if that saves a step; else they have separate steps, because models of many
    /// numbers take longer.
    fn first(&self, own: usize) -> usize {
        let apart = own.next_multiple_of(WAYS);
        let count = self.parameters.len();
        if (own + count).div_ceil(WAYS) < (apart + count).div_ceil(WAYS) {
            own
        } else {
            apart
        }
    }

    /// The model; then, for each step with ways of parameters from `first` on, the model with the
    /// models around them. Refuses a parameter around which models differ in more than numbers.
    fn side_by_side(&self, first: usize) -> Result<Vec<SideBySide<Dual>>> {
        let mut all = vec![SideBySide::new(vec![self.model.clone()])?];
        let (mut left, mut taken) = (self.parameters.as_slice(), first % WAYS);
        while !left.is_empty() {
            let (some, others) = left.split_at(left.len().min(WAYS - taken));
            let mut beside = vec![self.model.clone(); 1 + AROUND * WAYS];
            let places = beside.iter_mut().skip(1 + AROUND * taken);
            places.zip(some.iter().flatten()).for_each(|(to, model)| *to = model.clone());
            all.push(SideBySide::new(beside).map_err(|error| self.different().unwrap_or(error))?);
            (left, taken) = (others, 0);
        }
        Ok(all)
    }

    /// The error that names the parameter that changes more than numbers.
    fn different(&self) -> Option<Error> {
        let alike = |around: &Around| around.iter().all(|m| differ_in_numbers(&self.model, m));
        let nth = self.parameters.iter().position(|around| !alike(around))?;
        let limit =
            "one that steps read as a number: not zero or infinite, and no case of its own, \
                     as an impedance that is flat or of power 1 or 2";
        Some(Error::value("parameter", nth, limit))
    }
}

/// States of worlds, equally many of each, at which to linearise.
pub struct Asked<'a> {
    pub states: Givens<'a>,
    pub count: usize,
    /// The models of each world, with the same number of parameters.
    pub worlds: &'a [Arc<Neighbourhood>],
    /// The first world's number, in errors.
    pub first: usize,
}

impl Asked<'_> {
    /// The world of the nth state.
    pub(super) fn world(&self, nth: usize) -> usize {
        nth * self.worlds.len() / self.count.max(1)
    }
}

/// Linearisations under way, ∂x⁺/∂x, ∂x⁺/∂ctrl and ∂x⁺/∂parameter, each at a state of a model.
pub struct Linearizer {
    sim: Sim<Dual>,
    start: State<Dual>,
    ctrl: Vec<Dual>,
    of: Arc<Neighbourhood>,
    /// The models of its steps.
    models: Vec<SideBySide<Dual>>,
    /// The number of columns before the parameters'.
    own: usize,
    /// The requested linearisations, the one under way, and its completed ways.
    asked: Range<usize>,
    nth: usize,
    done: usize,
    /// The last step was from here too, and in no direction that moves positions.
    still: bool,
    /// Elements at which the derivatives of the nth linearisation are one-sided: one of their rows
    /// is exactly where it becomes active.
    pub degenerate: Vec<(usize, Element)>,
    explain: Explain,
}

room!(Linearizer: sim, start, ctrl, of, models, degenerate; own, asked, nth, done, still, explain);

/// A direction of the derivatives, which start and end here; each is found by its place.
#[derive(Clone, Copy)]
pub(super) enum Direction {
    Position(usize),
    Velocity(usize),
    Activation(usize),
    Past(usize),
    Control(usize),
}

impl Linearizer {
    /// For worlds with the settings of this one, and models that differ from its model in numbers;
    /// computed in `f64`.
    pub fn new<R: Real>(from: &Sim<R>) -> Result<Self> {
        from.settings.check_fixed("linearize")?;
        Self::like(&from.plain(), explained::<R::One>)
    }

    fn like(from: &Plain, explain: Explain) -> Result<Self> {
        let sim = differentiated(from)?;
        let model = sim.models().first().clone();
        Ok(Self {
            start: sim.state.clone(),
            ctrl: sim.inputs.ctrl.clone(),
            own: 2 * model.nv + model.na + model.nhistory + model.actuators.len(),
            models: vec![sim.models()],
            of: Arc::new(Neighbourhood { model, parameters: Vec::new() }),
            sim,
            asked: 0..0,
            nth: 0,
            done: 0,
            still: false,
            degenerate: Vec::new(),
            explain,
        })
    }

    /// Uses these models for the following steps.
    fn take(&mut self, of: &Arc<Neighbourhood>) -> Result<()> {
        if !self.of.is(of) {
            self.models = of.side_by_side(of.first(self.own))?;
        }
        self.of = of.clone();
        Ok(())
    }

    /// Starts the next linearisation at the present state, inputs and impulses of a world.
    pub fn begin<R: Real>(&mut self, from: &Sim<R>, of: &Arc<Neighbourhood>) -> Result<()> {
        self.begin_at(&from.plain(), of)
    }

    fn begin_at(&mut self, from: &Plain, of: &Arc<Neighbourhood>) -> Result<()> {
        self.begin_of(0..1, of)?;
        self.restore();
        from.give(&mut self.sim);
        self.stand();
        Ok(())
    }

    /// Starts linearisations of these numbers, the first of them of this model.
    pub(super) fn begin_of(&mut self, asked: Range<usize>, of: &Arc<Neighbourhood>) -> Result<()> {
        self.take(of)?;
        (self.nth, self.done) = (asked.start, 0);
        self.asked = asked;
        self.degenerate.clear();
        Ok(())
    }

    /// Starts the next linearisation at a given state, whose impulses are unknown.
    fn go_to(&mut self, given: &Given) {
        self.restore();
        self.sim.put(0, given);
        self.sim.state.warm.clear();
        self.stand();
    }

    /// Goes back to the linearised state, without derivatives.
    fn restore(&mut self) {
        self.sim.state.clone_from(&self.start);
        self.sim.inputs.ctrl.copy_from_slice(&self.ctrl);
    }

    /// Makes the present state the linearised one.
    fn stand(&mut self) {
        // A sleeping world does not respond, so the world is differentiated awake.
        self.sim.state.wake();
        self.start.clone_from(&self.sim.state);
        self.ctrl.copy_from_slice(&self.sim.inputs.ctrl);
        self.still = false;
    }

    /// The rows of a matrix.
    pub fn rows(&self) -> usize {
        self.own - self.ctrl.len()
    }

    /// The columns of a matrix.
    pub fn width(&self) -> usize {
        self.own + self.of.parameters.len()
    }

    /// The number of entries of all requested matrices.
    pub fn numbers(&self) -> usize {
        self.asked.len() * self.rows() * self.width()
    }

    /// This many matrices of zeros. Each has 2 nv + na + nhistory rows of as many columns, then nu,
    /// then one for each parameter: A, B and P side by side, P by the distance of the models
    /// around.
    pub fn matrices(&self, count: usize) -> Result<Vec<f64>> {
        zeros("linearize", count.saturating_mul(self.rows()), self.width())
    }

    /// Steps that are left.
    pub fn steps(&self) -> u64 {
        let each = self.end().div_ceil(WAYS);
        ((self.asked.end - self.nth) * each - self.done.div_ceil(WAYS)) as u64
    }

    /// Takes the next `n` steps, or all that are left. `to`: the matrices of the requested states.
    pub fn advance(&mut self, n: u64, asked: Option<&Asked>, to: &mut [f64]) -> Result<()> {
        for _ in 0..n.min(self.steps()) {
            self.advance_once(asked, to).map_err(|error| match asked {
                Some(asked) => error.in_world(asked.first + asked.world(self.nth)),
                None => error,
            })?;
        }
        Ok(())
    }

    fn advance_once(&mut self, asked: Option<&Asked>, to: &mut [f64]) -> Result<()> {
        if let (0, Some(asked)) = (self.done, asked) {
            self.take(&asked.worlds[asked.world(self.nth)])?;
            self.go_to(&asked.states.of(self.nth));
        }
        self.step().map_err(|error| (self.explain)(&self.sim.plain(), error))?;
        let size = self.rows() * self.width();
        self.read_all(&mut to[(self.nth - self.asked.start) * size..][..size])
    }

    /// Memory [bytes]; models are not in it.
    pub fn bytes(&self) -> usize {
        size_of::<Self>() + self.room()
    }

    /// The number of all ways.
    fn end(&self) -> usize {
        match self.of.parameters.len() {
            0 => self.own,
            count => self.of.first(self.own) + count,
        }
    }

    /// The ways of the next step.
    fn ways(&self) -> Range<usize> {
        self.done..(self.done + WAYS).min(self.end())
    }

    /// The column of a way, if it has one.
    fn column(&self, way: usize) -> Option<usize> {
        match way.checked_sub(self.of.first(self.own)) {
            Some(parameter) => Some(self.own + parameter),
            None => (way < self.own).then_some(way),
        }
    }

    fn step(&mut self) -> Result<()> {
        self.restore();
        let ways = self.ways();
        for way in ways.start..ways.end.min(self.own) {
            Direction::nth(self.sim.model(), way).seed(&mut self.sim, way - ways.start);
        }
        let first = self.of.first(self.own);
        let parameters = ways.end > first;
        let beside = if parameters { 1 + ways.start / WAYS - first / WAYS } else { 0 };
        self.sim.take_models(&self.models[beside]);
        let still = ways.start >= self.sim.model.nv && !parameters;
        if still && self.still {
            self.sim.hold_positions();
        }
        self.still = still;
        self.sim.step(1)
    }

    fn read_all(&mut self, matrix: &mut [f64]) -> Result<()> {
        let ways = self.ways();
        for way in ways.clone() {
            if let Some(column) = self.column(way) {
                self.read(column, way - ways.start, matrix)?;
            }
        }
        self.done = ways.end;
        if self.done == self.end() {
            let (nth, sided) = (self.nth, self.sim.solver.take_degenerate());
            self.restore();
            let own = self.sim.corners();
            let all = BTreeSet::from_iter(sided.into_iter().chain(own));
            self.degenerate.extend(all.into_iter().map(|element| (nth, element)));
            (self.nth, self.done) = (nth + 1, 0);
        }
        Ok(())
    }

    /// One column, from the state after the step.
    fn read(&self, column: usize, slot: usize, matrix: &mut [f64]) -> Result<()> {
        let (nv, width) = (self.sim.model.nv, self.width());
        let state = &self.sim.state;
        for dof in 0..nv {
            let (place, axis) = coordinate(self.sim.model(), dof);
            let dq = match axis {
                None => state.qpos[place].slopes[slot],
                // 2 q̄ · dq / |q|².
                Some(axis) => {
                    let q: [f64; 4] = crate::real::array::from_fn(|k| state.qpos[place + k].value);
                    let d: [f64; 4] =
                        crate::real::array::from_fn(|k| state.qpos[place + k].slopes[slot]);
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
            matrix[dof * width + column] = dq;
            matrix[(nv + dof) * width + column] = dv;
        }
        for (entry, act) in state.act.iter().enumerate() {
            if !act.slopes[slot].is_finite() {
                let model = self.sim.model();
                let owner = model.element_name(Array::Act.owner(model, entry));
                return Err(self.infinite(format!("derivative of act[{entry}] of {owner}")));
            }
            matrix[(2 * nv + entry) * width + column] = act.slopes[slot];
        }
        let first = 2 * nv + state.act.len();
        for (entry, ctrl) in state.ctrl_history.iter().enumerate() {
            matrix[(first + entry) * width + column] = ctrl.slopes[slot];
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
    // A sleeping world does not respond, so the world is differentiated awake.
    let mut sim = from.awake::<Dual>()?;
    sim.solver = Box::new(Differentiated::new());
    Ok(sim)
}

impl Direction {
    /// The nth direction, in the order of the columns of A and B: positions, velocities,
    /// activations, past controls, controls.
    pub(super) fn nth(model: &Model, way: usize) -> Self {
        let (nv, na, past) = (model.nv, model.na, 2 * model.nv + model.na);
        if way < nv {
            Self::Position(way)
        } else if way < 2 * nv {
            Self::Velocity(way - nv)
        } else if way < 2 * nv + na {
            Self::Activation(way - 2 * nv)
        } else if way < past + model.nhistory {
            Self::Past(way - past)
        } else {
            Self::Control(way - past - model.nhistory)
        }
    }

    /// Sets the derivatives in a slot to this direction.
    pub(super) fn seed(self, sim: &mut Sim<Dual>, slot: usize) {
        match self {
            Self::Velocity(dof) => sim.state.qvel[dof].slopes[slot] = 1.0,
            Self::Activation(entry) => sim.state.act[entry].slopes[slot] = 1.0,
            Self::Past(entry) => sim.state.ctrl_history[entry].slopes[slot] = 1.0,
            Self::Control(index) => sim.inputs.ctrl[index].slopes[slot] = 1.0,
            Self::Position(dof) => {
                let (place, axis) = coordinate(sim.model(), dof);
                let qpos = &mut sim.state.qpos[place..];
                let Some(axis) = axis else {
                    qpos[0].slopes[slot] = 1.0;
                    return;
                };
                // q · (0, e/2).
                let [w, x, y, z] = crate::real::array::from_fn(|k| 0.5 * qpos[k].value);
                let slopes = [[-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]][axis];
                for (entry, slope) in qpos.iter_mut().zip(slopes) {
                    entry.slopes[slot] = slope;
                }
            }
        }
    }
}

/// The place of a dof's position in qpos, or of its quaternion, with the dof's axis.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Body, Geom, GeomType, Joint, Scene};
    use crate::settings::{Integrator, Settings};

    /// Boxes that fall on each other, so that there are more velocities than a step has directions.
    fn boxes() -> Arc<Model> {
        let mut scene = Scene::default();
        scene.geoms.push(Geom { kind: GeomType::Plane, ..Geom::default() });
        for z in [0.099, 0.298, 0.497] {
            scene.bodies.push(Body { pos: [0.0, 0.0, z], ..Body::default() });
            let body = scene.bodies.len() - 1;
            let damping = [0.1, 0.0, 0.0];
            scene.joints.push(Joint { body, kind: JointType::Free, damping, ..Joint::default() });
            let kind = GeomType::Box;
            scene.geoms.push(Geom { body, kind, size: [0.1; 3], ..Geom::default() });
        }
        Arc::new(Model::compile(&scene).unwrap())
    }

    /// Derivatives with held positions equal derivatives of steps that place anew.
    #[test]
    fn what_is_held_is_what_is_placed_again() {
        for integrator in Integrator::ALL {
            let settings = Settings { integrator: *integrator, ..Settings::default() };
            let mut sim = Sim::<f64>::new(boxes(), settings).unwrap();
            sim.state.qvel.iter_mut().enumerate().for_each(|(k, v)| *v = 0.01 * k as f64);
            sim.step(3).unwrap();
            let model = sim.model().clone();
            let of = Arc::new(Neighbourhood { model, parameters: Vec::new() });
            let made = [false, true].map(|anew| {
                let mut linearizer = Linearizer::new(&sim).unwrap();
                linearizer.begin(&sim, &of).unwrap();
                let mut matrix = linearizer.matrices(1).unwrap();
                while linearizer.steps() > 0 {
                    linearizer.still &= !anew;
                    linearizer.advance(1, None, &mut matrix).unwrap();
                }
                matrix
            });
            assert_eq!(made[0], made[1], "{integrator:?}");
        }
    }
}
