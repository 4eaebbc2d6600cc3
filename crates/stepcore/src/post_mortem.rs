//! What a failed run tells about itself, as plain data, and its paragraph.

use std::fmt::Write;

use crate::elements::Named;

/// Which dt would have been stable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stable {
    /// Nothing is known.
    Unknown,
    /// The limit of the springs and dampers alone [s]; `tried`: a run just below it stays bounded.
    Springs { dt: f64, tried: bool },
    /// The integrator feeds springs energy at every dt; `semi_implicit`: the limit of that one
    /// [s], None where it is stable at the present dt.
    Never { semi_implicit: Option<f64> },
    /// The last steps were run again with halved dt [s].
    Halved { dt: f64 },
    /// Halving did not help.
    NotFound,
}

/// The state of one world from which a failure comes again.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Start {
    /// Steps done, and the time from which they are counted [s].
    pub steps: u64,
    pub time: f64,
    pub qpos: Vec<f64>,
    pub qvel: Vec<f64>,
    /// Impulses of the last solve, by slot.
    pub warm: Vec<(u32, [f64; 6])>,
}

/// The inputs of one world.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Held {
    pub ctrl: Vec<f64>,
    pub qfrc_applied: Vec<f64>,
    pub xfrc_applied: Vec<f64>,
}

/// What a failed run tells about itself: one world, in `f64`.
#[derive(Clone, Debug, PartialEq)]
pub struct PostMortem {
    /// From here, with these inputs, the failure comes again after `steps` steps.
    pub start: Start,
    pub inputs: Held,
    /// Steps done since `start` before the inputs became these.
    pub changes: Vec<(u64, Held)>,
    pub steps: u64,
    /// The element that the failure came from, if one stands out.
    pub element: Option<Named>,
    /// Each element's share of the energy injected, the largest first.
    pub shares: Vec<(Named, f64)>,
    /// The step from which the energy grew.
    pub since: Option<u64>,
    /// Kinetic and stored energy grow by exp(growth) a step.
    pub growth: Option<f64>,
    pub stable: Stable,
    /// Time step [s], and the name of the integrator.
    pub dt: f64,
    pub integrator: &'static str,
}

impl PostMortem {
    /// The part of the paragraph that says where the energy came from and what would help.
    pub fn sentence(&self) -> String {
        let mut text = String::new();
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        if let Some((name, share)) = self.shares.first() {
            let since = self
                .since
                .map_or("over the steps that are kept".into(), |step| format!("since step {step}"));
            let _ = write!(text, "; of the energy fed in {since} {name} gave {}", percent(*share));
            if let Some((name, share)) = self.shares.get(1).filter(|(_, share)| *share >= 0.005) {
                let _ = write!(text, ", {name} {}", percent(*share));
            }
        }
        if let Some(growth) = self.growth {
            let _ = write!(
                text,
                "; the energy of motion and springs grows {} times a step (at a rate of {} /s)",
                short(growth.exp()),
                short(growth / self.dt)
            );
        }
        let name = self.integrator;
        let _ = match self.stable {
            Stable::Unknown => Ok(()),
            Stable::Springs { dt, tried } => write!(
                text,
                "; under {name} the springs, dampers and servos here are stable below dt = {} s ({})",
                short(dt),
                if tried {
                    "from their own linear step; the same stretch run again just below it stays bounded"
                } else {
                    "from their own linear step"
                }
            ),
            Stable::Never { semi_implicit } => write!(
                text,
                "; no dt is stable, {name} feeds these springs at every step; semi-implicit is \
                 stable {}",
                semi_implicit.map_or("at this dt".into(), |dt| format!("below dt = {} s", short(dt)))
            ),
            Stable::Halved { dt } => write!(
                text,
                "; with dt = {} s the same stretch gains next to nothing (run again with halved steps)",
                short(dt)
            ),
            Stable::NotFound => {
                write!(text, "; the same stretch run again with halved steps gains as well")
            }
        };
        text
    }
}

/// A number in a few digits, in whichever notation is short.
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
