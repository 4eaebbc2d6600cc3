//! Actuators.

/// A motor or a servo. Its force is gain·u + bias₀ + bias₁·length + bias₂·velocity, with
/// length = gear·q and velocity = gear·v of a hinge or a slide; the joint feels gear × force. u is
/// the control, or the activation where there is one.
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
    /// Whether it has an activation, and how that follows the control.
    pub dynamics: Dynamics,
    /// Of a filter: its time constant [s].
    pub dynprm: [f64; 3],
    /// Bounds of the control, of the activation, and of the force before the gear. None: none.
    pub ctrlrange: Option<[f64; 2]>,
    pub actrange: Option<[f64; 2]>,
    pub forcerange: Option<[f64; 2]>,
    /// The force is that of the activation at the end of the step.
    pub actearly: bool,
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
            joint: 0,
            gear: [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            gain: 1.0,
            bias: [0.0; 3],
            dampratio: 0.0,
            dynamics: Dynamics::None,
            dynprm: [1.0, 0.0, 0.0],
            ctrlrange: None,
            actrange: None,
            forcerange: None,
            actearly: false,
        }
    }
}

impl Actuator {
    /// Its force depends on where its joint is, or how fast.
    pub fn feeds_back(&self) -> bool {
        self.bias[1] != 0.0 || self.bias[2] != 0.0
    }
}
