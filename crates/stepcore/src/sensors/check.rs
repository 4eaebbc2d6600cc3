//! Checks that the objects of a scene's sensors exist.

use crate::elements::{text, Kind, Text};
use crate::error::{Error, Result};
use crate::scene::{JointType, ObjectType, Scene, Sensor, SensorObject, SensorType};

/// Every sensor has the objects that its type needs, and they are in the scene.
pub(crate) fn sensors(scene: &Scene) -> Result<()> {
    for (at, sensor) in scene.sensors.iter().enumerate() {
        let refuse = |what: String| {
            let label = Text::label(Kind::Sensor, &sensor.name, at);
            Err(Error::Scene(text![label, ": ", what]))
        };
        for object in [sensor.object, sensor.reference].into_iter().flatten() {
            if object.index >= count(scene, object.kind) {
                return refuse(format!("its {:?} {} is not there", object.kind, object.index));
            }
        }
        if let Err(what) = fits(scene, sensor) {
            return refuse(format!("a sensor of type {} needs {what}", sensor.kind.word()));
        }
        if !sensor.cutoff.is_finite() {
            return refuse("its cutoff must be finite".into());
        }
    }
    Ok(())
}

fn count(scene: &Scene, kind: ObjectType) -> usize {
    match kind {
        ObjectType::Body | ObjectType::XBody => scene.bodies.len(),
        ObjectType::Geom => scene.geoms.len(),
        ObjectType::Site => scene.sites.len(),
        ObjectType::Joint => scene.joints.len(),
        ObjectType::Tendon => scene.tendons.len(),
        ObjectType::Actuator => scene.actuators.len(),
    }
}

fn fits(scene: &Scene, sensor: &Sensor) -> std::result::Result<(), &'static str> {
    use SensorType as T;
    let is = |object: Option<SensorObject>, kinds: &[ObjectType]| {
        object.is_some_and(|object| kinds.contains(&object.kind))
    };
    let joint = |kinds: &[JointType]| {
        let object = sensor.object.filter(|object| object.kind == ObjectType::Joint);
        object.is_some_and(|object| kinds.contains(&scene.joints[object.index].kind))
    };
    let (one, two) = (sensor.object, sensor.reference);
    let ends = [ObjectType::Geom, ObjectType::Body];
    let frames = [ObjectType::Body, ObjectType::XBody, ObjectType::Geom, ObjectType::Site];
    let met = [ObjectType::Geom, ObjectType::Body, ObjectType::XBody];
    let (needs, has) = match sensor.kind {
        T::Touch
        | T::Accelerometer
        | T::Velocimeter
        | T::Gyro
        | T::Force
        | T::Torque
        | T::Magnetometer
        | T::Rangefinder => ("a site", is(one, &[ObjectType::Site])),
        T::JointPos | T::JointVel | T::JointActuatorFrc => {
            ("a hinge or a slide", joint(&[JointType::Hinge, JointType::Slide]))
        }
        T::BallQuat | T::BallAngVel => ("a ball joint", joint(&[JointType::Ball])),
        T::JointLimitPos | T::JointLimitVel | T::JointLimitFrc => (
            "a hinge, a slide or a ball joint",
            is(one, &[ObjectType::Joint]) && !joint(&[JointType::Free]),
        ),
        T::TendonPos
        | T::TendonVel
        | T::TendonActuatorFrc
        | T::TendonLimitPos
        | T::TendonLimitVel
        | T::TendonLimitFrc => ("a tendon", is(one, &[ObjectType::Tendon])),
        T::ActuatorPos | T::ActuatorVel | T::ActuatorFrc => {
            ("an actuator", is(one, &[ObjectType::Actuator]))
        }
        T::SubtreeCom | T::SubtreeLinVel | T::SubtreeAngMom => {
            ("a body", is(one, &[ObjectType::Body, ObjectType::XBody]))
        }
        T::Distance | T::Normal | T::FromTo => {
            ("two geoms or bodies", is(one, &ends) && is(two, &ends))
        }
        T::InsideSite => {
            ("an object with a frame, and a site", is(one, &frames) && is(two, &[ObjectType::Site]))
        }
        T::Contact => (
            "geoms, bodies, subtrees or a site to match",
            (one.is_none() || is(one, &[met.as_slice(), &[ObjectType::Site]].concat()))
                && (two.is_none() || is(two, &met)),
        ),
        T::Clock | T::PotentialEnergy | T::KineticEnergy | T::User => {
            ("nothing to look at", one.is_none() && two.is_none())
        }
        _ => ("an object with a frame", is(one, &frames) && (two.is_none() || is(two, &frames))),
    };
    if has {
        Ok(())
    } else {
        Err(needs)
    }
}
