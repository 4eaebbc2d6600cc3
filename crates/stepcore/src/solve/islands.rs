//! The blocks of each island, which can be solved by itself.

use super::rows::{Block, Rows, Set};
use crate::model::Model;
use crate::real::{Count, Mask, Real};

/// Blocks, island after island.
#[derive(Default)]
pub(super) struct Islands {
    /// Block indices, ascending within an island.
    blocks: Vec<usize>,
    /// One past the last entry of each island in `blocks`.
    ends: Vec<usize>,
}

room!(Islands: blocks, ends);

impl Islands {
    /// A counting sort: stable, and without allocation once it has room.
    pub fn sort<R: Real>(&mut self, blocks: &[Block<R>]) {
        let islands = blocks.iter().map(|b| b.island + 1).max().unwrap_or(0);
        self.ends.clear();
        self.ends.resize(islands, 0);
        for block in blocks {
            self.ends[block.island] += 1;
        }
        let mut start = 0;
        for end in &mut self.ends {
            let count = *end;
            *end = start;
            start += count;
        }
        self.blocks.clear();
        self.blocks.resize(blocks.len(), 0);
        for (at, block) in blocks.iter().enumerate() {
            let place = &mut self.ends[block.island];
            self.blocks[*place] = at;
            *place += 1;
        }
    }

    /// Returns the block indices of one island.
    pub fn of(&self, island: usize) -> &[usize] {
        let start = if island == 0 { 0 } else { self.ends[island - 1] };
        &self.blocks[start..self.ends[island]]
    }

    pub fn count(&self) -> usize {
        self.ends.len()
    }
}

impl<R: Real> Rows<R> {
    /// Measures the islands of the current rows; `mass` in the layout of `Model::row_dofs`.
    pub(crate) fn weigh_islands(&mut self, model: &Model<R::Value>, mass: &[R]) {
        let Self { islands, contact_islands: now, inertia, .. } = self;
        inertia.clear();
        inertia.resize(model.trees.len(), R::zero());
        for (tree, own) in model.trees.iter().enumerate() {
            let island = now.as_mut().map_or_else(|| islands[tree], |now| now.union.of(tree));
            for dof in &model.dofs[own.dofs.range()] {
                inertia[island] += mass[dof.row.start];
            }
        }
    }
}

/// Returns the lanes in which an island has some block.
pub(super) fn alive<R: Real>(rows: &Rows<R>, blocks: &[usize]) -> R::Mask {
    blocks.iter().fold(R::Mask::of(false), |mask, b| mask.or(rows.blocks[*b].mask))
}

/// Returns the lanes in which all rows of these blocks are intervals, at most `most` of them. A
/// lane's rows alone decide, whatever its neighbours have.
pub(super) fn intervals_at_most<R: Real>(rows: &Rows<R>, blocks: &[usize], most: u64) -> R::Mask {
    let mut intervals = R::Mask::of(true);
    for block in blocks.iter().map(|b| &rows.blocks[*b]) {
        if block.set != Set::Interval {
            intervals = intervals.and(block.mask.not());
        }
    }
    intervals.and(row_count(rows, blocks).at_most(most))
}

/// Returns the number of rows of these blocks in each lane.
pub(super) fn row_count<R: Real>(rows: &Rows<R>, blocks: &[usize]) -> Count {
    let mut count = Count::ZERO;
    for block in blocks.iter().map(|b| &rows.blocks[*b]) {
        count.add(block.mask, block.rows.len as u64);
    }
    count
}
