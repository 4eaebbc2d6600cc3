//! The explanation of a failed run, as plain data, and its paragraph.

use std::fmt;

use crate::elements::Named;
use crate::warm::Sleep;
use crate::warm::Warm;

/// The dt that would have been stable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stable {
    /// No result.
    Unknown,
    /// The stability limit of the springs and dampers alone at the start of the failing steps [s];
    /// `tried`: these steps stay bounded just below it.
    Springs { dt: f64, tried: bool },
    /// The integrator feeds springs energy at every dt; `semi_implicit`: the limit of that
    /// integrator [s], None if it is stable at the present dt.
    Never { semi_implicit: Option<f64> },
    /// The last steps were run again with halved dt [s].
    Halved { dt: f64 },
    /// Rows are solved after the stages of a step; semi-implicit gains this share in the same steps.
    AfterStages { share: f64 },
    /// Halving did not help.
    NotFound,
}

/// The state of one world from which a failure is reproduced.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Start {
    /// Steps done, and the time from which they are counted [s].
    pub steps: u64,
    pub time: f64,
    pub qpos: Vec<f64>,
    pub qvel: Vec<f64>,
    pub act: Vec<f64>,
    pub ctrl_history: Vec<f64>,
    /// Impulses of the last solve, by slot.
    pub warm: Vec<Warm<f64>>,
    /// The trees that slept.
    pub sleep: Sleep<f64>,
}

/// The inputs of one world.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Held {
    pub ctrl: Vec<f64>,
    pub qfrc_applied: Vec<f64>,
    pub xfrc_applied: Vec<f64>,
    pub eq_active: Vec<f64>,
    pub mocap_pos: Vec<f64>,
    pub mocap_quat: Vec<f64>,
}

/// Rows that caused the failure because they were not solved.
#[derive(Clone, Debug, PartialEq)]
pub struct Missed {
    pub element: Named,
    /// The most energy that they added, if the fault is one of energy [J].
    pub added: Option<f64>,
    /// Their largest residual [m/s].
    pub residual: f64,
    /// Under sweeps 'auto' the same steps gain almost nothing.
    pub auto: bool,
}

/// The explanation of a failed run: one world, in `f64`.
#[derive(Clone, Debug, PartialEq)]
pub struct PostMortem {
    /// From here, with these inputs, the failure recurs after `steps` steps.
    pub start: Start,
    pub inputs: Held,
    /// Steps done since `start` until the inputs became these.
    pub changes: Vec<(u64, Held)>,
    pub steps: u64,
    /// The element that the failure came from, if one stands out.
    pub element: Option<Named>,
    /// Whether the element is a servo in saturation, and not the first of `shares`.
    pub saturated: bool,
    /// Each element's share of the energy injected, the largest first.
    pub shares: Vec<(Named, f64)>,
    /// The step from which the energy grew.
    pub since: Option<u64>,
    /// Kinetic and stored energy grow by exp(growth) per step.
    pub growth: Option<f64>,
    /// Rows that caused the failure at any dt.
    pub unsolved: Option<Missed>,
    pub stable: Stable,
    /// Time step [s], and the name of the integrator.
    pub dt: f64,
    pub integrator: &'static str,
}

impl fmt::Display for PostMortem {
    /// Writes sentences, a space before each: the cause, the growth, and the dt that would help.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.element {
            None => write!(f, " No single element stands out")?,
            Some(element) => write!(f, " The cause is {}{element}", element.article())?,
        }
        if self.saturated {
            write!(f, ", which was at the bounds of its force: it does not damp there")?;
        }
        let mut shares = self.shares.iter().map(|(element, share)| (element, 100.0 * share));
        if let Some((first, percent)) = shares.next() {
            match self.saturated {
                false => write!(f, ", the source of {percent:.0} % of the energy injected ")?,
                true => write!(
                    f,
                    ". Through {}{first} came {percent:.0} % of the energy injected ",
                    first.article()
                )?,
            }
            match self.since {
                None => write!(f, "in the last steps")?,
                Some(step) => write!(f, "since step {step}")?,
            }
            if let Some((element, percent)) = shares.next().filter(|(_, percent)| *percent >= 0.5) {
                write!(f, " (next: {element}, {percent:.0} %)")?;
            }
        }
        f.write_str(".")?;
        if let Some(growth) = self.growth {
            let (factor, rate) = (short(growth.exp()), short(growth / self.dt));
            write!(
                f,
                " The energy of motion and springs grows by a factor of {factor} per step \
                 (rate {rate} 1/s)."
            )?;
        }
        if let Some(missed) = &self.unsolved {
            let whose = match &self.element {
                Some(element) if *element == missed.element => "Its rows".into(),
                _ => format!("The rows of {}{}", missed.element.article(), missed.element),
            };
            let residual = short(missed.residual);
            write!(f, " {whose} are not solved: they miss their law by {residual} m/s")?;
            if let Some(added) = missed.added {
                write!(f, " and added {} J", short(added))?;
            }
            f.write_str(".")?;
            if missed.auto {
                f.write_str(" With sweeps='auto' these steps gain almost nothing.")?;
            }
        }
        self.stable.fmt_under(self.integrator, f)
    }
}

impl Stable {
    fn fmt_under(self, integrator: &str, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unknown => Ok(()),
            Self::Springs { dt, tried } => {
                let rerun = if tried { "; these steps, rerun just below it, stay bounded" } else { "" };
                write!(
                    f,
                    " Under {integrator}, the springs, dampers and servos are stable below \
                     dt = {} s (linearised where the growth began{rerun}).",
                    short(dt)
                )
            }
            Self::Never { semi_implicit } => {
                write!(
                    f,
                    " No dt is stable: {integrator} adds energy to these springs in every step; "
                )?;
                match semi_implicit {
                    None => write!(f, "semi-implicit is stable at this dt."),
                    Some(dt) => write!(f, "semi-implicit is stable below dt = {} s.", short(dt)),
                }
            }
            Self::Halved { dt } => write!(
                f,
                " A rerun of these steps with dt = {} s gains almost no energy.",
                short(dt)
            ),
            Self::AfterStages { share } => write!(
                f,
                " Under a law on velocities {integrator} solves contacts after its stages, as if the \
                 point of contact stood where the step began; integrator='semi-implicit' gains {:.0} % \
                 of that in these steps.",
                100.0 * share
            ),
            Self::NotFound => {
                f.write_str(" Reruns of these steps with smaller dt gain energy as well.")
            }
        }
    }
}

/// Format a number in a few digits, in the shorter notation.
pub(crate) fn short(x: f64) -> String {
    if x.is_infinite() {
        format!("more than {:.1e}", f64::MAX)
    } else if x == 0.0 {
        "0".into()
    } else if (1e-3..1e4).contains(&x) {
        let digits = (3 - x.log10().floor() as i32).clamp(0, 6) as usize;
        format!("{x:.digits$}")
    } else {
        format!("{x:.2e}")
    }
}
