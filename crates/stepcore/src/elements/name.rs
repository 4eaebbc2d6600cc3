//! Names of elements: the one place where text about elements is made.

use super::{Element, Kind, Named};
use crate::model::{Model, Tie};
use crate::real::Constant;
use crate::scene::Target;

/// Returns a name in quotes, or the index of an element without a name.
fn called(name: &str, index: usize) -> String {
    if name.is_empty() {
        index.to_string()
    } else {
        format!("`{name}`")
    }
}

/// Does as `called`; an element without a name is identified by its owner in the file.
fn found(name: &str, index: usize, whose: impl FnOnce() -> String) -> String {
    let called = called(name, index);
    if name.is_empty() {
        called + &whose()
    } else {
        called
    }
}

/// The parts of an element's name: "spring of joint `knee`" is the noun "spring", the owner "joint" and
/// the label "`knee`". A missing owner or label is empty.
pub struct Words {
    pub noun: &'static str,
    pub owner: &'static str,
    pub label: String,
}

impl core::fmt::Display for Words {
    fn fmt(&self, f: &mut core::fmt::Formatter) -> core::fmt::Result {
        f.write_str(self.noun)?;
        if !self.owner.is_empty() {
            write!(f, " of {}", self.owner)?;
        }
        if !self.label.is_empty() {
            write!(f, " {}", self.label)?;
        }
        Ok(())
    }
}

impl<N: Constant> Model<N> {
    /// Returns the name of an element of this model, as users read it.
    pub fn element_name(&self, element: Element) -> String {
        self.element_words(element).to_string()
    }

    /// Returns the same in parts.
    pub fn element_words(&self, element: Element) -> Words {
        let index = element.index as usize;
        let joint = || self.joint_label(index);
        let tendon = || self.tendon_label(index);
        let body = || self.body_label(index);
        let (noun, owner, label) = match element.kind {
            Kind::Body => ("body", "", body()),
            Kind::Joint => ("joint", "", joint()),
            Kind::Geom => ("geom", "", self.geom_label(index)),
            Kind::Site => {
                let site = &self.sites[index];
                ("site", "", found(&site.name, index, || self.of_body(site.body)))
            }
            Kind::Tendon => ("tendon", "", tendon()),
            Kind::TendonSpring => ("tendon spring", "", tendon()),
            Kind::TendonDamper => ("tendon damper", "", tendon()),
            Kind::TendonFriction => ("friction loss", "tendon", tendon()),
            Kind::TendonLimit => ("limit", "tendon", tendon()),
            Kind::Equality => ("equality", "", self.equality_label(index)),
            Kind::Key => ("key", "", called(&self.keys[index].name, index)),
            Kind::Actuator => {
                let actuator = &self.actuators[index];
                let noun = if actuator.feeds_back() { "servo" } else { "motor" };
                let at = || self.at_target(&actuator.target);
                (noun, "", found(&actuator.name, index, at))
            }
            Kind::Sensor => ("sensor", "", called(&self.sensors[index].name, index)),
            Kind::Spring => ("spring", "joint", joint()),
            Kind::Damper => ("damper", "joint", joint()),
            Kind::FrictionLoss => ("friction loss", "joint", joint()),
            Kind::Limit => ("limit", "joint", joint()),
            Kind::Inertia => ("inertial force", "joint", joint()),
            Kind::JointForce => ("force applied to joint", "", joint()),
            Kind::BodyForce => ("force applied to body", "", body()),
            Kind::Gravity => ("gravity", "", String::new()),
            Kind::Fluid => ("fluid drag on body", "", body()),
            Kind::GravityCompensation => ("gravity compensation", "body", body()),
            Kind::Spin => ("spin", "body", body()),
            Kind::Connect | Kind::Weld | Kind::JointEquality | Kind::TendonEquality => {
                (element.kind.word(), "", self.equality_label(index))
            }
            Kind::Contact => {
                let geom = |index: usize| match &*self.geoms[index].name {
                    "" => format!("geom {}", self.geom_label(index)),
                    name => format!("`{name}`"),
                };
                let label = match self.contact_geoms(index) {
                    Some((one, two)) => format!("{}/{}", geom(one), geom(two)),
                    None => index.to_string(),
                };
                ("contact", "", label)
            }
        };
        Words { noun, owner, label }
    }

    fn joint_label(&self, index: usize) -> String {
        let joint = &self.joints[index];
        found(&joint.name, index, || self.of_body(joint.body))
    }

    fn tendon_label(&self, index: usize) -> String {
        called(&self.tendons[index].name, index)
    }

    fn body_label(&self, index: usize) -> String {
        called(&self.bodies[index].name, index)
    }

    fn geom_label(&self, index: usize) -> String {
        let geom = &self.geoms[index];
        found(&geom.name, index, || self.of_body(geom.body))
    }

    fn equality_label(&self, index: usize) -> String {
        let equality = &self.equalities[index];
        found(&equality.name, index, || match &equality.tie {
            Tie::Connect(ends) | Tie::Weld { ends, .. } => {
                let [one, two] = ends.bodies.map(|body| self.body_name(body));
                format!(" of {one} and {two}")
            }
            Tie::Lengths(_) => String::new(),
        })
    }

    /// Returns the name of an actuator's target.
    fn at_target(&self, target: &Target) -> String {
        match *target {
            Target::Joint(joint) | Target::InParent(joint) => {
                format!(" at joint {}", self.joint_label(joint))
            }
            Target::Tendon(tendon) => format!(" at tendon {}", self.tendon_label(tendon)),
            _ => String::new(),
        }
    }

    fn of_body(&self, body: usize) -> String {
        format!(" of {}", self.body_name(body))
    }

    fn body_name(&self, index: usize) -> String {
        match index {
            0 => "the world".into(),
            _ => format!("body {}", self.body_label(index)),
        }
    }

    /// Returns the number of elements of a kind in the model.
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
            Kind::Contact => {
                self.dynamic_pairs.as_ref().map_or(self.pairs.len(), |heap| heap.numbers())
            }
        }
    }

    /// Returns an element with its name.
    pub fn named(&self, element: Element) -> Named {
        Named { element, name: self.element_name(element) }
    }
}
