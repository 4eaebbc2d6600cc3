//! One error type. Each variant's text names the field, the value and the limit.

use std::fmt;

use crate::elements::{Mention, Named, Text};
use crate::watch::ledger::PostMortem;

/// Why something was refused or went wrong.
#[derive(Clone, Debug, PartialEq)]
pub enum Error {
    /// A value outside its limits, found before any state changed.
    Value { field: Text, value: String, limit: String },
    /// A scene that cannot be compiled.
    Scene(Text),
    /// The simulation left the finite numbers; the last finite state is kept. `step`: steps
    /// done before, `time`: of that state [s], `world`: its lane or its place in a batch.
    /// `post`: where the energy came from.
    Diverged {
        step: u64,
        time: f64,
        world: usize,
        element: Option<Named>,
        quantity: String,
        post: Box<PostMortem>,
    },
}

impl Error {
    pub fn value(
        field: impl Into<Text>,
        value: impl fmt::Display,
        limit: impl Into<String>,
    ) -> Self {
        Self::Value { field: field.into(), value: value.to_string(), limit: limit.into() }
    }
}

impl Error {
    /// Where the elements of a scene that it names stand in its text.
    pub fn mentions(&self) -> &[Mention] {
        match self {
            Self::Value { field, .. } => field.mentions(),
            Self::Scene(text) => text.mentions(),
            Self::Diverged { .. } => &[],
        }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Value { field, value, limit } => write!(f, "{field} = {value}: must be {limit}"),
            Self::Scene(text) => f.write_str(text.words()),
            Self::Diverged { step, time, element, quantity, post, .. } => {
                let element = element.as_ref().map_or("no single element", |named| &named.name);
                write!(
                    f,
                    "diverged in step {step} at time {time:.6} s: {quantity}; what drove it is {element}{}; the \
                     last finite state is kept",
                    post.sentence()
                )
            }
        }
    }
}

impl std::error::Error for Error {}

pub type Result<T> = std::result::Result<T, Error>;
