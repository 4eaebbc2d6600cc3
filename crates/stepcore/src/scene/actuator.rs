//! Actuators.

use super::{Coefficients, NONE};
use crate::real::Constant;

/// A motor, a servo or a muscle. Its force is gain·u + bias: u is the control, or the activation if
/// there is one; gain and bias depend on the length along which it pulls and on the rate of that,
/// both of them times the gear. The target receives gear × force.
#[derive(Clone, Debug, PartialEq)]
pub struct Actuator<N = f64> {
    pub name: String,
    pub target: Target,
    /// Only the first for a hinge, a slide, a tendon and a crank; for a ball an axis; for a free
    /// joint and for a site a direction and an axis.
    pub gear: [N; 6],
    /// gain = g₀ + g₁·length + g₂·velocity; bias likewise. A motor: 1, and zeros. A position servo:
    /// kp, and 0, −kp, −kv. A velocity servo: kv, and 0, 0, −kv.
    pub gain: [N; 3],
    pub bias: [N; 3],
    /// Instead of these: the force of a muscle.
    pub muscle_gain: Option<Muscle<N>>,
    pub muscle_bias: Option<Muscle<N>>,
    /// Not 0: bias₂ is −2·dampratio·√(kp·m), m being the inertia that the actuator moves at
    /// the initial configuration, and is filled in when the scene is compiled.
    pub dampratio: f64,
    /// Instead of the gain: a controller, with kp = −bias₁ and kv = −bias₂.
    pub controller: Option<Controller>,
    /// Set for one of three that turn a ball together, with kp = −bias₁ and kv = −bias₂.
    pub orientation: Option<Orientation>,
    /// The role of its control in a controller; and the index of that controller's actuator, if it
    /// is another one: this one then makes no force itself.
    pub input: Input,
    pub feeds: Option<usize>,
    /// Whether it has an activation, and how that follows the control.
    pub dynamics: Dynamics,
    /// For a filter: its time constant [s]. For a muscle: those for activation and deactivation
    /// [s], and the width of control over which one becomes the other.
    pub dynprm: [N; 3],
    /// Bounds of the control, of the activation, and of the force before the gear. None: none.
    pub ctrlrange: Option<[N; 2]>,
    pub actrange: Option<[N; 2]>,
    pub forcerange: Option<[N; 2]>,
    /// Whether the force uses the activation at the end of the step.
    pub actearly: bool,
    /// The least and greatest possible length, to which muscles refer.
    pub lengthrange: [N; 2],
    /// Added, times gear², to the joint or tendon that it pulls.
    pub damping: Coefficients<N>,
    pub armature: N,
    /// The age of the control that it uses [s], and the number of samples; 0: the present one.
    pub delay: f64,
    pub nsample: usize,
    pub interp: Interp,
    /// False: it is left out (MJCF's `actuatorgroupdisable`).
    pub enabled: bool,
}

/// The target that an actuator pulls, by index.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// The axes of a ball or a free joint's rotation are its body's.
    Joint(usize),
    /// The axes are the joint's parent frame's.
    InParent(usize),
    Tendon(usize),
    /// In the axes of the site; with a reference in the reference's axes, and measured from it.
    Site {
        site: usize,
        reference: Option<usize>,
    },
    /// A rod of some length [m] from a site to another, which slides along its z axis.
    Crank {
        crank: usize,
        slider: usize,
        rod: f64,
    },
    /// The contacts of a body, which it pulls together along their normals.
    Body(usize),
}

/// How an activation w follows the control u.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Dynamics {
    /// There is none: the force follows the control.
    #[default]
    None,
    /// ẇ = u
    Integrator,
    /// ẇ = (u − w)/τ
    Filter,
    /// The same, but a step is the exact solution.
    FilterExact,
    /// A filter whose time constant depends on w, and on whether it grows.
    Muscle,
}

/// The value of a control between two samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Interp {
    /// The earlier one.
    #[default]
    Hold,
    Linear,
    /// Catmull-Rom.
    Cubic,
}

/// A muscle as MuJoCo describes it (documentation, "Muscle actuators").
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Muscle<N = f64> {
    /// The operating range of lengths, of the optimal length.
    pub range: [f64; 2],
    /// Peak force [N]; negative: `scale` over the acceleration that a unit force gives at the
    /// initial configuration, filled in when the scene is compiled.
    pub force: N,
    pub scale: f64,
    /// Lengths beyond which it does not pull; the fastest shortening [1/s].
    pub lmin: f64,
    pub lmax: f64,
    pub vmax: f64,
    /// Passive force at lmax and active force while it lengthens, relative to the peak force.
    pub fpmax: f64,
    pub fvmax: f64,
}

/// The role of a control in a controller: a target of length or velocity, an additional force, a
/// voltage; or a part of the orientation that a servo turns to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Input {
    #[default]
    Pos,
    Vel,
    Ff,
    Voltage,
    X,
    Y,
    Z,
    W,
}

impl Input {
    /// Its place among the inputs of its actuator.
    pub fn slot(self) -> usize {
        match self {
            Self::Pos | Self::X => 0,
            Self::Vel | Self::Y => 1,
            Self::Ff | Self::Z => 2,
            Self::Voltage | Self::W => 3,
        }
    }
}

/// An axis of a servo that turns a ball to an orientation; the first of its three feeds none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Orientation {
    /// The axis of the body about which it turns.
    pub axis: usize,
    /// The controls are a quaternion, w first; else a rotation vector.
    pub quat: bool,
}

/// A controller as MuJoCo's `pid` and `dcmotor` describe it. It has an activation for each of its
/// features with a memory, in the order of `elements::controller`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Controller {
    /// Gain of the integral of the error, and the bound of the integral; 0: there is none.
    pub ki: f64,
    pub imax: f64,
    /// The largest speed of the first target [1/s]; 0: it moves at once.
    pub slewmax: f64,
    /// The motor that makes the controller's force; None: it makes it itself.
    pub motor: Option<Motor>,
}

/// A motor: 0 means without, unless stated otherwise.
#[derive(Clone, Debug, PartialEq)]
pub struct Motor {
    /// Force per current, which is voltage per velocity.
    pub constant: f64,
    pub resistance: f64,
    pub inductance: f64,
    /// Bounds of the controller's voltage, and of the rate of the current.
    pub vmax: f64,
    pub current_rate: f64,
    /// From the winding to its surroundings: resistance, heat capacity; then the increase of the
    /// electrical resistance with each degree, the temperature at which it starts, and the
    /// temperature of the surroundings.
    pub thermal: Option<[f64; 5]>,
    /// Amplitude, periods in a unit of length, phase.
    pub cogging: [f64; 3],
    /// Stiffness and damping of bristles, the friction at speed and at rest, and the speed at which
    /// one becomes the other (LuGre).
    pub lugre: Option<[f64; 5]>,
}

impl Controller {
    /// Which activations it has, in their order: a target, an integral, a temperature, a deflection
    /// of bristles, a current.
    pub fn remembers(&self) -> [bool; 5] {
        let [thermal, lugre, inductance] = self.motor.as_ref().map_or([false; 3], |motor| {
            [motor.thermal.is_some(), motor.lugre.is_some(), motor.inductance > 0.0]
        });
        [self.slewmax > 0.0, self.ki != 0.0, thermal, lugre, inductance]
    }
}

impl Dynamics {
    /// How many activations it has.
    pub fn count(self) -> usize {
        usize::from(self != Self::None)
    }
}

impl Default for Actuator {
    fn default() -> Self {
        Self {
            name: String::new(),
            target: Target::Joint(0),
            gear: [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            gain: [1.0, 0.0, 0.0],
            bias: [0.0; 3],
            muscle_gain: None,
            muscle_bias: None,
            dampratio: 0.0,
            controller: None,
            orientation: None,
            input: Input::Pos,
            feeds: None,
            dynamics: Dynamics::None,
            dynprm: [1.0, 0.0, 0.0],
            ctrlrange: None,
            actrange: None,
            forcerange: None,
            actearly: false,
            lengthrange: [0.0; 2],
            damping: NONE,
            armature: 0.0,
            delay: 0.0,
            nsample: 0,
            interp: Interp::Hold,
            enabled: true,
        }
    }
}

impl<N: Constant> Actuator<N> {
    /// The number of past controls that it keeps, which are the ones it reads.
    pub fn history(&self) -> usize {
        if self.delay > 0.0 {
            self.nsample
        } else {
            0
        }
    }

    /// Whether its controller gets its force from a motor.
    pub fn drives_motor(&self) -> bool {
        self.controller.as_ref().is_some_and(|own| own.motor.is_some())
    }

    /// How many activations it has.
    pub fn states(&self) -> usize {
        let of = |own: &Controller| own.remembers().into_iter().filter(|kept| *kept).count();
        self.controller.as_ref().map_or(self.dynamics.count(), of)
    }

    /// Whether its force depends on a length or its rate.
    pub fn feeds_back(&self) -> bool {
        let depends = |term: &[N; 3]| !(term[1].vanishes() && term[2].vanishes());
        self.drives_motor() || self.is_muscle() || depends(&self.bias) || depends(&self.gain)
    }

    pub fn is_muscle(&self) -> bool {
        self.muscle_gain.is_some() || self.muscle_bias.is_some()
    }
}

impl Actuator {
    /// Whether its control is a length: gain · (u − length), up to a constant.
    pub fn holds_a_length(&self) -> bool {
        let fixed = self.gain[1] == 0.0 && self.gain[2] == 0.0 && !self.is_muscle();
        fixed && self.orientation.is_none() && self.gain[0] != 0.0 && self.gain[0] == -self.bias[1]
    }
}
