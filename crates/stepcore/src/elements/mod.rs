//! The elements of a scene: everything that pushes, stores, takes or constrains.
//!
//! An `Element` identifies one of them as data: rows, contacts, shares of a post-mortem and errors
//! carry it. Its text is made in `name.rs` and nowhere else. Each kind is one file with its force,
//! slopes, energy, power and rows; `forces.rs` lists the kinds that push, and `constraints.rs` the
//! kinds that have rows.

pub(crate) mod activation;
pub(crate) mod actuator;
mod adhesion;
mod applied;
mod connect;
mod constraint;
pub(crate) mod constraints;
mod contact;
mod controller;
mod coupling;
mod damper;
mod delay;
mod equality;
mod fluid;
pub(crate) mod force;
pub(crate) mod forces;
pub(crate) mod friction;
pub(crate) mod friction_loss;
mod gravcomp;
mod gravity;
mod joint_forces;
pub(crate) mod limit;
mod muscle;
mod name;
mod orientation;
pub(crate) mod penalty;
mod pyramids;
mod shared_contacts;
pub(crate) mod spin;
mod spring;
mod stiction;
mod surface_velocity;
pub(crate) mod tendon_spring;
mod text;
pub(crate) mod weld;

pub use friction::ways;
pub use joint_forces::joint_forces;
pub use name::Words;
pub(crate) use text::text;
pub use text::{Mention, Named, Text};

/// The kind of an element.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    // Entries of the scene's lists, by their index there.
    Body,
    Joint,
    Geom,
    Site,
    Tendon,
    Equality,
    Key,
    /// A motor or a servo.
    Actuator,
    Sensor,
    // Parts of a joint, by its index.
    Spring,
    Damper,
    /// Part: the number of the joint's dof.
    FrictionLoss,
    /// Part: 0 for the lower bound, 1 for the upper one.
    Limit,
    // Parts of a tendon, by its index.
    TendonSpring,
    TendonDamper,
    TendonFriction,
    /// Part: 0 for the lower bound, 1 for the upper one.
    TendonLimit,
    /// The inertial forces of a tree, identified by the joint on which they do most work.
    Inertia,
    /// `qfrc_applied` on a joint.
    JointForce,
    /// `xfrc_applied` on a body, by the body's index.
    BodyForce,
    /// Part: the body whose weight it is.
    Gravity,
    // Parts of a body, by its index.
    Fluid,
    GravityCompensation,
    /// The gyroscopic torque: a part of the bias forces.
    Spin,
    // By the index of their equality.
    /// A point that two bodies share.
    Connect,
    /// A frame that two bodies share.
    Weld,
    /// A joint that follows another, or stays.
    JointEquality,
    /// A tendon's length that follows another's, or stays.
    TendonEquality,
    /// By the index of its pair of geoms, in a pile by its number (`model/dynamic_pairs.rs`). Part: the
    /// number of the pair's contact.
    Contact,
}

/// The role of a block for the solvers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Holds against any load.
    Equality,
    /// Friction within fixed bounds.
    Loss,
    /// Pushes one way.
    Limit,
    /// The same, with friction if it has more than one row.
    Contact,
}

impl Kind {
    /// Every kind, in the order of the enum.
    pub const ALL: [Self; 29] = [
        Self::Body,
        Self::Joint,
        Self::Geom,
        Self::Site,
        Self::Tendon,
        Self::Equality,
        Self::Key,
        Self::Actuator,
        Self::Sensor,
        Self::Spring,
        Self::Damper,
        Self::FrictionLoss,
        Self::Limit,
        Self::TendonSpring,
        Self::TendonDamper,
        Self::TendonFriction,
        Self::TendonLimit,
        Self::Inertia,
        Self::JointForce,
        Self::BodyForce,
        Self::Gravity,
        Self::Fluid,
        Self::GravityCompensation,
        Self::Spin,
        Self::Connect,
        Self::Weld,
        Self::JointEquality,
        Self::TendonEquality,
        Self::Contact,
    ];

    /// Returns the role of its rows for a solver.
    pub(crate) fn role(self) -> Role {
        match self {
            Self::Connect | Self::Weld | Self::JointEquality | Self::TendonEquality => {
                Role::Equality
            }
            Self::FrictionLoss | Self::TendonFriction => Role::Loss,
            Self::Contact => Role::Contact,
            _ => Role::Limit,
        }
    }

    /// Returns the name of the kind in data outside the engine.
    pub fn word(self) -> &'static str {
        match self {
            Self::Body => "body",
            Self::Joint => "joint",
            Self::Geom => "geom",
            Self::Site => "site",
            Self::Tendon => "tendon",
            Self::Equality => "equality",
            Self::Key => "key",
            Self::Actuator => "actuator",
            Self::Sensor => "sensor",
            Self::Spring => "spring",
            Self::Damper => "damper",
            Self::FrictionLoss => "friction loss",
            Self::Limit => "limit",
            Self::TendonSpring => "tendon spring",
            Self::TendonDamper => "tendon damper",
            Self::TendonFriction => "tendon friction loss",
            Self::TendonLimit => "tendon limit",
            Self::Inertia => "inertia",
            Self::JointForce => "qfrc_applied",
            Self::BodyForce => "xfrc_applied",
            Self::Gravity => "gravity",
            Self::Fluid => "fluid",
            Self::GravityCompensation => "gravity compensation",
            Self::Spin => "spin",
            Self::Connect => "connect",
            Self::Weld => "weld",
            Self::JointEquality => "joint equality",
            Self::TendonEquality => "tendon equality",
            Self::Contact => "contact",
        }
    }
}

/// One element of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Element {
    pub kind: Kind,
    /// Its place in the list that its kind belongs to; see `Kind`.
    pub index: u64,
    /// The number of its part; `Element::WHOLE`: all of it.
    pub part: u32,
}

impl Element {
    /// The part that means the whole element.
    pub const WHOLE: u32 = u32::MAX;

    pub const GRAVITY: Self = Self { kind: Kind::Gravity, index: 0, part: Self::WHOLE };

    /// Returns the whole of an element.
    pub fn whole(kind: Kind, index: usize) -> Self {
        Self { kind, index: index as u64, part: Self::WHOLE }
    }

    pub fn part(kind: Kind, index: usize, part: usize) -> Self {
        Self { kind, index: index as u64, part: part as u32 }
    }

    /// Returns the element of which this is a part.
    pub fn of_part(self) -> Self {
        Self { part: Self::WHOLE, ..self }
    }
}
