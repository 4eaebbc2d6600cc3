//! Quantities of actuators, at the positions that were placed last.

use crate::model::transmission::Transmission;
use crate::real::Real;
use crate::sim::Sim;

impl<R: Real> Sim<R> {
    /// Length of each actuator, in a lane.
    pub fn actuator_length(&self, lane: usize) -> Vec<f64> {
        let (model, pulls) = (&self.model, self.placed.pulls());
        let length = |along: &Transmission| along.length(model, &self.state.qpos, pulls);
        model.along.iter().map(|along| length(along).lane(lane)).collect()
    }

    /// Rate of an actuator's length, in a lane; 0 where the flag `actuation` is off, as in MuJoCo.
    pub fn actuator_velocity(&self, index: usize, lane: usize) -> f64 {
        if !self.model.features.actuation {
            return 0.0;
        }
        let (qpos, qvel) = (&self.state.qpos, &self.state.qvel);
        let along = self.model.along[index];
        along.velocity(&self.model, qpos, qvel, self.placed.pulls()).lane(lane)
    }
}
