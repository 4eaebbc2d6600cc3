//! The kinds of rows, and the elements without rows.

use std::collections::BTreeMap;

use super::{split, Of, Print};
use crate::elements::ways;
use crate::model::Model;
use crate::scene::JointType;
use crate::settings::{Cone, Law, Settings};

/// Equalities: their printed name, their rows, and the kind of these.
const EQUALITIES: [(&str, &str, &str); 4] = [
    ("connections", "3 rows", "connect"),
    ("welds", "6 rows", "weld"),
    ("joint equalities", "1 row", "joint equality"),
    ("tendon equalities", "1 row", "tendon equality"),
];

impl Print {
    pub(super) fn rows(&mut self, model: &Model, settings: &Settings) {
        let on = &model.features;
        for (name, per, word) in EQUALITIES {
            let own = |index: usize| model.equalities[index].kind().word() == word;
            let [all, _] = split(model.equalities.len(), own);
            if on.equality && on.constraint {
                let (active, inactive) =
                    all.into_iter().partition(|index| model.equalities[*index].active);
                self.does("solve", format!("{name}, {per} each"), Of::Equality, active).rows(word);
                self.omits("solve", name, Of::Equality, inactive, "not active").kind("row");
            } else {
                self.omits("solve", name, Of::Equality, all, "switched off").kind("row");
            }
        }
        let joints = model.joints.len();
        let rubs = |joint: usize| model.dofs[model.joints[joint].dof].frictionloss != 0.0;
        let [have, lack] = split(joints, rubs);
        let (per, is_on) = ("one row per dof", on.frictionloss && on.constraint);
        self.row_kind(("friction loss", per, "friction loss"), Of::Joint, have, is_on);
        self.omits("solve", "friction loss", Of::Joint, lack, "frictionloss 0").kind("row");
        let [have, lack] = split(joints, |joint| model.joints[joint].range.is_some());
        let (free, lack): (Vec<usize>, Vec<usize>) =
            lack.into_iter().partition(|joint| model.joints[*joint].kind == JointType::Free);
        let (per, is_on) = ("one row while reached", on.limit && on.constraint);
        self.row_kind(("limits", per, "limit"), Of::Joint, have, is_on);
        self.omits("solve", "limits", Of::Joint, lack, "no range").kind("row");
        self.omits("solve", "limits", Of::Joint, free, "free joints have none").kind("row");
        let tendons = model.tendons.len();
        let [have, _] = split(tendons, |tendon| model.tendons[tendon].frictionloss != 0.0);
        let word = "tendon friction loss";
        self.row_kind(
            (word, "one row each", word),
            Of::Tendon,
            have,
            on.frictionloss && on.constraint,
        );
        let [have, _] = split(tendons, |tendon| model.tendons[tendon].range.is_some());
        self.row_kind(("tendon limits", per, "tendon limit"), Of::Tendon, have, is_on);
        self.contacts(model, settings);
    }

    /// Adds rows of one kind, if its flag is on.
    fn row_kind(
        &mut self,
        (name, per, word): (&str, &str, &'static str),
        of: Of,
        have: Vec<usize>,
        is_on: bool,
    ) {
        if is_on {
            self.does("solve", format!("{name}, {per}"), of, have).rows(word);
        } else {
            self.omits("solve", name, of, have, "switched off").kind("row");
        }
    }

    fn contacts(&mut self, model: &Model, settings: &Settings) {
        let (law, cone) = (settings.law, settings.cone);
        if model.dynamic_pairs.is_some() && law != Law::Penalty {
            // The contacts of a pile, and their rows, are found only during the run.
            let name = format!("contacts of what touches ({} cone)", cone.name());
            let count = model.tally().meet.values().sum();
            self.does("solve", name, Of::Pair, vec![]).rows("contact").counting(count);
            return;
        }
        let every = || 0..model.pairs.len();
        if law == Law::Penalty {
            let why = "the law penalty uses springs, not rows";
            self.omits("solve", "contact rows", Of::Pair, every().collect(), why).kind("row");
            return;
        }
        let material = |pair: usize| model.material(&model.pairs[pair]);
        let ways_of = |pair: usize| {
            let (soft, plain, still) = ways(model, &model.pairs[pair]);
            (if law == Law::SolRef { soft } else { plain }, still)
        };
        let [normal, rubbing] = split(model.pairs.len(), |pair| material(pair).condim == 1);
        let smooth = |pair: &usize| material(*pair).friction[0] == 0.0;
        let zero: Vec<usize> = rubbing.iter().copied().filter(smooth).collect();
        let drops = |pair: &usize| {
            law.on_guess() && smooth(pair) && ways(model, &model.pairs[*pair]).1 == 0
        };
        let (dropped, rubbing): (Vec<usize>, Vec<usize>) = rubbing.into_iter().partition(drops);
        let name = "friction of contacts";
        self.does("solve", "contacts, normal row only", Of::Pair, normal.clone()).kind("row");
        self.omits("solve", name, Of::Pair, normal, "condim 1").kind("row");
        self.omits("solve", name, Of::Pair, dropped, "μ is 0").kind("row");
        let mut by_ways: BTreeMap<(usize, usize), Vec<usize>> = BTreeMap::new();
        for pair in rubbing {
            let (moving, still) = ways_of(pair);
            // Most ways first.
            by_ways.entry((usize::MAX - moving, still)).or_default().push(pair);
        }
        let edges = law == Law::SolRef && cone == Cone::Pyramidal;
        let rows_of = |moving: usize, still: usize| {
            if edges {
                2 * moving + usize::from(still > 0)
            } else {
                1 + moving
            }
        };
        for ((moving, still), own) in by_ways {
            let moving = usize::MAX - moving;
            let rows = rows_of(moving, still);
            let plural = if rows > 1 { "s" } else { "" };
            let name = format!("contacts, {rows} row{plural} each ({} cone)", cone.name());
            let all = own.len() == model.pairs.len();
            let entry = self.does("solve", name, Of::Pair, own.clone()).kind("row");
            entry.rows = all.then_some("contact");
            if still > 0 {
                let full = rows_of(moving + still, 0);
                let why = format!("no body can move that way: {rows} rows instead of {full}");
                let word = if still == 1 { "one tangent" } else { "both tangents" };
                self.omits("solve", format!("friction along {word}"), Of::Pair, own, why)
                    .kind("row");
            }
        }
        if law == Law::SolRef {
            let why = "μ is 0, but MuJoCo's law uses at least 1e-5; condim 1 removes these rows";
            let name = "friction of contacts, μ 0".into();
            self.push("solve", name, Of::Pair, zero, true, why.into()).kind("row");
        }
    }
}
