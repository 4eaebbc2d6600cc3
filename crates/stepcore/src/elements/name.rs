//! What an element is called: the one place where text about elements is made.

use super::{Element, Kind, Named};
use crate::model::Model;

/// "joint `knee`", or "joint 3" where it has no name.
fn quoted(words: &str, name: &str, index: usize) -> String {
    if name.is_empty() {
        format!("{words} {index}")
    } else {
        format!("{words} `{name}`")
    }
}

impl Model {
    /// What a user calls an element; it must be one of this model.
    pub fn element_name(&self, element: Element) -> String {
        let index = element.index as usize;
        let joint = |words: &str| quoted(words, &self.joints[index].name, index);
        let tendon = |words: &str| quoted(words, &self.tendons[index].name, index);
        match element.kind {
            Kind::Body => quoted("body", &self.bodies[index].name, index),
            Kind::Joint => joint("joint"),
            Kind::Geom => quoted("geom", &self.geoms[index].name, index),
            Kind::Site => quoted("site", &self.sites[index].name, index),
            Kind::Tendon => tendon("tendon"),
            Kind::TendonSpring => tendon("tendon spring"),
            Kind::TendonDamper => tendon("tendon damper"),
            Kind::TendonFriction => tendon("friction loss of tendon"),
            Kind::TendonLimit => tendon("limit of tendon"),
            Kind::Equality => quoted("equality", &self.equalities[index].name, index),
            Kind::Key => quoted("key", &self.keys[index].name, index),
            Kind::Actuator => {
                let actuator = &self.actuators[index];
                let words = if actuator.feeds_back() { "servo" } else { "motor" };
                quoted(words, &actuator.name, index)
            }
            Kind::Sensor => quoted("sensor", &self.sensors[index].name, index),
            Kind::Spring => joint("spring of joint"),
            Kind::Damper => joint("damper of joint"),
            Kind::FrictionLoss => joint("friction loss of joint"),
            Kind::Limit => joint("limit of joint"),
            Kind::Inertia => joint("inertial force of joint"),
            Kind::JointForce => joint("force applied to joint"),
            Kind::BodyForce => quoted("force applied to body", &self.bodies[index].name, index),
            Kind::Gravity => "gravity".into(),
            Kind::Fluid => quoted("fluid drag on body", &self.bodies[index].name, index),
            Kind::GravityCompensation => {
                quoted("gravity compensation of body", &self.bodies[index].name, index)
            }
            Kind::Connect | Kind::Weld | Kind::JointEquality | Kind::TendonEquality => {
                quoted(element.kind.word(), &self.equalities[index].name, index)
            }
            Kind::Contact => {
                let Some((one, two)) = self.contact_geoms(index) else {
                    return format!("contact {index}");
                };
                let geom = |index: usize| match &*self.geoms[index].name {
                    "" => format!("`{index}`"),
                    name => format!("`{name}`"),
                };
                format!("contact {}/{}", geom(one), geom(two))
            }
        }
    }

    /// How many elements of a kind the model has.
    pub fn count(&self, kind: Kind) -> usize {
        match kind {
            Kind::Body | Kind::BodyForce | Kind::Fluid | Kind::GravityCompensation => {
                self.bodies.len()
            }
            Kind::Joint
            | Kind::Spring
            | Kind::Damper
            | Kind::FrictionLoss
            | Kind::Limit
            | Kind::Inertia
            | Kind::JointForce => self.joints.len(),
            Kind::Geom => self.geoms.len(),
            Kind::Site => self.sites.len(),
            Kind::Tendon
            | Kind::TendonSpring
            | Kind::TendonDamper
            | Kind::TendonFriction
            | Kind::TendonLimit => self.tendons.len(),
            Kind::Equality
            | Kind::Connect
            | Kind::Weld
            | Kind::JointEquality
            | Kind::TendonEquality => self.equalities.len(),
            Kind::Key => self.keys.len(),
            Kind::Actuator => self.actuators.len(),
            Kind::Sensor => self.sensors.len(),
            Kind::Gravity => 1,
            Kind::Contact => self.heap.as_ref().map_or(self.pairs.len(), |heap| heap.numbers()),
        }
    }

    /// An element with its name.
    pub fn named(&self, element: Element) -> Named {
        Named { element, name: self.element_name(element) }
    }
}
