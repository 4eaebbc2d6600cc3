//! Text about elements, with the elements that it names as separate data.

use std::fmt;
use std::ops::Range;

use super::{Element, Kind};

/// An element with its name, for use without a model.
#[derive(Clone, Debug, PartialEq)]
pub struct Named {
    pub element: Element,
    pub name: String,
}

impl Named {
    /// Returns the words before its name in a sentence: "the spring of joint `knee`", "servo `grip`".
    pub fn article(&self) -> &'static str {
        match self.element.kind {
            Kind::Spring
            | Kind::Damper
            | Kind::FrictionLoss
            | Kind::Limit
            | Kind::TendonSpring
            | Kind::TendonDamper
            | Kind::TendonFriction
            | Kind::TendonLimit
            | Kind::Inertia
            | Kind::JointForce
            | Kind::BodyForce
            | Kind::Contact => "the ",
            _ => "",
        }
    }
}

impl fmt::Display for Named {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)
    }
}

/// Text in which elements of a scene are named; the places of the names are separate data.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Text {
    words: String,
    mentions: Vec<Mention>,
}

/// An element in a `Text`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mention {
    /// Position in bytes.
    pub at: Range<usize>,
    pub element: Element,
}

impl Text {
    /// `geom 'floor'`, or `geom 3` where it has no name.
    pub(crate) fn label(kind: Kind, name: &str, index: usize) -> Self {
        let words = match name {
            "" => format!("{} {index}", kind.word()),
            name => format!("{} '{name}'", kind.word()),
        };
        let at = 0..words.len();
        Self { words, mentions: vec![Mention { at, element: Element::whole(kind, index) }] }
    }

    pub(crate) fn push(&mut self, piece: impl Into<Self>) {
        let (piece, start) = (piece.into(), self.words.len());
        self.words.push_str(&piece.words);
        let moved = |m: Mention| Mention { at: start + m.at.start..start + m.at.end, ..m };
        self.mentions.extend(piece.mentions.into_iter().map(moved));
    }

    pub fn words(&self) -> &str {
        &self.words
    }

    pub fn mentions(&self) -> &[Mention] {
        &self.mentions
    }
}

impl fmt::Display for Text {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.words)
    }
}

impl From<String> for Text {
    fn from(words: String) -> Self {
        Self { words, mentions: Vec::new() }
    }
}

impl From<&str> for Text {
    fn from(words: &str) -> Self {
        words.to_owned().into()
    }
}

impl From<&Self> for Text {
    fn from(text: &Self) -> Self {
        text.clone()
    }
}

/// A `Text` out of pieces: strings and other texts.
macro_rules! text {
    ($($piece:expr),+ $(,)?) => {{
        let mut text = $crate::elements::Text::default();
        $(text.push($piece);)+
        text
    }};
}
pub(crate) use text;
