//! `Scene`: what is modelled, as the user wrote it. Compiling it gives a `Model`.
//!
//! Plain data in SI units, angles in radians, quaternions w x y z. Index 0 of
//! `bodies` is the world. A parent stands before its children.

/// A spring-damper pair and an impedance curve: MuJoCo's `solref`, `solimp`.
#[derive(Clone, Debug, PartialEq)]
pub struct Softness {
    pub solref: [f64; 2],
    pub solimp: [f64; 5],
}

impl Default for Softness {
    fn default() -> Self {
        Self { solref: [0.02, 1.0], solimp: [0.9, 0.95, 0.001, 0.5, 2.0] }
    }
}

/// A mass with its centre and its inertia about that centre, in body axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Inertial {
    pub mass: f64,
    pub pos: [f64; 3],
    /// xx, yy, zz, xy, xz, yz [kg·m²].
    pub inertia: [f64; 6],
}

#[derive(Clone, Debug, PartialEq)]
pub struct Body {
    pub name: String,
    pub parent: usize,
    pub pos: [f64; 3],
    pub quat: [f64; 4],
    /// None: taken from the geoms.
    pub inertial: Option<Inertial>,
}

impl Default for Body {
    fn default() -> Self {
        Self {
            name: String::new(),
            parent: 0,
            pos: [0.0; 3],
            quat: [1.0, 0.0, 0.0, 0.0],
            inertial: None,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointType {
    Free,
    Ball,
    Slide,
    Hinge,
}

impl JointType {
    /// Entries of qpos.
    pub fn positions(self) -> usize {
        match self {
            Self::Free => 7,
            Self::Ball => 4,
            Self::Slide | Self::Hinge => 1,
        }
    }
    /// Entries of qvel.
    pub fn dofs(self) -> usize {
        match self {
            Self::Free => 6,
            Self::Ball => 3,
            Self::Slide | Self::Hinge => 1,
        }
    }
    /// Changes the orientation of its body.
    pub fn turns(self) -> bool {
        self != Self::Slide
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    pub name: String,
    pub body: usize,
    pub kind: JointType,
    pub pos: [f64; 3],
    pub axis: [f64; 3],
    /// Lower and upper bound; a ball joint uses the upper one. None: no limit.
    pub range: Option<[f64; 2]>,
    pub margin: f64,
    pub reference: f64,
    pub springref: f64,
    pub stiffness: f64,
    pub damping: f64,
    pub armature: f64,
    pub frictionloss: f64,
    pub limit: Softness,
    pub friction: Softness,
}

impl Default for Joint {
    fn default() -> Self {
        Self {
            name: String::new(),
            body: 0,
            kind: JointType::Hinge,
            pos: [0.0; 3],
            axis: [0.0, 0.0, 1.0],
            range: None,
            margin: 0.0,
            reference: 0.0,
            springref: 0.0,
            stiffness: 0.0,
            damping: 0.0,
            armature: 0.0,
            frictionloss: 0.0,
            limit: Softness::default(),
            friction: Softness::default(),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum GeomType {
    Plane,
    Sphere,
    Capsule,
    Ellipsoid,
    Cylinder,
    Box,
}

#[derive(Clone, Debug, PartialEq)]
pub struct Geom {
    pub name: String,
    pub body: usize,
    pub kind: GeomType,
    /// MuJoCo's sizes: sphere r; capsule and cylinder r, half length; box and
    /// ellipsoid half sizes; plane half sizes (0: infinite), spacing.
    pub size: [f64; 3],
    pub pos: [f64; 3],
    pub quat: [f64; 4],
    /// None: density × volume.
    pub mass: Option<f64>,
    pub density: f64,
    pub shell_inertia: bool,
    pub group: i32,
    pub contype: u32,
    pub conaffinity: u32,
    pub condim: u32,
    pub priority: i32,
    pub friction: [f64; 3],
    pub margin: f64,
    pub gap: f64,
    pub solmix: f64,
    pub soft: Softness,
}

impl Default for Geom {
    fn default() -> Self {
        Self {
            name: String::new(),
            body: 0,
            kind: GeomType::Sphere,
            size: [0.0; 3],
            pos: [0.0; 3],
            quat: [1.0, 0.0, 0.0, 0.0],
            mass: None,
            density: 1000.0,
            shell_inertia: false,
            group: 0,
            contype: 1,
            conaffinity: 1,
            condim: 3,
            priority: 0,
            friction: [1.0, 0.005, 0.0001],
            margin: 0.0,
            gap: 0.0,
            solmix: 1.0,
            soft: Softness::default(),
        }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Site {
    pub name: String,
    pub body: usize,
    pub pos: [f64; 3],
    pub quat: [f64; 4],
}

/// A motor: a force along one joint, gear × control.
#[derive(Clone, Debug, PartialEq)]
pub struct Actuator {
    pub name: String,
    pub joint: usize,
    pub gear: [f64; 6],
    pub ctrlrange: Option<[f64; 2]>,
    pub forcerange: Option<[f64; 2]>,
}

/// Two bodies share one point: MuJoCo's `connect`.
#[derive(Clone, Debug, PartialEq)]
pub struct Equality {
    pub name: String,
    pub body1: usize,
    pub body2: usize,
    /// The point, in the frame of `body1`, at the initial configuration.
    pub anchor: [f64; 3],
    pub active: bool,
    pub soft: Softness,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Key {
    pub name: String,
    pub time: f64,
    pub qpos: Option<Vec<f64>>,
    pub qvel: Option<Vec<f64>>,
    pub ctrl: Option<Vec<f64>>,
}

/// How masses are made from geoms: MJCF's `compiler` element.
#[derive(Clone, Debug, PartialEq)]
pub struct MassRules {
    /// Some(true): always from geoms; Some(false): never; None: where no inertial is given.
    pub from_geoms: Option<bool>,
    pub group_range: [i32; 2],
    pub bound_mass: f64,
    pub bound_inertia: f64,
    pub balance_inertia: bool,
    /// Scale all masses and inertias to this total; not positive: leave them.
    pub total_mass: f64,
}

impl Default for MassRules {
    fn default() -> Self {
        Self {
            from_geoms: None,
            group_range: [0, 5],
            bound_mass: 0.0,
            bound_inertia: 0.0,
            balance_inertia: false,
            total_mass: -1.0,
        }
    }
}

/// What MJCF's flags switch off in the model itself.
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
        }
    }
}

#[derive(Clone, Debug)]
pub struct Scene {
    pub name: String,
    pub gravity: [f64; 3],
    pub bodies: Vec<Body>,
    pub joints: Vec<Joint>,
    pub geoms: Vec<Geom>,
    pub sites: Vec<Site>,
    pub actuators: Vec<Actuator>,
    pub equalities: Vec<Equality>,
    pub keys: Vec<Key>,
    /// Pairs of bodies that never collide.
    pub excludes: Vec<[usize; 2]>,
    pub mass_rules: MassRules,
    pub features: Features,
}

impl Default for Scene {
    fn default() -> Self {
        Self {
            name: String::new(),
            gravity: [0.0, 0.0, -9.81],
            bodies: vec![Body { name: "world".into(), ..Body::default() }],
            joints: vec![],
            geoms: vec![],
            sites: vec![],
            actuators: vec![],
            equalities: vec![],
            keys: vec![],
            excludes: vec![],
            mass_rules: MassRules::default(),
            features: Features::default(),
        }
    }
}
