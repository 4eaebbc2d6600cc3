//! How many pairs of geoms can meet, and how many never do and why, without a loop over the pairs.
//!
//! Geoms of one kind with the same bits are of one sort. A reason that separates two bodies
//! separates all their geoms, so pairs are counted by two sorts: all pairs, less the pairs within a
//! body, on bodies without a joint between them, on excluded bodies, and on a body and its parent.
//! The remaining pairs can meet if the bits of the two sorts do.

use super::pairs::Never;
use super::Model;
use crate::plan::{Unmet, EXAMPLES};
use crate::scene::GeomType;
use std::collections::BTreeMap;

/// Pairs examined for examples.
const LOOKED_AT: usize = 1000;

/// Geoms by sort.
type Sorts = BTreeMap<usize, usize>;
/// Pairs by two sorts, the lower one first.
type Counts = BTreeMap<(usize, usize), usize>;

/// The counts of the pairs of a pile.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Pairs that can meet, by the two kinds of geoms.
    pub meet: BTreeMap<(GeomType, GeomType), usize>,
    pub never: BTreeMap<Never, Unmet>,
}

fn within(sorts: &Sorts, into: &mut Counts) {
    let list: Vec<(usize, usize)> = sorts.iter().map(|(sort, n)| (*sort, *n)).collect();
    for (k, &(one, n)) in list.iter().enumerate() {
        *into.entry((one, one)).or_default() += n * (n - 1) / 2;
        for &(two, m) in &list[k + 1..] {
            *into.entry((one, two)).or_default() += n * m;
        }
    }
}

fn between(first: &Sorts, second: &Sorts, into: &mut Counts) {
    for (one, n) in first {
        for (two, m) in second {
            *into.entry((*one.min(two), *one.max(two))).or_default() += n * m;
        }
    }
}

fn take(from: &mut Counts, counts: &Counts) {
    for (sorts, n) in counts {
        if let Some(left) = from.get_mut(sorts) {
            *left -= (*left).min(*n);
        }
    }
}

struct Count<'a> {
    model: &'a Model,
    solid: Vec<usize>,
    /// The geoms of each sort.
    sorts: Vec<Vec<usize>>,
    by_body: Vec<Sorts>,
    by_weld: Vec<Sorts>,
    /// Pairs that no reason has removed yet.
    left: Counts,
    tally: Tally,
}

impl Model {
    /// Counts the pairs of a pile: see `Tally`.
    pub fn tally(&self) -> Tally {
        let solid = (0..self.geoms.len())
            .filter(|g| self.geoms[*g].contype != 0 || self.geoms[*g].conaffinity != 0);
        let mut count = Count {
            model: self,
            solid: solid.collect(),
            sorts: vec![],
            by_body: vec![Sorts::new(); self.bodies.len()],
            by_weld: vec![Sorts::new(); self.bodies.len()],
            left: Counts::new(),
            tally: Tally::default(),
        };
        count.sort();
        count.bodies();
        count.bits();
        count.explicit();
        count.tally
    }
}

impl Count<'_> {
    fn sort(&mut self) {
        let (mut known, mut all) = (BTreeMap::new(), Sorts::new());
        for &geom in &self.solid {
            let shape = &self.model.geoms[geom];
            let next = known.len();
            let bits = (shape.kind, shape.contype, shape.conaffinity);
            let sort = *known.entry(bits).or_insert(next);
            self.sorts.resize(known.len(), vec![]);
            self.sorts[sort].push(geom);
            *all.entry(sort).or_default() += 1;
            *self.by_body[shape.body].entry(sort).or_default() += 1;
            let body = &self.model.bodies[shape.body];
            let weld = if body.tree == super::NONE { 0 } else { body.weld };
            *self.by_weld[weld].entry(sort).or_default() += 1;
        }
        within(&all, &mut self.left);
    }

    /// Removes the pairs that bodies keep apart.
    fn bodies(&mut self) {
        let model = self.model;
        let weld = |body: usize| model.bodies[body].weld;
        if !(model.features.contact && model.features.constraint) {
            let all = self.left.clone();
            return self.note(Never::Off, &all);
        }
        let mut same = Counts::new();
        self.by_body.iter().for_each(|sorts| within(sorts, &mut same));
        let mut fixed = Counts::new();
        self.by_weld.iter().for_each(|sorts| within(sorts, &mut fixed));
        take(&mut fixed, &same);
        let (mut excluded, mut both) = (Counts::new(), Counts::new());
        let parent = |child: usize| weld(model.bodies[child].parent);
        let family = |a: usize, b: usize| a != 0 && b != 0 && (parent(a) == b || parent(b) == a);
        for &(one, two) in model.excludes.iter().filter(|(one, two)| weld(*one) != weld(*two)) {
            between(&self.by_body[one], &self.by_body[two], &mut excluded);
            if family(weld(one), weld(two)) {
                between(&self.by_body[one], &self.by_body[two], &mut both);
            }
        }
        let mut relatives = Counts::new();
        let heads = (1..model.bodies.len()).filter(|body| weld(*body) == *body);
        for child in heads.filter(|body| model.features.filterparent && parent(*body) != 0) {
            between(&self.by_weld[child], &self.by_weld[parent(child)], &mut relatives);
        }
        take(&mut relatives, &both);
        for (why, counts) in [
            (Never::SameBody, same),
            (Never::Fixed, fixed),
            (Never::Excluded, excluded),
            (Never::Family, relatives),
        ] {
            self.note(why, &counts);
        }
    }

    /// Removes the pairs that the bits keep apart; the rest can meet.
    fn bits(&mut self) {
        for (sorts, count) in std::mem::take(&mut self.left) {
            let [one, two] = [sorts.0, sorts.1].map(|sort| self.sorts[sort][0]);
            match self.model.never_by_kind(one, two) {
                Some(why) => self.note(why, &Counts::from([(sorts, count)])),
                None if count > 0 => {
                    let kinds = [one, two].map(|geom| self.model.geoms[geom].kind);
                    let kinds = (kinds[0].min(kinds[1]), kinds[0].max(kinds[1]));
                    *self.tally.meet.entry(kinds).or_default() += count;
                }
                None => {}
            }
        }
    }

    /// Adds explicit pairs, which meet whatever the other rules are for their geoms.
    fn explicit(&mut self) {
        let model = self.model;
        for &(a, b) in &model.explicit {
            let bodies = [a, b].map(|geom| model.geoms[geom].body);
            let why = model.never_between(bodies[0], bodies[1]);
            let still = matches!(why, Some(Never::Off | Never::SameBody | Never::Fixed));
            let Some(why) = why.or_else(|| model.never_by_kind(a, b)).filter(|_| !still) else {
                continue;
            };
            let kinds = [a, b].map(|geom| model.geoms[geom].kind);
            *self
                .tally
                .meet
                .entry((kinds[0].min(kinds[1]), kinds[0].max(kinds[1])))
                .or_default() += 1;
            let solid =
                |geom: &usize| model.geoms[*geom].contype | model.geoms[*geom].conaffinity != 0;
            if [a, b].iter().all(solid) {
                if let Some(unmet) = self.tally.never.get_mut(&why) {
                    unmet.count -= unmet.count.min(1);
                }
            }
        }
        self.tally.never.retain(|_, unmet| unmet.count > 0);
    }

    /// Records that these pairs never meet for this reason.
    fn note(&mut self, why: Never, counts: &Counts) {
        take(&mut self.left, counts);
        let count: usize = counts.values().sum();
        if count > 0 {
            let examples = self.examples(why, counts);
            let unmet = self.tally.never.entry(why).or_default();
            unmet.count += count;
            unmet.examples.extend(examples);
            unmet.examples.truncate(EXAMPLES);
        }
    }

    /// The first few pairs that a short search finds.
    fn examples(&self, why: Never, counts: &Counts) -> Vec<(usize, usize)> {
        let model = self.model;
        let pairs = counts.keys().flat_map(|(one, two)| {
            let (first, second) = (&self.sorts[*one], &self.sorts[*two]);
            let neighbours = move |at: usize| first[at..].iter().chain(second).take(LOOKED_AT / 8);
            let pairs = (0..first.len()).flat_map(move |at| {
                neighbours(at).map(move |other| (first[at].min(*other), first[at].max(*other)))
            });
            pairs.take(LOOKED_AT)
        });
        let meets = |(a, b): &(usize, usize)| {
            let bodies = [*a, *b].map(|geom| model.geoms[geom].body);
            let by_kind = || model.never_by_kind(*a, *b);
            let never = model.never_between(bodies[0], bodies[1]).or_else(by_kind);
            a != b && never == Some(why) && !model.explicit.contains(&(*a, *b))
        };
        let mut found: Vec<_> = pairs.filter(meets).take(4 * EXAMPLES).collect();
        found.sort_unstable();
        found.dedup();
        found.truncate(EXAMPLES);
        found
    }
}
