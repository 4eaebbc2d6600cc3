//! The parts that compilation left out of every step, and the reasons.
//!
//! Nothing is decided here: the reasons are read from the model that steps, or returned by the
//! functions that compiled it.

use crate::model::{Model, Never};
use std::collections::BTreeMap;

impl Never {
    /// The reason as text for a user.
    pub fn why(self) -> &'static str {
        match self {
            Self::Off => "contacts are switched off",
            Self::SameBody => "on the same body",
            Self::Fixed => "no joint between their bodies",
            Self::Family => "one body is the parent of the other",
            Self::Excluded => "excluded",
            Self::Bits => "contype and conaffinity share no bit",
            Self::Planes => "two planes",
            Self::Explicit => "an explicit pair stands for them",
        }
    }
}

/// Pairs that never meet for one reason.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Unmet {
    pub count: usize,
    /// The first few, by geom.
    pub examples: Vec<(usize, usize)>,
}

pub(crate) const EXAMPLES: usize = 6;

impl Model {
    /// Pairs of geoms that were not made candidates, by reason. Geoms without any bit, which only
    /// draw or weigh, are not examined.
    pub fn unmet(&self) -> BTreeMap<Never, Unmet> {
        if self.dynamic_pairs.is_some() {
            return self.tally().never;
        }
        let mut found: BTreeMap<Never, Unmet> = BTreeMap::new();
        let solid: Vec<usize> = (0..self.geoms.len())
            .filter(|g| self.geoms[*g].contype != 0 || self.geoms[*g].conaffinity != 0)
            .collect();
        for (k, &a) in solid.iter().enumerate() {
            for &b in &solid[k + 1..] {
                let bodies = [self.geoms[a].body, self.geoms[b].body];
                let why = self.never_between(bodies[0], bodies[1]).or_else(|| self.never(a, b));
                // An explicit pair meets, whatever the other rules are for its geoms.
                let still = matches!(why, Some(Never::Off | Never::SameBody | Never::Fixed));
                let met = self.explicit.contains(&(a, b)) && !still;
                let Some(why) = why.filter(|_| !met) else { continue };
                let entry = found.entry(why).or_default();
                entry.count += 1;
                if entry.examples.len() < EXAMPLES {
                    entry.examples.push((a, b));
                }
            }
        }
        found
    }
}
