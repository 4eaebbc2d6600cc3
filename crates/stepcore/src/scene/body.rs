//! Bodies, and how their masses are made.

/// A mass with its centre and its inertia about that centre, in body axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Inertial {
    /// [kg]
    pub mass: f64,
    /// Centre of mass [m].
    pub pos: [f64; 3],
    /// xx, yy, zz, xy, xz, yz [kg·m²].
    pub inertia: [f64; 6],
    /// The principal axes (w x y z, in body axes), which equal moments leave open; None: computed.
    pub axes: Option<[f64; 4]>,
}

/// Whether a tree may sleep, set at its root; see `sleep/`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SleepPolicy {
    /// Unless an actuator drives it, or a tendon that pulls ties it to another tree.
    #[default]
    Auto,
    Never,
    Allowed,
    /// Allowed, and it sleeps from the start.
    Init,
}

impl SleepPolicy {
    /// MJCF's name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Never => "never",
            Self::Allowed => "allowed",
            Self::Init => "init",
        }
    }
}

/// A rigid body, fixed to its parent except for its joints.
#[derive(Clone, Debug, PartialEq)]
pub struct Body {
    pub name: String,
    pub parent: usize,
    /// Frame in the parent's [m], w x y z, at the initial configuration.
    pub pos: [f64; 3],
    pub quat: [f64; 4],
    /// None: taken from the geoms.
    pub inertial: Option<Inertial>,
    /// The share of its weight that is compensated by a force at its centre of mass.
    pub gravcomp: f64,
    /// Its pose is an input: `Inputs::mocap_pos`, `Inputs::mocap_quat`.
    pub mocap: bool,
    /// The policy of a tree, at its root; `Auto` for every other body.
    pub sleep: SleepPolicy,
}

impl Default for Body {
    fn default() -> Self {
        Self {
            name: String::new(),
            parent: 0,
            pos: [0.0; 3],
            quat: [1.0, 0.0, 0.0, 0.0],
            inertial: None,
            gravcomp: 0.0,
            mocap: false,
            sleep: SleepPolicy::Auto,
        }
    }
}

/// How masses are made from geoms: MJCF's `compiler` element.
#[derive(Clone, Debug, PartialEq)]
pub struct MassRules {
    /// Some(true): always from geoms; Some(false): never; None: if no inertial is given.
    pub from_geoms: Option<bool>,
    /// First and last group of geoms that give mass.
    pub group_range: [i32; 2],
    /// The least mass [kg] and principal moment [kg·m²] of a body.
    pub bound_mass: f64,
    pub bound_inertia: f64,
    /// Principal moments that no body can have become their mean, instead of an error.
    pub balance_inertia: bool,
    /// Scales all masses and inertias to this total [kg]; leaves them if not positive.
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
