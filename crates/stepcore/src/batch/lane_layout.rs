//! The group and the lane of each world.

use std::ops::Range;
use std::sync::Arc;

use crate::model::{differ_in_numbers, Model};
use crate::real::Constant;
use crate::room::listed;
use crate::settings::{Settings, Solver};
use crate::solve::dofs::any_heap;

/// Worlds of one model are next to each other, then those whose models differ in numbers alone, in
/// their order; the last group of such models may have spare lanes.
pub(super) struct LaneLayout {
    /// The lanes of a group are two to this power.
    power: u32,
    /// For each world: group · lanes + lane.
    seat: Vec<usize>,
    /// All worlds in the order of their places.
    worlds: Vec<usize>,
    /// For each group: the kind of its models, and its worlds' range in `worlds`.
    groups: Vec<(usize, Range<usize>)>,
}

impl LaneLayout {
    /// `lanes`: a power of two; `kinds`: each model's kind, `model_of`: each world's model.
    pub fn new(lanes: usize, kinds: &[usize], model_of: &[usize]) -> Self {
        let kind = |world: usize| kinds[model_of[world]];
        let mut worlds: Vec<usize> = (0..model_of.len()).collect();
        worlds.sort_by_key(|world| (kind(*world), model_of[*world]));
        let (mut seat, mut groups) = (vec![0; worlds.len()], Vec::new());
        for same in worlds.chunk_by(|a, b| kind(*a) == kind(*b)) {
            for together in same.chunks(lanes) {
                for (lane, world) in together.iter().enumerate() {
                    seat[*world] = groups.len() * lanes + lane;
                }
                let start = groups.last().map_or(0, |(_, range): &(usize, _)| end(range));
                groups.push((kind(together[0]), start..start + together.len()));
            }
        }
        Self { power: lanes.trailing_zeros(), seat, worlds, groups }
    }

    /// Memory [bytes].
    pub fn bytes(&self) -> usize {
        listed(&self.seat) + listed(&self.worlds) + listed(&self.groups)
    }

    /// The group and the lane of a world.
    #[inline(always)]
    pub fn of(&self, world: usize) -> (usize, usize) {
        (self.seat[world] >> self.power, self.seat[world] & ((1 << self.power) - 1))
    }

    /// The worlds of a group, by lane.
    pub fn worlds(&self, group: usize) -> &[usize] {
        &self.worlds[self.groups[group].1.clone()]
    }

    /// The worlds of groups that follow each other.
    pub fn of_groups(&self, groups: Range<usize>) -> &[usize] {
        &self.worlds[self.groups[groups.start].1.start..self.groups[groups.end - 1].1.end]
    }

    /// All worlds in the order of their places.
    pub fn all(&self) -> &[usize] {
        &self.worlds
    }

    /// The kind of a group's models.
    pub fn kind(&self, group: usize) -> usize {
        self.groups[group].0
    }

    /// How many groups there are.
    pub fn groups(&self) -> usize {
        self.groups.len()
    }
}

fn end(range: &Range<usize>) -> usize {
    range.end
}

/// The number of registers of this many lanes that the worlds fill, if those of a kind share them.
fn registers(lanes: usize, kinds: &[usize], model_of: &[usize]) -> usize {
    let mut counts = vec![0_usize; kinds.iter().max().map_or(0, |most| most + 1)];
    model_of.iter().for_each(|model| counts[kinds[*model]] += 1);
    counts.into_iter().map(|count| count.div_ceil(lanes)).sum()
}

/// Whether worlds of a model can be stepped in lanes, and gain by it. The pairs of a pile are found
/// one world at a time, and so are sleeping trees; Newton's method solves a pile so too; and with
/// adaptive steps each world has different steps.
pub fn gains_by_lanes<N: Constant>(model: &Model<N>, settings: &Settings) -> bool {
    let by_lane = settings.solver == Solver::Newton && any_heap(&model.islands());
    let own_steps = settings.accuracy.0.is_some();
    model.dynamic_pairs.is_none() && !settings.sleep && !by_lane && !own_steps
}

/// Whether worlds of several models fill lanes well enough: worlds of a kind share a register, and
/// a register costs about as much as three worlds alone.
pub fn fills_lanes(kinds: &[usize], model_of: &[usize], lanes: usize) -> bool {
    let one = kinds.iter().all(|kind| *kind == 0);
    one || 3 * registers(lanes, kinds, model_of) <= model_of.len()
}

/// The kind of each model: models of one kind differ in numbers alone; their worlds can share
/// lanes.
pub fn kinds(models: &[Arc<Model>]) -> Vec<usize> {
    let mut first: Vec<&Arc<Model>> = vec![];
    let mut kind = |model| {
        let known = first.iter().position(|other| differ_in_numbers(other, model));
        known.unwrap_or_else(|| {
            first.push(model);
            first.len() - 1
        })
    };
    models.iter().map(&mut kind).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worlds_of_a_model_sit_together() {
        let layout = LaneLayout::new(2, &[0, 1], &[0, 1, 0, 1, 0]);
        assert_eq!(layout.groups(), 3);
        assert_eq!(layout.worlds(0), [0, 2]);
        assert_eq!(layout.worlds(1), [4]);
        assert_eq!(layout.worlds(2), [1, 3]);
        assert_eq!((0..3).map(|group| layout.kind(group)).collect::<Vec<_>>(), [0, 0, 1]);
        for world in 0..5 {
            let (group, lane) = layout.of(world);
            assert_eq!(layout.worlds(group)[lane], world);
        }
        assert_eq!(registers(2, &[0, 1], &[0, 1, 0, 1, 0]), 3);
    }

    #[test]
    fn worlds_of_a_kind_share_a_register() {
        let layout = LaneLayout::new(4, &[0, 0, 1, 0], &[3, 2, 1, 0, 1]);
        assert_eq!(layout.worlds(0), [3, 2, 4, 0]);
        assert_eq!(layout.worlds(1), [1]);
        assert_eq!([layout.kind(0), layout.kind(1)], [0, 1]);
        assert_eq!(registers(4, &[0, 0, 1, 0], &[3, 2, 1, 0, 1]), 2);
    }
}
