//! The work of a step of a model, as lists that it walks; and the omitted work, with reasons.
//!
//! Lists that depend on the scene alone are in the `Model`: things to place (`places.rs`), makers
//! of rows (`makers.rs`), forces (`acting.rs`). `Plan` is the choice of the settings besides them.

pub(crate) mod acting;
mod after_stages;
mod commit;
mod left_out;
pub(crate) mod makers;
mod pairs;
pub(crate) mod places;
mod rows;
mod terms;

use crate::integrator::{Inside, Scheme, Stages};
use crate::model::Model;
use crate::settings::{Law, Settings, Solver};

pub(crate) use after_stages::{Commit, LateTrees};
pub use left_out::Unmet;
pub(crate) use left_out::EXAMPLES;

/// The type of an entry's elements, by their place in the model's lists.
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

/// One operation of a step, or one that it leaves out.
#[derive(Clone, Debug)]
pub struct Entry {
    pub stage: &'static str,
    /// "term", "pair" or "row".
    pub kind: &'static str,
    pub name: String,
    pub of: Of,
    pub elements: Vec<usize>,
    /// The number of elements, named or not.
    pub count: usize,
    pub used: bool,
    /// The reason for leaving it out, or a remark.
    pub why: String,
    /// The kind of elements whose rows these are.
    pub rows: Option<&'static str>,
}

/// The work of a step of a model under its settings, besides the lists of the model. A `Sim` holds
/// it: no step reads these settings again.
#[derive(Clone, Debug)]
pub struct Plan {
    pub(crate) scheme: &'static Scheme,
    /// The rows that act at the stages of a step.
    pub(crate) inside: Inside,
    /// Whether a step makes one solve, at its initial state, and everything in it is awake.
    pub(crate) solves_once: bool,
    pub(crate) sleeps: bool,
    /// Whether a solve starts from the last step's impulses; and whether some are kept.
    pub(crate) warm_start: bool,
    pub(crate) keeps: bool,
    /// Newton's method starts from the acceleration of the last solve.
    pub(crate) resumes: bool,
    /// Sweeps over friction alone after each solve, and the gain that ends them: see
    /// `Rows::inertia`.
    pub(crate) noslip: u32,
    pub(crate) noslip_cost: f64,
    /// Whether sweeps end by a share of the mass of their island.
    pub(crate) weighs: bool,
    pub(crate) late: LateTrees,
    pub(crate) commit: Vec<Commit>,
}

room!(Plan: scheme, inside, solves_once, sleeps, warm_start, keeps, resumes, noslip, noslip_cost, weighs, late, commit);

impl Plan {
    pub fn of(model: &Model, settings: &Settings) -> Self {
        let scheme = settings.integrator.scheme();
        let late = LateTrees::of(model, scheme);
        let equalities = model.equalities.is_empty();
        let noslip_cost = settings.cost_floor(settings.noslip_tolerance);
        // Otherwise the last solve of a step is of rows after its stages.
        let in_stages = scheme.stages == Stages::Start || settings.inside() == Inside::All;
        Self {
            scheme,
            inside: match settings.inside() {
                Inside::Equalities if equalities => Inside::Nothing,
                inside => inside,
            },
            solves_once: !settings.sleep && scheme.stages == Stages::Start,
            sleeps: settings.sleep,
            warm_start: settings.warm_start,
            keeps: settings.warm_start || settings.stiction,
            resumes: settings.warm_start && settings.solver == Solver::Newton && in_stages,
            noslip: match settings.law {
                Law::SolRef => settings.noslip_iterations,
                _ => 0,
            },
            noslip_cost,
            weighs: noslip_cost + settings.cost_floor(settings.cost_tolerance) > 0.0,
            commit: Commit::list(model, settings, &late),
            late,
        }
    }

    /// The work of a step, done and omitted: one entry for each kind of work and reason, in the
    /// order of the stages.
    pub fn entries(&self, model: &Model, settings: &Settings) -> Vec<Entry> {
        let mut print = Print { entries: vec![] };
        print.places(model);
        print.terms(model, settings);
        print.pairs(model, settings);
        print.rows(model, settings);
        print.commit(self, model, settings);
        print.entries.retain(|entry| entry.count > 0);
        print.entries
    }
}

/// A collector of entries.
struct Print {
    entries: Vec<Entry>,
}

impl Print {
    /// Adds work on these elements.
    fn does(
        &mut self,
        stage: &'static str,
        name: impl Into<String>,
        of: Of,
        elements: Vec<usize>,
    ) -> &mut Entry {
        self.push(stage, name.into(), of, elements, true, String::new())
    }

    /// Adds omitted work on these elements, with the reason.
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

/// The indices of `0..count` that pass a test, and the others.
fn split(count: usize, test: impl Fn(usize) -> bool) -> [Vec<usize>; 2] {
    let (have, lack) = (0..count).partition(|index| test(*index));
    [have, lack]
}
