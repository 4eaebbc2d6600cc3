//! Sensors: MuJoCo's `sensordata`, one file for each family.
//!
//! They are computed when they are read and never in a step. Their values belong to the state of
//! the last solve (`watch/last_solve.rs`), as MuJoCo's do. A [`Reading`] holds what several sensors
//! share, and makes each part of it when the first sensor needs it.

pub(crate) mod check;
mod contact;
mod distance;
mod frame;
mod joint;
mod site;
mod touch;

use crate::model::Model;
use crate::real::Real;
use crate::scene::{ObjectType, Sensor, SensorObject, SensorType};
use crate::sim::Sim;
use crate::spatial::{Pose, Quat, V3};
use crate::watch::{Bodies, BodyForces};

/// One world at the instant that its sensors read.
pub struct Reading<'a, R: Real> {
    pub(crate) sim: &'a mut Sim<R>,
    lane: usize,
    bodies: Bodies,
    forces: Option<BodyForces>,
}

/// How a cutoff bounds values.
#[derive(Clone, Copy, PartialEq)]
enum Bound {
    BothSides,
    Above,
    None,
}

impl Sensor {
    /// The number of its values.
    pub fn size(&self) -> usize {
        use SensorType as T;
        let fields: usize = self.data.iter().map(|field| field.size()).sum();
        match self.kind {
            T::Contact => fields.saturating_mul(self.num),
            T::Rangefinder => fields,
            T::FrameQuat | T::BallQuat => 4,
            T::FromTo => 6,
            T::User => self.num,
            T::Touch | T::JointPos | T::JointVel => 1,
            T::ActuatorPos | T::ActuatorVel | T::ActuatorFrc | T::JointActuatorFrc => 1,
            T::JointLimitPos | T::JointLimitVel | T::JointLimitFrc => 1,
            T::TendonPos | T::TendonVel | T::TendonActuatorFrc => 1,
            T::TendonLimitPos | T::TendonLimitVel | T::TendonLimitFrc => 1,
            T::InsideSite | T::Distance => 1,
            T::PotentialEnergy | T::KineticEnergy | T::Clock => 1,
            _ => 3,
        }
    }

    /// Whether it reads contacts, rows, forces or accelerations, which need a solve.
    pub fn needs_solve(&self) -> bool {
        use SensorType as T;
        matches!(
            self.kind,
            T::Touch
                | T::Accelerometer
                | T::Force
                | T::Torque
                | T::ActuatorFrc
                | T::JointActuatorFrc
                | T::JointLimitPos
                | T::JointLimitVel
                | T::JointLimitFrc
                | T::TendonActuatorFrc
                | T::TendonLimitPos
                | T::TendonLimitVel
                | T::TendonLimitFrc
                | T::FrameLinAcc
                | T::FrameAngAcc
                | T::Contact
        )
    }

    fn bound(&self) -> Bound {
        use SensorType as T;
        match self.kind {
            _ if self.cutoff <= 0.0 => Bound::None,
            T::Touch | T::InsideSite => Bound::Above,
            // Directions and orientations have no bound; the ends of a distance are found within
            // it.
            T::FrameQuat | T::BallQuat | T::FrameXAxis | T::FrameYAxis | T::FrameZAxis => {
                Bound::None
            }
            T::Normal | T::FromTo | T::Contact => Bound::None,
            _ => Bound::BothSides,
        }
    }
}

impl Model {
    /// Numbers of all sensors together.
    pub fn sensordata(&self) -> usize {
        self.sensors.iter().map(Sensor::size).sum()
    }
}

impl<'a, R: Real> Reading<'a, R> {
    /// Reads one lane of a world, at its present state; if it has solved there, of that solve.
    pub fn new(sim: &'a mut Sim<R>, lane: usize) -> Self {
        let bodies = sim.bodies(lane);
        sim.refresh();
        sim.add_forces_through_contacts();
        Self { sim, lane, bodies, forces: None }
    }

    /// Appends a sensor's values.
    pub fn read(&mut self, sensor: &Sensor, values: &mut Vec<f64>) {
        let first = values.len();
        self.value(sensor, values);
        debug_assert_eq!(values.len() - first, sensor.size());
        let cutoff = sensor.cutoff;
        for value in &mut values[first..] {
            *value = match sensor.bound() {
                Bound::BothSides => value.clamp(-cutoff, cutoff),
                Bound::Above => value.min(cutoff),
                Bound::None => *value,
            };
        }
    }

    fn value(&mut self, sensor: &Sensor, out: &mut Vec<f64>) {
        use SensorType as T;
        match sensor.kind {
            T::Touch => out.push(self.touch(sensor)),
            T::Contact => self.contacts(sensor, out),
            T::Accelerometer | T::Velocimeter | T::Gyro | T::Force | T::Torque => {
                out.extend(self.at_site(sensor).iter());
            }
            T::Magnetometer => {
                let flux = self.sim.model.magnetic;
                out.extend(self.pose(sensor.object).to_local(&flux).iter());
            }
            T::Rangefinder => self.range(sensor, out),
            T::InsideSite => out.push(self.inside(sensor)),
            T::Distance | T::Normal | T::FromTo => self.apart(sensor, out),
            T::FrameQuat => self.turn(sensor, out),
            T::FramePos | T::FrameXAxis | T::FrameYAxis | T::FrameZAxis => {
                out.extend(self.place(sensor).iter());
            }
            T::FrameLinVel | T::FrameAngVel => out.extend(self.speed(sensor).iter()),
            T::FrameLinAcc | T::FrameAngAcc => out.extend(self.acceleration(sensor).iter()),
            T::SubtreeCom => out.extend(self.bodies.subtree_com[index(sensor)].iter()),
            T::SubtreeLinVel => {
                out.extend(self.bodies.subtree_momentum(self.model(), sensor).1.iter())
            }
            T::SubtreeAngMom => {
                out.extend(self.bodies.subtree_momentum(self.model(), sensor).0.iter())
            }
            T::Clock => out.push(self.sim.time()),
            // The user fills it in.
            T::User => out.extend(std::iter::repeat_n(0.0, sensor.num)),
            T::PotentialEnergy => {
                let potential = self.sim.potential_of_springs_and_weight();
                out.push(potential.lane(self.lane));
            }
            T::KineticEnergy => out.push(self.sim.kinetic().lane(self.lane)),
            _ => self.of_joint(sensor, out),
        }
    }

    fn model(&self) -> &Model {
        self.sim.model_of(self.lane)
    }

    /// Forces of the solve between bodies.
    fn forces(&mut self) -> &BodyForces {
        let (sim, bodies, lane) = (&*self.sim, &self.bodies, self.lane);
        self.forces.get_or_insert_with(|| sim.body_forces(bodies, lane))
    }

    /// The body that an object is part of.
    fn body_of(&self, object: SensorObject) -> usize {
        match object.kind {
            ObjectType::Body | ObjectType::XBody => object.index,
            ObjectType::Geom => self.model().geoms[object.index].body,
            ObjectType::Site => self.model().sites[object.index].body,
            ObjectType::Joint => self.model().joints[object.index].body,
            ObjectType::Tendon | ObjectType::Actuator => 0,
        }
    }

    /// Pose of an object with a frame, in its body.
    fn mount(&self, object: SensorObject) -> (usize, V3<f64>, [f64; 4]) {
        const UPRIGHT: [f64; 4] = [1.0, 0.0, 0.0, 0.0];
        let body = self.body_of(object);
        let (pos, quat) = match object.kind {
            ObjectType::Geom => {
                let geom = &self.model().geoms[object.index];
                (geom.pos, geom.quat)
            }
            ObjectType::Site => {
                let site = &self.model().sites[object.index];
                (site.pos, site.quat)
            }
            ObjectType::Body => (self.model().bodies[body].ipos, self.model().bodies[body].iquat),
            _ => (V3::zeros(), UPRIGHT),
        };
        (body, pos, quat)
    }

    /// Pose of an object in the world; the world's frame without one.
    fn pose(&self, object: Option<SensorObject>) -> Pose<f64> {
        let Some(object) = object else {
            return Pose { pos: V3::zeros(), rot: Quat::identity().matrix() };
        };
        let (body, pos, quat) = self.mount(object);
        self.bodies.pose(body, &pos, &quat)
    }
}

/// The place of a sensor's object in the list of its type.
fn index(sensor: &Sensor) -> usize {
    sensor.object.map_or(0, |object| object.index)
}
