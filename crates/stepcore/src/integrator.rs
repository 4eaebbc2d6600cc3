//! The integrators, each a value that describes its behaviour. All code reads that value, and none
//! compares names.

pub mod linear_map;

use crate::named::named;

/// The points of a step at which an integrator evaluates the forces.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stages {
    /// Once, at its start.
    Start,
    /// In its middle, whose velocity an iteration finds: `commit/midpoint.rs`.
    Middle,
    /// At the four stages of `commit/rk4.rs`.
    Four,
}

/// The elements whose damping is evaluated at the end of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Late {
    /// Dampers of joints, unless MJCF's `eulerdamp` is off.
    Joints,
    All,
}

/// The bias forces whose derivative by the velocities is evaluated at the end of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turning {
    /// Bias forces of single free bodies: `commit/damped.rs`.
    FreeBodies,
    /// Bias forces of all trees: `commit/implicit.rs`.
    Trees,
}

/// The rows that act at the stages of a step; the rest act after them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inside {
    /// None: the motion of the stages is smooth.
    Nothing,
    /// Equalities hold at every stage, as accelerations, so that the integrator has its order for
    /// the motion on them.
    Equalities,
    /// Every row, and the springs of law `penalty`.
    All,
}

/// The step of a linear motion x' = J x: `linear_map.rs`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Map {
    /// The series of exp(dt J) up to this power.
    Taylor(u32),
    /// (1 − dt J/2)⁻¹ (1 + dt J/2).
    Cayley,
    /// Velocities first, then positions by the new ones.
    Split,
}

/// The behaviour of an integrator.
#[derive(Clone, Copy, Debug)]
pub struct Scheme {
    pub stages: Stages,
    /// The rows that act at its stages under law `solref`.
    pub inside: Inside,
    /// Whether positions move by the velocities at the start of the step.
    pub moves_first: bool,
    pub damping: Option<Late>,
    pub turning: Option<Turning>,
    /// Whether stiffness is evaluated at the end of the step too, and rows are solved in
    /// M + dt·D + dt²·K: `place/effective.rs`.
    pub stiffness: bool,
    pub map: Map,
}

impl Scheme {
    /// Every force at the start of the step, then positions by the new velocities.
    const PLAIN: Self = Self {
        stages: Stages::Start,
        inside: Inside::Nothing,
        moves_first: false,
        damping: None,
        turning: None,
        stiffness: false,
        map: Map::Split,
    };

    /// Returns the damping that is evaluated at the end of a step, for a model with or without
    /// `eulerdamp`.
    pub fn late(&self, eulerdamp: bool) -> Option<Late> {
        self.damping.filter(|late| *late == Late::All || eulerdamp)
    }
}

/// The one list of integrators.
macro_rules! integrators {
    ($($(#[$doc:meta])* $variant:ident = $text:literal: { $($field:ident: $value:expr),* $(,)? })+) => {
        named!(
            /// How velocities and positions advance. Formulas: the files of `commit/`.
            Integrator, "integrator" { $($(#[$doc])* $variant = $text),+ }
        );

        impl Integrator {
            pub const fn scheme(self) -> &'static Scheme {
                match self {
                    $(Self::$variant => &Scheme { $($field: $value,)* ..Scheme::PLAIN }),+
                }
            }
        }
    };
}

integrators!(
    /// Positions move by the old velocity.
    Explicit = "explicit": { moves_first: true, map: Map::Taylor(1) }
    /// Positions move by the new velocity.
    SemiImplicit = "semi-implicit": {}
    /// MuJoCo's Euler: semi-implicit, joint damping implicit.
    Euler = "euler": { damping: Some(Late::Joints) }
    /// MuJoCo's implicitfast: velocity derivatives implicit, symmetrised.
    ImplicitFast = "implicitfast": { damping: Some(Late::All), turning: Some(Turning::FreeBodies) }
    /// MuJoCo's implicit: Coriolis and centrifugal forces too, unsymmetric.
    Implicit = "implicit": { damping: Some(Late::All), turning: Some(Turning::Trees) }
    /// Rows solved in the metric M + dt·D + dt²·K, in which stiffness and damping are implicit.
    Discrete = "discrete": {
        damping: Some(Late::All),
        turning: Some(Turning::FreeBodies),
        stiffness: true,
    }
    /// Implicit midpoint, solved to rounding.
    Midpoint = "midpoint": {
        stages: Stages::Middle,
        inside: Inside::Equalities,
        map: Map::Cayley,
    }
    /// Classical Runge-Kutta of fourth order.
    Rk4 = "rk4": { stages: Stages::Four, inside: Inside::All, map: Map::Taylor(4) }
);
