//! `Scene`: the description of a model, as the user wrote it. Compiling it gives a `Model`.
//!
//! Plain data in SI units, angles in radians, quaternions w x y z. Index 0 of `bodies` is the
//! world. A parent comes before its children.

mod actuator;
mod body;
mod contact;
mod equality;
mod geom;
mod joint;
mod sensor;
mod site;
mod softness;
mod tendon;

pub use crate::assets::{HField, Mesh, MeshInertia};
pub use actuator::{
    Actuator, Controller, Dynamics, Input, Interp, Motor, Muscle, Orientation, Target,
};
pub use body::{Body, Inertial, MassRules, SleepPolicy};
pub use contact::{ContactOverride, ExplicitPair};
pub use equality::{Equality, EqualityType, Frame};
pub use geom::{FluidShape, Geom, GeomType};
pub use joint::{Coefficients, Joint, JointType, NONE};
pub use sensor::{ObjectType, Reduce, Sensor, SensorField, SensorObject, SensorType};
pub use site::Site;
pub use softness::Softness;
pub use tendon::{Stop, Tendon, AUTOMATIC};

/// A keyframe: a named state. None: qpos0, and zeros.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Key {
    pub name: String,
    pub time: f64,
    pub qpos: Option<Vec<f64>>,
    pub qvel: Option<Vec<f64>>,
    pub act: Option<Vec<f64>>,
    pub ctrl: Option<Vec<f64>>,
    /// Poses of mocap bodies.
    pub mpos: Option<Vec<f64>>,
    pub mquat: Option<Vec<f64>>,
}

/// Parts of the model that can be switched off: MJCF's flags of that name, and `coriolis`.
#[derive(Clone, Debug, PartialEq)]
pub struct Features {
    pub constraint: bool,
    pub equality: bool,
    pub frictionloss: bool,
    pub limit: bool,
    pub contact: bool,
    pub spring: bool,
    pub damper: bool,
    pub gravity: bool,
    pub clampctrl: bool,
    pub actuation: bool,
    pub filterparent: bool,
    /// MJCF's `eulerdamp`: the `euler` integrator treats joint damping implicitly.
    pub eulerdamp: bool,
    /// MJCF's `sensor`: without it sensors read zero.
    pub sensor: bool,
    /// Coriolis, centrifugal and gyroscopic forces. MJCF has no flag for them: they are off only to
    /// measure their effect.
    pub coriolis: bool,
}

impl Features {
    /// MJCF's flags `spring` and `damper`, both off, switch all passive forces off.
    pub fn passive(&self) -> bool {
        self.spring || self.damper
    }
}

impl Default for Features {
    fn default() -> Self {
        Self {
            constraint: true,
            equality: true,
            frictionloss: true,
            limit: true,
            contact: true,
            spring: true,
            damper: true,
            gravity: true,
            clampctrl: true,
            actuation: true,
            filterparent: true,
            eulerdamp: true,
            sensor: true,
            coriolis: true,
        }
    }
}

/// Everything that is modelled. Elements of one kind are in the order of their bodies.
#[derive(Clone, Debug)]
pub struct Scene {
    pub name: String,
    /// [m/s²]
    pub gravity: [f64; 3],
    /// Density [kg/m³], viscosity [Pa·s] and velocity [m/s] of the fluid around the bodies.
    pub density: f64,
    pub viscosity: f64,
    pub wind: [f64; 3],
    /// Magnetic flux, for magnetometers [T].
    pub magnetic: [f64; 3],
    pub bodies: Vec<Body>,
    pub joints: Vec<Joint>,
    pub geoms: Vec<Geom>,
    pub meshes: Vec<Mesh>,
    pub hfields: Vec<HField>,
    pub sites: Vec<Site>,
    pub tendons: Vec<Tendon>,
    pub sensors: Vec<Sensor>,
    pub actuators: Vec<Actuator>,
    pub equalities: Vec<Equality>,
    pub keys: Vec<Key>,
    /// Pairs of bodies that never collide, except explicit pairs of their geoms.
    pub excludes: Vec<[usize; 2]>,
    pub pairs: Vec<ExplicitPair>,
    pub contact_override: Option<ContactOverride>,
    pub mass_rules: MassRules,
    pub features: Features,
}

impl Default for Scene {
    fn default() -> Self {
        Self {
            name: String::new(),
            gravity: [0.0, 0.0, -9.81],
            density: 0.0,
            viscosity: 0.0,
            wind: [0.0; 3],
            magnetic: [0.0, -0.5, 0.0],
            bodies: vec![Body { name: "world".into(), ..Body::default() }],
            joints: vec![],
            geoms: vec![],
            meshes: vec![],
            hfields: vec![],
            sites: vec![],
            tendons: vec![],
            sensors: vec![],
            actuators: vec![],
            equalities: vec![],
            keys: vec![],
            excludes: vec![],
            pairs: vec![],
            contact_override: None,
            mass_rules: MassRules::default(),
            features: Features::default(),
        }
    }
}
