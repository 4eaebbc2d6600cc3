//! Islands of a pile: trees that rows connect in the current step.
//!
//! If pairs are listed, islands are the ones that pairs could ever form, so that all lanes have the
//! same. A pile would be one such island; here it splits into those that touch. An island is
//! identified by its lowest tree, so that its name stays while that tree stays.

use super::rows::Rows;
use crate::model::{Model, Span, Union};
use crate::real::Real;

/// Working space.
#[derive(Default)]
pub(crate) struct ContactIslands {
    pub(super) union: Union,
    /// Per island: the number of its blocks up to here.
    blocks: Vec<u32>,
}

room!(ContactIslands: union, blocks);

impl<R: Real> Rows<R> {
    /// Sets the island of every block, and the block's place in it.
    pub(crate) fn find_islands(&mut self, model: &Model<R::Value>, dof_lists: &[usize]) {
        let Some(ContactIslands { union, blocks: counts }) = &mut self.contact_islands else {
            return;
        };
        union.reset(model.trees.len());
        counts.clear();
        counts.resize(model.trees.len(), 0);
        // Blocks of the same two bodies are adjacent: their dofs are examined once.
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
