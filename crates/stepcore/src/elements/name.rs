//! What an element is called: the one place where text about elements is made.

use super::{Element, Kind, Named};
use crate::model::{Model, Tie};
use crate::scene::Target;

/// "joint `knee`", or "joint 3" where it has no name.
fn quoted(words: &str, name: &str, index: usize) -> String {
    if name.is_empty() {
        format!("{words} {index}")
    } else {
        format!("{words} `{name}`")
    }
}

/// As `quoted`; what has no name is called by what it belongs to, which is found in the file.
fn found(words: &str, name: &str, index: usize, whose: impl FnOnce() -> String) -> String {
    let called = quoted(words, name, index);
    if name.is_empty() {
        called + &whose()
    } else {
        called
    }
}

impl Model {
    /// What a user calls an element; it must be one of this model.
    pub fn element_name(&self, element: Element) -> String {
        let index = element.index as usize;
        let joint = |words: &str| self.joint_name(words, index);
        let tendon = |words: &str| quoted(words, &self.tendons[index].name, index);
        match element.kind {
            Kind::Body => quoted("body", &self.bodies[index].name, index),
            Kind::Joint => joint("joint"),
            Kind::Geom => self.geom_name(index),
            Kind::Site => {
                let site = &self.sites[index];
                found("site", &site.name, index, || self.of_body(site.body))
            }
            Kind::Tendon => tendon("tendon"),
            Kind::TendonSpring => tendon("tendon spring"),
            Kind::TendonDamper => tendon("tendon damper"),
            Kind::TendonFriction => tendon("friction loss of tendon"),
            Kind::TendonLimit => tendon("limit of tendon"),
            Kind::Equality => self.equality_name("equality", index),
            Kind::Key => quoted("key", &self.keys[index].name, index),
            Kind::Actuator => {
                let actuator = &self.actuators[index];
                let words = if actuator.feeds_back() { "servo" } else { "motor" };
                found(words, &actuator.name, index, || self.at_target(&actuator.target))
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
            Kind::Spin => quoted("spin of body", &self.bodies[index].name, index),
            Kind::Connect | Kind::Weld | Kind::JointEquality | Kind::TendonEquality => {
                self.equality_name(element.kind.word(), index)
            }
            Kind::Contact => {
                let Some((one, two)) = self.contact_geoms(index) else {
                    return format!("contact {index}");
                };
                let geom = |index: usize| match &*self.geoms[index].name {
                    "" => self.geom_name(index),
                    name => format!("`{name}`"),
                };
                format!("contact {}/{}", geom(one), geom(two))
            }
        }
    }

    fn joint_name(&self, words: &str, index: usize) -> String {
        let joint = &self.joints[index];
        found(words, &joint.name, index, || self.of_body(joint.body))
    }

    fn geom_name(&self, index: usize) -> String {
        let geom = &self.geoms[index];
        found("geom", &geom.name, index, || self.of_body(geom.body))
    }

    fn equality_name(&self, words: &str, index: usize) -> String {
        let equality = &self.equalities[index];
        found(words, &equality.name, index, || match &equality.tie {
            Tie::Connect(ends) | Tie::Weld { ends, .. } => {
                let [one, two] = ends.bodies.map(|body| self.body_name(body));
                format!(" of {one} and {two}")
            }
            Tie::Lengths(_) => String::new(),
        })
    }

    /// What an actuator pulls at.
    fn at_target(&self, target: &Target) -> String {
        match *target {
            Target::Joint(joint) | Target::InParent(joint) => {
                format!(" at {}", self.joint_name("joint", joint))
            }
            Target::Tendon(tendon) => {
                format!(" at {}", quoted("tendon", &self.tendons[tendon].name, tendon))
            }
            _ => String::new(),
        }
    }

    fn of_body(&self, body: usize) -> String {
        format!(" of {}", self.body_name(body))
    }

    fn body_name(&self, index: usize) -> String {
        match index {
            0 => "the world".into(),
            _ => quoted("body", &self.bodies[index].name, index),
        }
    }

    /// How many elements of a kind the model has.
    pub fn count(&self, kind: Kind) -> usize {
        match kind {
            Kind::Body | Kind::BodyForce | Kind::Fluid | Kind::GravityCompensation | Kind::Spin => {
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
