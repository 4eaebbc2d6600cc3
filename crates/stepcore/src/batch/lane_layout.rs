//! Which world sits in which lane of which group.

use std::ops::Range;

use crate::room::listed;

/// Worlds of one model sit beside each other, in their own order; the last group of a model may
/// have lanes to spare.
pub(super) struct LaneLayout {
    /// The lanes of a group are two to this power.
    power: u32,
    /// By world: group · lanes + lane.
    seat: Vec<usize>,
    /// All worlds in the order of their places.
    worlds: Vec<usize>,
    /// By group: its model, and its worlds' range in `worlds`.
    groups: Vec<(usize, Range<usize>)>,
}

impl LaneLayout {
    /// `lanes`: a power of two; `model_of`: the model of each world.
    pub fn new(lanes: usize, model_of: &[usize]) -> Self {
        let mut worlds: Vec<usize> = (0..model_of.len()).collect();
        worlds.sort_by_key(|world| model_of[*world]);
        let (mut seat, mut groups) = (vec![0; worlds.len()], Vec::new());
        for same in worlds.chunk_by(|a, b| model_of[*a] == model_of[*b]) {
            for together in same.chunks(lanes) {
                for (lane, world) in together.iter().enumerate() {
                    seat[*world] = groups.len() * lanes + lane;
                }
                let start = groups.last().map_or(0, |(_, range): &(usize, _)| end(range));
                groups.push((model_of[together[0]], start..start + together.len()));
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

    /// The model of a group.
    pub fn model(&self, group: usize) -> usize {
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

/// How many registers of so many lanes the worlds fill, if those of a model share them.
pub(super) fn registers(lanes: usize, model_of: &[usize]) -> usize {
    let mut counts = vec![0_usize; model_of.iter().max().map_or(0, |most| most + 1)];
    model_of.iter().for_each(|model| counts[*model] += 1);
    counts.into_iter().map(|count| count.div_ceil(lanes)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worlds_of_a_model_sit_together() {
        let layout = LaneLayout::new(2, &[0, 1, 0, 1, 0]);
        assert_eq!(layout.groups(), 3);
        assert_eq!(layout.worlds(0), [0, 2]);
        assert_eq!(layout.worlds(1), [4]);
        assert_eq!(layout.worlds(2), [1, 3]);
        assert_eq!((0..3).map(|group| layout.model(group)).collect::<Vec<_>>(), [0, 0, 1]);
        for world in 0..5 {
            let (group, lane) = layout.of(world);
            assert_eq!(layout.worlds(group)[lane], world);
        }
        assert_eq!(registers(2, &[0, 1, 0, 1, 0]), 3);
    }
}
