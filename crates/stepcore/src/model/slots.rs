//! The slots that identify elements with rows from step to step: one number for each, in the order
//! in which their rows are made.

use super::dynamic_pairs::MOST_TOUCHES;
use super::parts::{Slots, SIDES};
use super::{Model, Pair, Span, NONE};
use crate::elements::{Element, Kind};
use crate::real::Constant;
use std::ops::Range;

impl Slots {
    pub(super) fn of(model: &Model) -> Self {
        let losses = model.equalities.len();
        let tendon_losses = losses + model.nv;
        let limits = tendon_losses + model.tendons.len();
        let tendon_limits = limits + SIDES * model.joints.len();
        let contacts = tendon_limits + SIDES * model.tendons.len();
        Self { losses, tendon_losses, limits, tendon_limits, contacts }
    }
}

impl<N: Constant> Model<N> {
    /// The slot of an equality, friction loss, limit or contact.
    pub fn slot(&self, element: Element) -> u64 {
        let (index, part) = (element.index as usize, element.part as usize);
        let slot = match element.kind {
            Kind::FrictionLoss => self.slots.losses + self.joints[index].dof + part,
            Kind::TendonFriction => self.slots.tendon_losses + index,
            Kind::Limit => self.slots.limits + SIDES * index + part,
            Kind::TendonLimit => self.slots.tendon_limits + SIDES * index + part,
            Kind::Contact => {
                let fixed = self.pairs.get(index).map(|pair| pair.slot);
                self.slots.contacts + fixed.unwrap_or(index * MOST_TOUCHES) + part
            }
            // Equalities come first; nothing else has rows.
            _ => index,
        };
        slot as u64
    }

    /// The slots in which a contact of a pair may have been in the step before: the same slot, or
    /// any of the pair's if contacts are identified by feature.
    pub fn kin<P>(&self, pair: &Pair<P>, part: usize) -> Range<u64> {
        let first = (self.slots.contacts + pair.slot) as u64;
        if pair.test.by_feature() {
            return first..first + pair.test.most_touches() as u64;
        }
        let own = first + part as u64;
        own..own + 1
    }

    /// For each slot: its place among the slots of its island. Copies of an island in one scene
    /// have the same ranks.
    pub fn ranks(&self, islands: &[usize]) -> Vec<u32> {
        let tree = |body: usize| self.bodies[body].tree;
        let either = |a: usize, b: usize| tree(if tree(a) == NONE { b } else { a });
        let losses = self.dofs.iter().map(|dof| dof.tree);
        let limits = self.joints.iter().flat_map(|joint| [tree(joint.body); SIDES]);
        let moved =
            |dofs: Span| dofs.of(&self.dof_lists).first().map_or(NONE, |dof| self.dofs[*dof].tree);
        let ties = self.equalities.iter().map(|equality| moved(equality.dofs));
        let tendon_losses = self.tendons.iter().map(|tendon| moved(tendon.closed));
        let tendon_limits = self.tendons.iter().flat_map(|t| [moved(t.closed); SIDES]);
        let contacts = self.pairs.iter().flat_map(|p| {
            let tree = either(self.geoms[p.geom1].body, self.geoms[p.geom2].body);
            std::iter::repeat_n(tree, p.test.most_touches())
        });
        let mut used = vec![0; islands.len()];
        ties.chain(losses)
            .chain(tendon_losses)
            .chain(limits)
            .chain(tendon_limits)
            .chain(contacts)
            .map(|tree| {
                // Ties of the world to itself have no rows.
                let Some(island) = islands.get(tree) else { return 0 };
                used[*island] += 1;
                used[*island] - 1
            })
            .collect()
    }
}
