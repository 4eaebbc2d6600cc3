//! What can be read of actuators, at the positions that were last placed.

use crate::real::Real;
use crate::sim::Sim;

impl<R: Real> Sim<R> {
    /// Length of each actuator and the rate of that, in a lane.
    pub fn actuator_motion(&self, lane: usize) -> (Vec<f64>, Vec<f64>) {
        let (model, pulls) = (&self.model, self.placed.pulls());
        let (qpos, qvel) = (&self.state.qpos, &self.state.qvel);
        let each = model.along.iter();
        each.map(|along| {
            let length: R = along.length(model, qpos, pulls);
            (length.lane(lane), along.velocity(model, qpos, qvel, pulls).lane(lane))
        })
        .unzip()
    }
}
