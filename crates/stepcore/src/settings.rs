//! `Settings`: the computation of a scene, and the overrides that change the model.

use crate::error::{Error, Result};
pub use crate::integrator::Integrator;
use crate::integrator::{Inside, Stages};
use crate::named::named;

named!(
    /// The method that solves the rows.
    Solver, "solver" {
        /// Projected Gauss-Seidel: `solve/pgs.rs`.
        Pgs = "pgs",
        /// Newton on the primal problem, for convex rows: `solve/newton.rs`.
        Newton = "newton",
    }
);
named!(
    /// The acceleration of projected Gauss-Seidel.
    Acceleration, "acceleration" {
        /// The lesson's method: rows in order.
        None = "none",
        /// Momentum over the last moves, with coefficients by minimisation; blocks in a shuffled order.
        Momentum = "momentum",
    }
);
named!(
    /// The rows of a violated constraint; see `solve/law.rs`.
    Law, "law" {
        /// MuJoCo's spring-damper and impedance, at the present positions.
        SolRef = "solref",
        /// Baumgarte's: softness is a regulariser.
        Lesson = "lesson",
        /// Softness only in the denominator of an update: under-relaxation.
        Relaxed = "relaxed",
        /// No softness; restitution and slop.
        Rigid = "rigid",
        /// Contacts as springs under the surface, without rows.
        Penalty = "penalty",
    }
);
impl Law {
    /// Returns whether the law uses the guess instead of the present positions: rows exist where the
    /// guess overlaps, and their friction is Coulomb's.
    pub fn on_guess(self) -> bool {
        matches!(self, Self::Lesson | Self::Relaxed | Self::Rigid)
    }
}
named!(
    /// The shape of the set of friction forces.
    Cone, "cone" {
        /// |t₁| + |t₂| ≤ μn under `solref`, the box |tᵢ| ≤ μn under the other laws.
        Pyramidal = "pyramidal",
        /// The round cone |t| ≤ μn.
        Elliptic = "elliptic",
    }
);
named!(
    /// The number the engine computes with.
    Precision, "precision" { F32 = "f32", F64 = "f64" }
);

/// The most sweeps, or Newton iterations, of one solve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sweeps {
    AtMost(u32),
    /// As many as the tolerance needs, or until rounding; at most `Sweeps::MOST`.
    Auto,
}

impl Sweeps {
    /// The limit of `Auto`: a step must end.
    pub const MOST: u32 = 10_000;
    /// The name of `Auto`.
    pub const AUTO: &'static str = "auto";

    pub fn limit(self) -> u32 {
        match self {
            Self::AtMost(count) => count,
            Self::Auto => Self::MOST,
        }
    }
}

impl From<u32> for Sweeps {
    fn from(count: u32) -> Self {
        Self::AtMost(count)
    }
}

/// The largest error that a second of motion may add to the position of a body [m]; None: steps
/// have the set length.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Accuracy(pub Option<f64>);

/// The largest speed at which a contact removes an overlap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RecoverySpeed {
    /// The default of the law: `RecoverySpeed::USUAL` under laws on velocities; none under
    /// `solref`, which has its spring and damper.
    Auto,
    /// Without a limit.
    None,
    /// [m/s], > 0.
    AtMost(f64),
}

impl RecoverySpeed {
    /// The value in Box2D v3 (`maxContactPushSpeed`); Rapier and Unity's PhysX have 10 [m/s].
    pub const USUAL: f64 = 3.0;
    pub const AUTO: &'static str = "auto";
    pub const NONE: &'static str = "none";

    /// Returns the limit under a law, if there is one [m/s].
    pub fn under(self, law: Law) -> Option<f64> {
        match self {
            Self::Auto => law.on_guess().then_some(Self::USUAL),
            Self::None => None,
            Self::AtMost(speed) => Some(speed),
        }
    }
}

/// Settings of the computation. SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    // Numerics: cannot change the limit dt → 0.
    /// Time step [s], > 0.
    pub dt: f64,
    /// With a tolerance, a step of `dt` is made of as many shorter ones as it needs.
    pub accuracy: Accuracy,
    pub integrator: Integrator,
    pub solver: Solver,
    pub acceleration: Acceleration,
    /// The most sweeps, or Newton iterations, of one solve; `newton` ignores it for islands with
    /// few rows.
    pub sweeps: Sweeps,
    /// A solve stops at this residual [m/s]; 0: after all sweeps.
    pub tolerance: f64,
    /// A solve under `solref` stops when a sweep or a Newton step lowers the cost by less: MuJoCo's
    /// `tolerance`, a share of the trace of the mass matrix [m²/s⁴]; 0: never.
    pub cost_tolerance: f64,
    /// Start from the last step's impulses.
    pub warm_start: bool,
    /// Selects the engine's `Real` in the binding.
    pub precision: Precision,
    /// Contacts to reserve room for.
    pub max_contacts: usize,
    /// Balance energy every 64 steps, and record the data of a post-mortem.
    pub ledger: bool,
    // Modelling overrides.
    pub law: Law,
    /// Share of a violation removed in a step, in (0, 1], under the laws on the guess.
    pub beta: f64,
    /// Regulariser of rows that keep a distance, under `lesson` and `relaxed` [1/kg; 1/(kg·m²) of
    /// angular rows].
    pub softness: f64,
    /// Share e of the normal speed kept in an impact under `rigid`, in [0, 1].
    pub restitution: f64,
    /// Overlap that remains uncorrected under `rigid` [m].
    pub slop: f64,
    /// The largest speed at which a contact removes an overlap; `penalty` has no such limit.
    pub max_recovery_speed: RecoverySpeed,
    /// Spring of a contact under `penalty` [N/m].
    pub penalty_stiffness: f64,
    /// Its damping, as a share of the critical damping of the mass that the contact moves.
    pub penalty_damping_ratio: f64,
    pub cone: Cone,
    /// Ratio of frictional to normal impedance under `solref`: MuJoCo's `impratio`.
    pub impratio: f64,
    /// Sweeps over friction alone, without a regulariser, after each solve under `solref`: MuJoCo's
    /// `noslip_iterations`.
    pub noslip_iterations: u32,
    /// They end when one of them lowers the cost by less, like `cost_tolerance`: MuJoCo's
    /// `noslip_tolerance`; 0: never.
    pub noslip_tolerance: f64,
    /// Friction under `solref` holds a sticking contact by a spring, without creep: see
    /// `elements/stiction.rs`.
    pub stiction: bool,
    /// Islands at rest sleep: see `sleep/`.
    pub sleep: bool,
    /// The speed below which a tree may sleep [m/s].
    pub sleep_tolerance: f64,
    /// The time for which it must have been below it [s].
    pub sleep_time: f64,
    /// Keeps the time constants of solref at 2 dt or above: MuJoCo's `refsafe`.
    pub refsafe: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            dt: 0.002,
            accuracy: Accuracy(None),
            integrator: Integrator::Euler,
            solver: Solver::Newton,
            acceleration: Acceleration::None,
            sweeps: Sweeps::AtMost(100),
            tolerance: 1e-10,
            cost_tolerance: 0.0,
            warm_start: true,
            precision: Precision::F64,
            max_contacts: 0,
            ledger: false,
            law: Law::SolRef,
            beta: 0.2,
            softness: 0.0,
            restitution: 0.0,
            slop: 0.0,
            max_recovery_speed: RecoverySpeed::Auto,
            penalty_stiffness: 1e5,
            penalty_damping_ratio: 0.1,
            cone: Cone::Pyramidal,
            impratio: 1.0,
            noslip_iterations: 0,
            noslip_tolerance: 0.0,
            stiction: false,
            sleep: false,
            sleep_tolerance: 1e-3,
            sleep_time: 0.5,
            refsafe: true,
        }
    }
}

/// The smallest tolerances in double and in single precision [m]: the rounding of positions of some
/// metres, whose differences estimate an error.
const LEAST_ACCURACY: [f64; 2] = [1e-10, 1e-4];
/// The most contacts for which room may be reserved.
const MOST_CONTACTS: usize = 1_000_000;

impl Settings {
    /// The time ahead for which contacts have rows [s]: laws on the guess need every distance that it
    /// may close.
    pub(crate) fn ahead(&self) -> Option<f64> {
        self.law.on_guess().then_some(self.dt)
    }

    /// Returns the rows that act at the stages of a step: the hard ones, or forces. A softness
    /// applies to the end of the step.
    pub(crate) fn inside(&self) -> Inside {
        let scheme = self.integrator.scheme();
        match self.law {
            _ if scheme.stages == Stages::Start => Inside::Nothing,
            Law::SolRef => scheme.inside,
            Law::Penalty => Inside::All,
            Law::Lesson if self.softness != 0.0 => Inside::Nothing,
            Law::Lesson | Law::Relaxed | Law::Rigid => Inside::Equalities,
        }
    }

    /// Returns whether contacts are solved once, at the start of a step of several stages.
    pub(crate) fn rows_after_stages(&self) -> bool {
        self.law.on_guess() && self.integrator.scheme().stages != Stages::Start
    }

    /// Returns whether equalities act within the step.
    pub fn connects_inside(&self) -> bool {
        self.inside() == Inside::Equalities
    }

    /// Converts a tolerance on the cost of accelerations to one on the cost of a step's impulses
    /// [m²/s²].
    pub(crate) fn cost_floor(&self, tolerance: f64) -> f64 {
        if self.law == Law::SolRef {
            tolerance * self.dt * self.dt
        } else {
            0.0
        }
    }

    /// Checks every field against its limit.
    pub fn check(&self) -> Result<()> {
        let number = |field: &str, value: f64, ok: bool, limit: &str| {
            if value.is_finite() && ok {
                Ok(())
            } else {
                Err(Error::value(field, value, limit))
            }
        };
        number("dt", self.dt, self.dt > 0.0, "finite and > 0 s")?;
        let in_f32 = |x: f64| (x as f32).is_normal();
        if self.precision == Precision::F32 && !(in_f32(self.dt) && in_f32(1.0 / self.dt)) {
            return Err(Error::value("dt", self.dt, "a normal number in f32, and its inverse"));
        }
        number("tolerance", self.tolerance, self.tolerance >= 0.0, "finite and >= 0 m/s")?;
        if self.sweeps == Sweeps::Auto {
            let limit = "> 0 m/s with sweeps = 'auto', which stops on it";
            number("tolerance", self.tolerance, self.tolerance > 0.0, limit)?;
        }
        for (field, value) in
            [("cost_tolerance", self.cost_tolerance), ("noslip_tolerance", self.noslip_tolerance)]
        {
            number(field, value, value >= 0.0, "finite and >= 0 m²/s⁴")?;
        }
        if self.max_contacts > MOST_CONTACTS {
            let limit = format!("at most {MOST_CONTACTS} (it reserves memory)");
            return Err(Error::value("max_contacts", self.max_contacts, limit));
        }
        number("beta", self.beta, self.beta > 0.0 && self.beta <= 1.0, "in (0, 1]")?;
        number("softness", self.softness, self.softness >= 0.0, "finite and >= 0 1/kg")?;
        number(
            "restitution",
            self.restitution,
            (0.0..=1.0).contains(&self.restitution),
            "in [0, 1]",
        )?;
        number("slop", self.slop, self.slop >= 0.0, "finite and >= 0 m")?;
        if let RecoverySpeed::AtMost(speed) = self.max_recovery_speed {
            number(
                "max_recovery_speed",
                speed,
                speed > 0.0,
                "'auto', 'none', or finite and > 0 m/s",
            )?;
        }
        number(
            "penalty_stiffness",
            self.penalty_stiffness,
            self.penalty_stiffness > 0.0,
            "finite and > 0 N/m",
        )?;
        let ratio = self.penalty_damping_ratio;
        number("penalty_damping_ratio", ratio, ratio >= 0.0, "finite and >= 0")?;
        number("impratio", self.impratio, self.impratio > 0.0, "finite and > 0")?;
        number(
            "sleep_tolerance",
            self.sleep_tolerance,
            self.sleep_tolerance >= 0.0,
            "finite and >= 0 m/s",
        )?;
        number("sleep_time", self.sleep_time, self.sleep_time >= 0.0, "finite and >= 0 s")?;
        if self.sleep && self.integrator.scheme().stages != Stages::Start {
            return Err(Error::value(
                "integrator",
                format!("'{}' with sleep", self.integrator.name()),
                "one that evaluates forces once a step, as 'euler' (what sleeps wakes at a step's start)",
            ));
        }
        if let Some(accuracy) = self.accuracy.0 {
            self.check_accuracy(accuracy)?;
        }
        if self.solver == Solver::Newton && self.law.on_guess() {
            return Err(Error::value(
                "solver",
                format!("'newton' with law '{}'", self.law.name()),
                "'pgs' under a Coulomb law (Newton minimises, a Coulomb cone has nothing to minimise)",
            ));
        }
        Ok(())
    }

    /// Reject an accuracy for functions that need steps of a fixed length.
    pub fn check_fixed(&self, who: &str) -> Result<()> {
        let Some(accuracy) = self.accuracy.0 else { return Ok(()) };
        let limit = format!("None for {who}, which regards one step of a fixed length");
        Err(Error::value("accuracy", accuracy, limit))
    }

    /// Checks the accuracy, and that the other settings do not depend on the length of steps.
    fn check_accuracy(&self, accuracy: f64) -> Result<()> {
        let least = match self.precision {
            Precision::F64 => LEAST_ACCURACY[0],
            Precision::F32 => LEAST_ACCURACY[1],
        };
        if !(accuracy.is_finite() && accuracy >= least) {
            let limit = format!("None, or finite and >= {least:e} m in {}", self.precision.name());
            return Err(Error::value("accuracy", accuracy, limit));
        }
        let others = [
            (
                "law",
                self.law.name(),
                self.law != Law::SolRef,
                "'solref' with an accuracy: the others are laws of a step",
            ),
            ("sleep", "True", self.sleep, "False with an accuracy: who sleeps is decided at steps"),
            ("ledger", "True", self.ledger, "False with an accuracy: it balances single steps"),
            (
                "stiction",
                "True",
                self.stiction,
                "False with an accuracy: its springs move with each step",
            ),
        ];
        for (field, value, bad, limit) in others {
            if bad {
                return Err(Error::value(field, value, limit));
            }
        }
        Ok(())
    }
}
