//! What a step of a model does, as lists that it walks; and what it leaves out, and why.
//!
//! Lists that depend on the scene alone stand in the `Model`: what is placed (`places.rs`), what makes
//! rows (`makers.rs`), and what pushes (`acting.rs`). `Plan` reads those lists, and what the settings
//! choose.

pub(crate) mod acting;
mod commit;
mod left_out;
pub(crate) mod makers;
mod pairs;
pub(crate) mod places;
mod rows;
mod terms;

use crate::model::Model;
use crate::settings::Settings;

pub use left_out::Unmet;
pub(crate) use left_out::EXAMPLES;

/// What the elements of an entry are, by their place in the model's lists.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Of {
    Body,
    Joint,
    Geom,
    Tendon,
    Actuator,
    Equality,
    Sensor,
    Tree,
    /// By its lowest tree: see `Model::islands`.
    Island,
    /// Two geoms: a place in `Model::pairs`.
    Pair,
}

/// One thing that a step does, or leaves out.
#[derive(Clone, Debug)]
pub struct Entry {
    pub stage: &'static str,
    /// "term", "pair" or "row".
    pub kind: &'static str,
    pub name: String,
    pub of: Of,
    pub elements: Vec<usize>,
    /// How many elements, named or not.
    pub count: usize,
    pub used: bool,
    /// Why it is left out, or a remark.
    pub why: String,
    /// The kind of elements whose rows these are.
    pub rows: Option<&'static str>,
}

/// What a step of a model under its settings does, and what it leaves out: one entry for each
/// kind of work and reason, in the order of the stages.
#[derive(Clone, Debug, Default)]
pub struct Plan {
    pub entries: Vec<Entry>,
}

impl Plan {
    pub fn of(model: &Model, settings: &Settings) -> Self {
        let mut plan = Self::default();
        plan.places(model);
        plan.terms(model, settings);
        plan.pairs(model, settings);
        plan.rows(model, settings);
        plan.commit(model, settings);
        plan.entries.retain(|entry| entry.count > 0);
        plan
    }

    /// Work on these elements.
    fn does(
        &mut self,
        stage: &'static str,
        name: impl Into<String>,
        of: Of,
        elements: Vec<usize>,
    ) -> &mut Entry {
        self.push(stage, name.into(), of, elements, true, String::new())
    }

    /// No work on these elements, and why.
    fn omits(
        &mut self,
        stage: &'static str,
        name: impl Into<String>,
        of: Of,
        elements: Vec<usize>,
        why: impl Into<String>,
    ) -> &mut Entry {
        self.push(stage, name.into(), of, elements, false, why.into())
    }

    fn push(
        &mut self,
        stage: &'static str,
        name: String,
        of: Of,
        elements: Vec<usize>,
        used: bool,
        why: String,
    ) -> &mut Entry {
        let (count, kind, rows) = (elements.len(), "term", None);
        self.entries.push(Entry { stage, kind, name, of, elements, count, used, why, rows });
        let last = self.entries.len() - 1;
        &mut self.entries[last]
    }
}

impl Entry {
    fn kind(&mut self, kind: &'static str) -> &mut Self {
        self.kind = kind;
        self
    }

    fn counting(&mut self, count: usize) -> &mut Self {
        self.count = count;
        self
    }

    /// Its elements make rows.
    fn rows(&mut self, kind: &'static str) -> &mut Self {
        (self.kind, self.rows) = ("row", Some(kind));
        self
    }
}

/// Those of `0..count` that pass a test, and the others.
fn split(count: usize, test: impl Fn(usize) -> bool) -> [Vec<usize>; 2] {
    let (have, lack) = (0..count).partition(|index| test(*index));
    [have, lack]
}
