//! Islands of a heap: trees that rows tie together now.
//!
//! Where pairs are listed, islands are those that pairs could ever make, so that all lanes have the
//! same. A heap would be one island; here it falls into as many as touch. An island is known by its
//! lowest tree, so that it keeps its name while that stays.

use super::rows::Rows;
use crate::model::{Model, Span, Union};
use crate::real::Real;

/// Working space.
#[derive(Default)]
pub(crate) struct ContactIslands {
    pub(super) union: Union,
    /// By island: how many blocks it has so far.
    blocks: Vec<u32>,
}

room!(ContactIslands: union, blocks);

impl<R: Real> Rows<R> {
    /// Sets the island of every block, and its place there.
    pub(crate) fn find_islands(&mut self, model: &Model<R::Value>, dof_lists: &[usize]) {
        let Some(ContactIslands { union, blocks: counts }) = &mut self.contact_islands else {
            return;
        };
        union.reset(model.trees.len());
        counts.clear();
        counts.resize(model.trees.len(), 0);
        // Blocks of two bodies stand together: their dofs are looked at once.
        let mut last = Span::default();
        for block in &self.blocks {
            let span = self.rows[block.rows.start].dofs;
            if std::mem::replace(&mut last, span) == span {
                continue;
            }
            for two in span.of(dof_lists).windows(2) {
                let [a, b] = [two[0], two[1]].map(|k| model.dofs[k].tree);
                if a != b {
                    union.join(a, b);
                }
            }
        }
        let (mut last, mut island) = (Span::default(), 0);
        for block in &mut self.blocks {
            let span = self.rows[block.rows.start].dofs;
            let Some(dof) = span.of(dof_lists).first() else { continue };
            if std::mem::replace(&mut last, span) != span {
                island = union.of(model.dofs[*dof].tree);
            }
            block.island = island;
            block.rank = counts[block.island];
            counts[block.island] += 1;
        }
    }
}
