//! One error type. Each variant's text names the field, the value and the limit.

use std::fmt;

use crate::elements::{Mention, Named, Text};
use crate::post_mortem::{short, PostMortem};

/// The reason for a rejection or a failure.
#[derive(Clone, Debug, PartialEq)]
pub enum Error {
    /// A value outside its limits, found before any state changed.
    Value { field: Text, value: String, limit: String },
    /// A scene that cannot be compiled.
    Scene(Text),
    /// A step that cannot be committed.
    Diverged(Box<Divergence>),
    /// A step that was interrupted before it was solved; it is not committed. See `interrupt.rs`.
    Interrupted,
}

/// A step that cannot be committed; the last finite state is kept.
#[derive(Clone, Debug, PartialEq)]
pub struct Divergence {
    /// Steps done before, and the time of that state [s].
    pub step: u64,
    pub time: f64,
    /// The lane that failed; with `batch` its place among the worlds of a batch.
    pub world: usize,
    pub batch: bool,
    pub fault: Fault,
    /// The element that it came from, and the fix, if an observer was present.
    pub post: Option<PostMortem>,
}

/// The fault of a step.
#[derive(Clone, Debug, PartialEq)]
pub enum Fault {
    /// The velocity or acceleration of a joint is not finite.
    NotFinite { quantity: &'static str, joint: Named },
    /// A position is not finite.
    Position,
    /// The iteration of the integrator `midpoint` does not converge.
    Midpoint,
    /// No stretch of a step meets the tolerance [m/s]: the shortest [s] adds an error [m], which is
    /// largest at this body.
    Rough { error: f64, length: f64, asked: f64, body: Named },
    /// A body is farther from its start [m] than the bound of a motion.
    Far { body: Named, far: f64, bound: f64 },
    /// Adaptive steps evaluate forces more often than the limit.
    Evaluations,
    /// A velocity beyond any motion: see `Sim::beyond`.
    Beyond { velocity: f64, joint: Named },
    /// Energy that a passive scene cannot have gained, and the energy of its motion and springs [J].
    Energy { gained: f64, moving: f64 },
}

impl Error {
    pub fn value(
        field: impl Into<Text>,
        value: impl fmt::Display,
        limit: impl Into<String>,
    ) -> Self {
        Self::Value { field: field.into(), value: brief(value.to_string()), limit: limit.into() }
    }
}

/// Format a value for a text: a number with more digits than are meaningful gets an exponent.
fn brief(value: String) -> String {
    // More than an index has, and than a number near 1 with its sign and point.
    const LONGEST: usize = 24;
    match value.parse::<f64>() {
        Ok(number) if value.len() > LONGEST => format!("{number:e}"),
        _ => value,
    }
}

impl Error {
    /// The same for one of several worlds.
    pub(crate) fn in_world(mut self, world: usize) -> Self {
        match &mut self {
            Self::Value { limit, .. } => *limit += &format!(" (world {world})"),
            Self::Diverged(divergence) => (divergence.world, divergence.batch) = (world, true),
            Self::Scene(_) | Self::Interrupted => (),
        }
        self
    }

    /// Returns the places in the scene's text of the elements that the error names.
    pub fn mentions(&self) -> &[Mention] {
        match self {
            Self::Value { field, .. } => field.mentions(),
            Self::Scene(text) => text.mentions(),
            Self::Diverged { .. } | Self::Interrupted => &[],
        }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Value { field, value, limit } => write!(f, "{field} = {value}: must be {limit}"),
            Self::Scene(text) => f.write_str(text.words()),
            Self::Diverged(divergence) => divergence.fmt(f),
            Self::Interrupted => f.write_str("the step was interrupted"),
        }
    }
}

impl Divergence {
    /// The same if the run continues.
    pub(crate) fn warning(&self) -> String {
        let post = self.post.as_ref().map_or(String::new(), ToString::to_string);
        format!(
            "by step {} at time {:.6} s {}.{post} The run goes on; with ledger=True it ends here.",
            self.step, self.time, self.fault
        )
    }
}

impl fmt::Display for Divergence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "diverged in step {} at time {:.6} s: {}", self.step, self.time, self.fault)?;
        if self.batch {
            write!(f, " in world {}", self.world)?;
        }
        f.write_str(".")?;
        if let Some(post) = &self.post {
            post.fmt(f)?;
        }
        f.write_str(" The last finite state is kept.")
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite { quantity, joint } => {
                write!(f, "the {quantity} of {joint} is not finite")
            }
            Self::Position => f.write_str("a position is not finite"),
            Self::Midpoint => {
                f.write_str("the midpoint iteration does not converge (use a smaller dt)")
            }
            Self::Rough { error, length, asked, body } => write!(
                f,
                "no step keeps the accuracy of {} m: one of {} s moves {body} by {} m too far",
                short(*asked),
                short(*length),
                short(*error)
            ),
            Self::Far { body, far, bound } => write!(
                f,
                "{body} is {} m from where it began, beyond the bound of {} m",
                short(*far),
                short(*bound)
            ),
            Self::Evaluations => {
                f.write_str("the accuracy takes more evaluations of the forces than the run may")
            }
            Self::Beyond { velocity, joint } => write!(
                f,
                "the velocity of {joint} is {}, faster than anything moves",
                short(*velocity)
            ),
            Self::Energy { gained, moving } => write!(
                f,
                "the energy is {} J more than a passive scene can have ({} J in motion and springs)",
                short(*gained),
                short(*moving)
            ),
        }
    }
}

impl std::error::Error for Error {}

pub type Result<T> = std::result::Result<T, Error>;
