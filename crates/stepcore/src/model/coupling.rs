//! The dofs that the metric of `discrete` couples in addition to the dofs of a tree.
//!
//! A stiffness along a length couples all dofs that move it, and these may be on different
//! branches, or of different trees. M̂ = M + dt·D + dt²·K then has entries where M has none, and
//! its factors fill in. Eliminating dofs from the last to the first, dof k couples all that it
//! touches, S(k); the highest of these, p, is its parent: S(p) takes the rest of S(k) (Liu 1990,
//! elimination trees). Every dof's row is its whole chain of these parents, so that the factors of
//! a tree serve as they are. Where nothing couples branches, parents are the tree's.

use crate::interrupt::checkpoint;
use crate::real::Constant;
use std::collections::{BTreeSet, HashMap};

use super::{Model, Span, Union};
use crate::elements::forces::sloped;

/// Lists of dofs, closed under the parents of the metric; each stored once.
struct Lists {
    /// For each dof: it and its ancestors, ascending.
    chains: Vec<Vec<usize>>,
    known: HashMap<Vec<usize>, Span>,
}

impl Lists {
    fn closed(&mut self, model: &mut Model, span: Span) -> Span {
        let own = span.of(&model.dof_lists);
        checkpoint();
        let all: BTreeSet<usize> = own.iter().flat_map(|k| &self.chains[*k]).copied().collect();
        if all.len() == own.len() {
            return span;
        }
        self.add(model, all.into_iter().collect())
    }

    fn add(&mut self, model: &mut Model, list: Vec<usize>) -> Span {
        let lists = &mut model.dof_lists;
        let len = list.len();
        *self.known.entry(list).or_insert_with_key(|list| {
            let start = lists.len();
            lists.extend(list);
            Span { start, len }
        })
    }
}

/// Closes every list of dofs that rows use.
pub(super) fn close(model: &mut Model) {
    let mut touched: Vec<BTreeSet<usize>> = (0..model.nv).map(|_| BTreeSet::new()).collect();
    sloped(model, &mut |dofs| {
        for (nth, i) in dofs.iter().enumerate() {
            for j in dofs[..nth].iter().filter(|j| model.entry(*i, **j).is_none()) {
                touched[*i.max(j)].insert(*i.min(j));
            }
        }
    });
    model.couples = touched.iter().any(|touched| !touched.is_empty());
    if !model.couples {
        return;
    }
    for (k, dof) in model.dofs.iter().enumerate() {
        touched[k].extend(dof.row.of(&model.row_dofs)[1..].iter());
    }
    let mut parents = vec![None; model.nv];
    for k in (0..model.nv).rev() {
        checkpoint();
        let mut rest = std::mem::take(&mut touched[k]);
        parents[k] = rest.pop_last();
        if let Some(parent) = parents[k] {
            touched[parent].extend(rest);
        }
    }
    let mut chains: Vec<Vec<usize>> = Vec::with_capacity(model.nv);
    for (k, parent) in parents.iter().enumerate() {
        let mut chain = parent.map_or(Vec::new(), |parent| chains[parent].clone());
        chain.push(k);
        chains.push(chain);
    }
    let mut lists = Lists { chains, known: HashMap::new() };
    for k in 0..model.nv {
        model.dofs[k].closed = lists.closed(model, model.dofs[k].closed);
    }
    for body in 0..model.bodies.len() {
        model.bodies[body].closed = lists.closed(model, model.bodies[body].chain);
    }
    for pair in 0..model.pairs.len() {
        model.pairs[pair].dofs = lists.closed(model, model.pairs[pair].dofs);
    }
    for tendon in 0..model.tendons.len() {
        model.tendons[tendon].closed = lists.closed(model, model.tendons[tendon].closed);
    }
    for equality in 0..model.equalities.len() {
        model.equalities[equality].dofs = lists.closed(model, model.equalities[equality].dofs);
    }
}

impl<N: Constant> Model<N> {
    /// Joins the trees that the metric of `discrete` couples.
    pub(super) fn join_coupled(&self, union: &mut Union) {
        sloped(self, &mut |dofs| {
            for two in dofs.windows(2) {
                union.join(self.dofs[two[0]].tree, self.dofs[two[1]].tree);
            }
        });
    }

    /// For each tree: whether some element can have slopes on it.
    pub fn sloped(&self) -> Vec<bool> {
        let mut found = vec![false; self.trees.len()];
        sloped(self, &mut |dofs| dofs.iter().for_each(|dof| found[self.dofs[*dof].tree] = true));
        found
    }
}
