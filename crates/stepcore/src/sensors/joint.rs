//! Joints, tendons and actuators: positions, velocities, limits and forces.

use super::{index, Reading};
use crate::elements::Kind;
use crate::model::transmission::Transmission;
use crate::real::{Mask, Real};
use crate::scene::{Sensor, SensorType, Target};
use crate::solve::Row;

impl<R: Real> Reading<'_, R> {
    pub(super) fn of_joint(&mut self, sensor: &Sensor, out: &mut Vec<f64>) {
        use SensorType as T;
        let (index, lane) = (index(sensor), self.lane);
        let (model, state) = (self.model(), &self.sim.state);
        let (qpos, qvel) = (&state.qpos, &state.qvel);
        match sensor.kind {
            T::JointPos => out.push(qpos[model.joints[index].qpos].lane(lane)),
            T::JointVel => out.push(qvel[model.joints[index].dof].lane(lane)),
            T::BallQuat => {
                let first = model.joints[index].qpos;
                out.extend(unit(&qpos[first..first + 4], lane));
            }
            T::BallAngVel => {
                let first = model.joints[index].dof;
                out.extend(qvel[first..first + 3].iter().map(|v| v.lane(lane)));
            }
            T::ActuatorPos => {
                let along = model.along[index];
                out.push(along.length(&self.sim.model, qpos, self.sim.placed.pulls()).lane(lane));
            }
            T::ActuatorVel => {
                out.push(self.sim.actuator_velocity(index, lane));
            }
            T::ActuatorFrc => out.push(self.sim.placed.actuator[index].lane(lane)),
            T::JointActuatorFrc => out.push(self.actuated(model.joints[index].dof)),
            T::TendonActuatorFrc => {
                let pulls = |k: &usize| model.actuators[*k].target == Target::Tendon(index);
                let own = (0..model.actuators.len()).filter(pulls);
                out.push(own.fold(0.0, |sum, k| sum + self.sim.placed.actuator[k].lane(lane)));
            }
            T::TendonPos => out.push(self.sim.placed.tendon_length[index].lane(lane)),
            T::TendonVel => {
                let along = Transmission::Tendon(index, None);
                out.push(
                    along.velocity(&self.sim.model, qpos, qvel, self.sim.placed.pulls()).lane(lane),
                );
            }
            T::JointLimitPos => out.push(self.limit(Kind::Limit, index, |row| row.gap)),
            T::JointLimitVel => out.push(self.limit(Kind::Limit, index, |row| row.velocity)),
            T::TendonLimitPos => out.push(self.limit(Kind::TendonLimit, index, |row| row.gap)),
            T::TendonLimitVel => {
                out.push(self.limit(Kind::TendonLimit, index, |row| row.velocity));
            }
            _ => {
                let joint = sensor.kind == T::JointLimitFrc;
                let kind = if joint { Kind::Limit } else { Kind::TendonLimit };
                let impulse = self.limit(kind, index, |row| row.total());
                out.push(impulse / self.sim.clock.seconds);
            }
        }
    }

    /// Force of all actuators on a dof, with the gravity compensation that acts through them.
    fn actuated(&self, dof: usize) -> f64 {
        let (forces, model) = (self.sim.element_forces(self.lane), &self.sim.model);
        let holds = model.joints[model.dofs[dof].joint].actuatorgravcomp;
        let forces = forces.iter().filter(|(element, _)| match element.kind {
            Kind::GravityCompensation => holds,
            kind => kind == Kind::Actuator,
        });
        forces.map(|(_, force)| force[dof]).sum()
    }

    /// A quantity of the acting limit of a joint or a tendon, the lower one if both act; else 0.
    fn limit(&self, kind: Kind, index: usize, of: impl Fn(&Row<R>) -> R) -> f64 {
        let acts = self.sim.rows.blocks.iter().find(|block| {
            let element = block.element;
            element.kind == kind && element.index == index as u64 && block.mask.lane(self.lane)
        });
        acts.map_or(0.0, |block| of(&self.sim.rows.rows[block.rows.start]).lane(self.lane))
    }
}

/// A quaternion at unit length: the state's may be off by rounding, or as the user wrote it.
fn unit<R: Real>(quat: &[R], lane: usize) -> [f64; 4] {
    let quat = [quat[0], quat[1], quat[2], quat[3]].map(|x| x.lane(lane));
    let length = quat.iter().map(|x| x * x).sum::<f64>().sqrt();
    quat.map(|x| x / length)
}
