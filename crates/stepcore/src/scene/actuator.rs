//! Actuators.

use super::{Coefficients, NONE};
use crate::real::Constant;

/// A motor, a servo or a muscle. Its force is gain·u + bias: u is the control, or the activation where
/// there is one; gain and bias depend on the length along which it pulls and on the rate of that, both
/// of them times the gear. What it pulls at feels gear × force.
#[derive(Clone, Debug, PartialEq)]
pub struct Actuator<N = f64> {
    pub name: String,
    pub target: Target,
    /// The first alone for a hinge, a slide, a tendon and a crank; of a ball an axis; of a free joint
    /// and of a site a direction and an axis.
    pub gear: [N; 6],
    /// gain = g₀ + g₁·length + g₂·velocity; bias likewise. A motor: 1, and zeros. A position servo:
    /// kp, and 0, −kp, −kv. A velocity servo: kv, and 0, 0, −kv.
    pub gain: [N; 3],
    pub bias: [N; 3],
    /// In place of these: the force of a muscle.
    pub muscle_gain: Option<Muscle<N>>,
    pub muscle_bias: Option<Muscle<N>>,
    /// Not 0: bias₂ is −2·dampratio·√(kp·m), m being the inertia that the actuator moves at
    /// the initial configuration, and is filled in when the scene is compiled.
    pub dampratio: f64,
    /// In place of the gain: a controller, of which kp is −bias₁ and kv −bias₂.
    pub controller: Option<Controller>,
    /// It is one of three that turn a ball together, kp being −bias₁ and kv −bias₂.
    pub orientation: Option<Orientation>,
    /// What its control is to a controller; and of which actuator's, where that is another one: it
    /// then makes no force itself.
    pub input: Input,
    pub feeds: Option<usize>,
    /// Whether it has an activation, and how that follows the control.
    pub dynamics: Dynamics,
    /// Of a filter: its time constant [s]. Of a muscle: those of activation and deactivation [s], and
    /// the width of control over which one becomes the other.
    pub dynprm: [N; 3],
    /// Bounds of the control, of the activation, and of the force before the gear. None: none.
    pub ctrlrange: Option<[N; 2]>,
    pub actrange: Option<[N; 2]>,
    pub forcerange: Option<[N; 2]>,
    /// The force is that of the activation at the end of the step.
    pub actearly: bool,
    /// The least and greatest length that it can have, which muscles refer to.
    pub lengthrange: [N; 2],
    /// Given, times gear², to the joint or tendon that it pulls at.
    pub damping: Coefficients<N>,
    pub armature: N,
    /// Its control is that of so long ago [s], kept in so many samples; 0: the present one.
    pub delay: f64,
    pub nsample: usize,
    pub interp: Interp,
    /// False: it is left out (MJCF's `actuatorgroupdisable`).
    pub enabled: bool,
}

/// What an actuator pulls at, by index.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// The axes of a ball or a free joint's rotation are those of its body.
    Joint(usize),
    /// The axes are those of the frame in which the joint stands.
    InParent(usize),
    Tendon(usize),
    /// In the axes of the site; with a reference in those of that, and measured from it.
    Site {
        site: usize,
        reference: Option<usize>,
    },
    /// A rod of some length [m] from a site to another, which slides along its own z axis.
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
    /// There is none: the force is that of the control.
    #[default]
    None,
    /// ẇ = u
    Integrator,
    /// ẇ = (u − w)/τ
    Filter,
    /// The same, a step being that of the exact solution.
    FilterExact,
    /// A filter whose time constant depends on w, and on whether it grows.
    Muscle,
}

/// What a control is between two samples.
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
    /// Peak force [N]; negative: `scale` over the acceleration that a unit force gives at the initial
    /// configuration, filled in when the scene is compiled.
    pub force: N,
    pub scale: f64,
    /// Lengths beyond which it does not pull; the fastest shortening [1/s].
    pub lmin: f64,
    pub lmax: f64,
    pub vmax: f64,
    /// Passive force at lmax and active force while it lengthens, of the peak force.
    pub fpmax: f64,
    pub fvmax: f64,
}

/// What a control is to a controller: a target of length or velocity, a force beside, a voltage; or a
/// part of the orientation that a servo turns to.
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
/// features that remembers something, in the order of `elements::controller`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Controller {
    /// Gain of the integral of the error, and the bound of that; 0: there is none.
    pub ki: f64,
    pub imax: f64,
    /// How fast the first target can move [1/s]; 0: at once.
    pub slewmax: f64,
    /// The controller asks this for its force; None: it makes it itself.
    pub motor: Option<Motor>,
}

/// A motor: 0 is without, where nothing else is said.
#[derive(Clone, Debug, PartialEq)]
pub struct Motor {
    /// Force per current, which is voltage per velocity.
    pub constant: f64,
    pub resistance: f64,
    pub inductance: f64,
    /// Bounds of the controller's voltage, and of the rate of the current.
    pub vmax: f64,
    pub current_rate: f64,
    /// Of the winding to its surroundings: resistance, heat capacity; then how much of the
    /// electrical resistance comes with each degree, from which temperature on, and what the
    /// surroundings have.
    pub thermal: Option<[f64; 5]>,
    /// Amplitude, periods in a unit of length, phase.
    pub cogging: [f64; 3],
    /// Stiffness and damping of bristles, the friction at speed and at rest, and the speed at which
    /// one becomes the other (LuGre).
    pub lugre: Option<[f64; 5]>,
}

impl Controller {
    /// Which activations it has, in their order: a target, an integral, a temperature, a deflection of
    /// bristles, a current.
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
    /// How many past controls it keeps: those that it reads.
    pub fn history(&self) -> usize {
        if self.delay > 0.0 {
            self.nsample
        } else {
            0
        }
    }

    /// Its controller asks a motor for its force.
    pub fn drives_motor(&self) -> bool {
        self.controller.as_ref().is_some_and(|own| own.motor.is_some())
    }

    /// How many activations it has.
    pub fn states(&self) -> usize {
        let of = |own: &Controller| own.remembers().into_iter().filter(|kept| *kept).count();
        self.controller.as_ref().map_or(self.dynamics.count(), of)
    }

    /// Its force depends on a length, or how fast that changes.
    pub fn feeds_back(&self) -> bool {
        let depends = |term: &[N; 3]| !(term[1].vanishes() && term[2].vanishes());
        self.drives_motor() || self.is_muscle() || depends(&self.bias) || depends(&self.gain)
    }

    pub fn is_muscle(&self) -> bool {
        self.muscle_gain.is_some() || self.muscle_bias.is_some()
    }
}

impl Actuator {
    /// Its control is a length: gain · (u − length), but for a constant.
    pub fn holds_a_length(&self) -> bool {
        let fixed = self.gain[1] == 0.0 && self.gain[2] == 0.0 && !self.is_muscle();
        fixed && self.orientation.is_none() && self.gain[0] != 0.0 && self.gain[0] == -self.bias[1]
    }
}
