//! `Scene`: what is modelled, as the user wrote it. Compiling it gives a `Model`.
//!
//! Plain data in SI units, angles in radians, quaternions w x y z. Index 0 of
//! `bodies` is the world. A parent stands before its children.

pub use crate::assets::{HField, Mesh, MeshInertia};

/// A spring-damper pair and an impedance curve: MuJoCo's `solref`, `solimp`.
/// MuJoCo documentation, "Solver parameters".
#[derive(Clone, Debug, PartialEq)]
pub struct Softness {
    /// Time constant [s] and damping ratio, both > 0; or −stiffness and −damping, both ≤ 0.
    pub solref: [f64; 2],
    /// d0, dwidth, width [m or rad], midpoint, power.
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
    /// [kg]
    pub mass: f64,
    /// Centre of mass [m].
    pub pos: [f64; 3],
    /// xx, yy, zz, xy, xz, yz [kg·m²].
    pub inertia: [f64; 6],
}

/// A rigid body, fixed to its parent but for its joints.
#[derive(Clone, Debug, PartialEq)]
pub struct Body {
    pub name: String,
    pub parent: usize,
    /// Frame in the parent's [m], w x y z, at the initial configuration.
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

/// What a joint lets its body do.
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

/// Coefficients a, b, c of a polynomial force by the powers of what it answers to, the first
/// power first: MuJoCo's, see `elements/spring.rs` and `elements/damper.rs`.
pub type Coefficients = [f64; 3];

/// No force.
pub const NONE: Coefficients = [0.0; 3];

/// Dofs between a body and its parent. Lengths in m, angles in rad; forces in N or N·m by
/// the kind of joint.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    pub name: String,
    pub body: usize,
    pub kind: JointType,
    /// Anchor and axis in the body's frame.
    pub pos: [f64; 3],
    pub axis: [f64; 3],
    /// Lower and upper bound; a ball joint uses the upper one. None: no limit.
    pub range: Option<[f64; 2]>,
    /// A limit is a row from this distance on.
    pub margin: f64,
    /// qpos at the initial configuration, and where the spring is at rest.
    pub reference: f64,
    pub springref: f64,
    pub stiffness: Coefficients,
    pub damping: Coefficients,
    /// Inertia added to the dof itself [kg or kg·m²].
    pub armature: f64,
    /// Dry friction: the largest force.
    pub frictionloss: f64,
    /// Of the limit's rows, and of the friction loss.
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
            stiffness: NONE,
            damping: NONE,
            armature: 0.0,
            frictionloss: 0.0,
            limit: Softness::default(),
            friction: Softness::default(),
        }
    }
}

/// Shapes, in MuJoCo's order: it decides which of a pair is geom 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum GeomType {
    Plane,
    HField,
    Sphere,
    Capsule,
    Ellipsoid,
    Cylinder,
    Box,
    Mesh,
}

impl GeomType {
    /// The word that a scene uses for it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Plane => "plane",
            Self::HField => "hfield",
            Self::Sphere => "sphere",
            Self::Capsule => "capsule",
            Self::Ellipsoid => "ellipsoid",
            Self::Cylinder => "cylinder",
            Self::Box => "box",
            Self::Mesh => "mesh",
        }
    }

    /// How far the surface of this size is from the core that it rounds off [m]: a sphere's
    /// centre, a capsule's axis.
    pub fn roundness(self, size: &[f64; 3]) -> f64 {
        if matches!(self, Self::Sphere | Self::Capsule) {
            size[0]
        } else {
            0.0
        }
    }
}

/// A shape on a body: it collides, and gives mass where the body has no `Inertial`.
#[derive(Clone, Debug, PartialEq)]
pub struct Geom {
    pub name: String,
    pub body: usize,
    pub kind: GeomType,
    /// MuJoCo's sizes: sphere r; capsule and cylinder r, half length; box and
    /// ellipsoid half sizes; plane half sizes (0: infinite), spacing.
    pub size: [f64; 3],
    /// Frame in the body's [m], w x y z.
    pub pos: [f64; 3],
    pub quat: [f64; 4],
    /// Into `Scene::meshes`: what it is, or what a primitive is fitted to (`size` is then found).
    pub mesh: Option<usize>,
    /// Of a primitive fitted to a mesh: its size in parts of what fits.
    pub fitscale: f64,
    /// Into `Scene::hfields`.
    pub hfield: Option<usize>,
    /// [kg]; None: density × volume.
    pub mass: Option<f64>,
    /// [kg/m³], or [kg/m²] of a shell.
    pub density: f64,
    /// The mass is on the surface.
    pub shell_inertia: bool,
    /// Only groups in `MassRules::group_range` give mass.
    pub group: i32,
    /// Two geoms collide where one's contype shares a bit with the other's conaffinity.
    pub contype: u32,
    pub conaffinity: u32,
    /// Dimensions of a contact's force: 1 normal, 3 with sliding friction,
    /// 4 with torsion as well, 6 with rolling as well.
    pub condim: u32,
    /// The geom of higher priority decides a contact's condim, friction and softness.
    pub priority: i32,
    /// Sliding [1], torsional [m], rolling [m].
    pub friction: [f64; 3],
    /// A contact has rows below the sum of both margins [m] and is listed up to the sum of
    /// both gaps above that.
    pub margin: f64,
    pub gap: f64,
    /// Weight of this geom's softness in the mixture of two.
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
            mesh: None,
            fitscale: 1.0,
            hfield: None,
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

/// A named frame on a body [m], w x y z.
#[derive(Clone, Debug, PartialEq)]
pub struct Site {
    pub name: String,
    pub body: usize,
    pub pos: [f64; 3],
    pub quat: [f64; 4],
}

/// A motor or a servo. Its force is gain·ctrl + bias₀ + bias₁·length + bias₂·velocity, with
/// length = gear·q and velocity = gear·v of a hinge or a slide; the joint feels gear × force.
#[derive(Clone, Debug, PartialEq)]
pub struct Actuator {
    pub name: String,
    pub joint: usize,
    /// By dof of the joint.
    pub gear: [f64; 6],
    /// A motor: 1 and zeros. A position servo: kp and 0, −kp, −kv. A velocity servo: kv and
    /// 0, 0, −kv. Feedback (bias₁, bias₂) on a ball or a free joint is not built.
    pub gain: f64,
    pub bias: [f64; 3],
    /// Not 0: bias₂ is −2·dampratio·√(kp·m), m being the inertia that the actuator moves at
    /// the initial configuration, and is filled in when the scene is compiled.
    pub dampratio: f64,
    /// Bounds of the control, and of the force before the gear. None: none.
    pub ctrlrange: Option<[f64; 2]>,
    pub forcerange: Option<[f64; 2]>,
}

impl Default for Actuator {
    fn default() -> Self {
        Self {
            name: String::new(),
            joint: 0,
            gear: [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            gain: 1.0,
            bias: [0.0; 3],
            dampratio: 0.0,
            ctrlrange: None,
            forcerange: None,
        }
    }
}

impl Actuator {
    /// Its force depends on where its joint is, or how fast.
    pub fn feeds_back(&self) -> bool {
        self.bias[1] != 0.0 || self.bias[2] != 0.0
    }
}

/// Two bodies share one point: MuJoCo's `connect`.
#[derive(Clone, Debug, PartialEq)]
pub struct Equality {
    pub name: String,
    pub body1: usize,
    pub body2: usize,
    /// The point [m], in the frame of `body1`, at the initial configuration.
    pub anchor: [f64; 3],
    pub active: bool,
    pub soft: Softness,
}

/// Two geoms that collide whatever their bodies, masks and excludes say, with contact parameters of
/// their own: MuJoCo's `pair`.
#[derive(Clone, Debug, PartialEq)]
pub struct ExplicitPair {
    pub name: String,
    pub geom1: usize,
    pub geom2: usize,
    pub condim: u32,
    /// Sliding along both tangents [1], torsional [m], rolling about both [m].
    pub friction: [f64; 5],
    /// A contact has rows below `margin` [m] and is listed up to `gap` above that.
    pub margin: f64,
    pub gap: f64,
    pub soft: Softness,
    /// The solref of the friction rows of a cone; None: that of `soft`.
    pub solreffriction: Option<[f64; 2]>,
}

impl Default for ExplicitPair {
    fn default() -> Self {
        Self {
            name: String::new(),
            geom1: 0,
            geom2: 0,
            condim: 3,
            friction: [1.0, 1.0, 0.005, 0.0001, 0.0001],
            margin: 0.0,
            gap: 0.0,
            soft: Softness::default(),
            solreffriction: None,
        }
    }
}

/// Contact parameters that replace those of every contact: MuJoCo's `o_margin` and its like.
#[derive(Clone, Debug, PartialEq)]
pub struct ContactOverride {
    pub margin: f64,
    pub friction: [f64; 5],
    pub soft: Softness,
}

/// A keyframe: a state by name. None: qpos0, and zeros.
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
    /// First and last group of geoms that give mass.
    pub group_range: [i32; 2],
    /// The least mass [kg] and principal moment [kg·m²] of a body.
    pub bound_mass: f64,
    pub bound_inertia: f64,
    /// Principal moments that no body can have become their mean, instead of an error.
    pub balance_inertia: bool,
    /// Scale all masses and inertias to this total [kg]; not positive: leave them.
    pub total_mass: f64,
    /// Primitives are fitted to the bounding boxes of meshes, not to boxes of the same inertia.
    pub fit_aabb: bool,
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
            fit_aabb: false,
        }
    }
}

/// What can be switched off in the model itself; but for `coriolis`, MJCF's flags of that name.
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
    /// Coriolis, centrifugal and gyroscopic forces. MJCF has no flag for them: they are off
    /// only where it is measured what they matter.
    pub coriolis: bool,
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
            coriolis: true,
        }
    }
}

/// Everything that is modelled. Elements of one kind stand in the order of their bodies.
#[derive(Clone, Debug)]
pub struct Scene {
    pub name: String,
    /// [m/s²]
    pub gravity: [f64; 3],
    pub bodies: Vec<Body>,
    pub joints: Vec<Joint>,
    pub geoms: Vec<Geom>,
    pub meshes: Vec<Mesh>,
    pub hfields: Vec<HField>,
    pub sites: Vec<Site>,
    pub actuators: Vec<Actuator>,
    pub equalities: Vec<Equality>,
    pub keys: Vec<Key>,
    /// Pairs of bodies that never collide, but for explicit pairs of their geoms.
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
            bodies: vec![Body { name: "world".into(), ..Body::default() }],
            joints: vec![],
            geoms: vec![],
            meshes: vec![],
            hfields: vec![],
            sites: vec![],
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
