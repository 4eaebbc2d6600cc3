//! Stiffness and damping of every element at one state.
//!
//! An element's stiffness is minus the derivative of its generalised force by the positions, its
//! damping minus the derivative by the velocities, in the coordinates of `linearize.rs`. As there,
//! they come from forces in numbers that carry derivatives. So everything is included: the changes
//! of a force, the rotation of its directions, and the reactions of rows. Rows act as they act at
//! the state; if one opens or closes exactly there, its derivatives are one-sided.

use std::collections::BTreeMap;

use super::linearize::{differentiated, Direction};
use super::watched::{explained, Explain};
use crate::elements::forces::each;
use crate::elements::{spin, Element, Kind};
use crate::error::{Error, Result};
use crate::real::{Dual, Real, WAYS};
use crate::sim::{At, Sim};
use crate::state::State;

/// Force, energy, stiffness and damping of the elements at one state, under way.
pub struct ElementSlopes {
    sim: Sim<Dual>,
    start: State<Dual>,
    done: usize,
    elements: BTreeMap<Element, Acts>,
    explain: Explain,
}

/// The effect of one element.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Acts {
    /// By dof [N or N·m].
    pub force: BTreeMap<usize, f64>,
    /// Its stored energy [J].
    pub energy: f64,
    /// By two dofs: stiffness and damping, minus the derivatives of the force on the first by the
    /// position and the velocity of the second.
    pub slopes: BTreeMap<(usize, usize), [f64; 2]>,
}

impl ElementSlopes {
    /// Starts at the present state and inputs of a world, with its settings, computed in `f64`.
    pub fn new<R: Real>(from: &Sim<R>) -> Result<Self> {
        let sim = differentiated(&from.plain())?;
        let (start, explain) = (sim.state.clone(), explained::<R::One> as Explain);
        Ok(Self { start, sim, done: 0, elements: BTreeMap::new(), explain })
    }

    /// The total number of evaluations.
    pub fn steps(&self) -> u64 {
        (2 * self.sim.model.nv).div_ceil(WAYS) as u64
    }

    /// Makes the next `n` evaluations.
    pub fn advance(&mut self, n: u64) -> Result<()> {
        for _ in 0..n {
            self.evaluate().map_err(|error| (self.explain)(&self.sim.plain(), error))?;
        }
        Ok(())
    }

    /// Elements that push, store or would push; a contact's parts together.
    pub fn finish(mut self) -> Result<BTreeMap<Element, Acts>> {
        for (element, acts) in &self.elements {
            if !acts.slopes.values().flatten().all(|slope| slope.is_finite()) {
                let name = self.sim.model.element_name(*element);
                let limit = "finite: the force is not differentiable at this state";
                return Err(Error::value(format!("derivative of {name}"), "infinite", limit));
            }
        }
        self.sim.refresh();
        for (element, energy) in self.sim.stored_by_element(0) {
            self.elements.entry(element).or_default().energy = energy;
        }
        Ok(self.elements)
    }

    fn evaluate(&mut self) -> Result<()> {
        let nv = self.sim.model.nv;
        let ways = self.done..(self.done + WAYS).min(2 * nv);
        self.sim.state.clone_from(&self.start);
        for (slot, way) in ways.clone().enumerate() {
            Direction::nth(self.sim.model(), way).seed(&mut self.sim, slot);
        }
        self.sim.forward()?;
        let mut forces: BTreeMap<(Element, usize), Dual> = BTreeMap::new();
        let mut add = |element: Element, dof: usize, force: Dual| {
            if force != Dual::of(0.0) {
                *forces.entry((element.of_part(), dof)).or_insert(Dual::of(0.0)) += force;
            }
        };
        let now = self.sim.moment(At::State);
        each(&now, &mut add);
        for body in 0..self.sim.model.bodies.len() {
            let element = Element::whole(Kind::Spin, body);
            spin::force(&now, body, &mut |dof, force| add(element, dof, force));
        }
        let rate = Dual::of(1.0 / self.sim.clock.seconds);
        self.sim.each_row_impulse(0, |element, dof, impulse| add(element, dof, impulse * rate));
        for ((element, dof), force) in forces {
            let acts = self.elements.entry(element).or_default();
            acts.force.insert(dof, force.value);
            for (slope, way) in force.slopes.into_iter().zip(ways.clone()) {
                if slope != 0.0 {
                    acts.slopes.entry((dof, way % nv)).or_default()[way / nv] = -slope;
                }
            }
        }
        self.done = ways.end;
        Ok(())
    }
}
