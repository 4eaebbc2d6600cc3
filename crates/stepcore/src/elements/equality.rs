//! Equalities tie bodies, joints or tendons together, in the order of the scene's list. Each kind makes
//! its rows in a separate file; the common parts are here.

use super::constraint::{Constraint, Makings};
use super::Element;
use crate::model::{Equality, Model, Tie};
use crate::real::{Mask, Real, Value};
use crate::settings::Law;
use crate::solve::law::{least_softness, OnGuess, SolRef};
use crate::solve::{Part, Rows, Set, Situation, GROUP};

pub(super) struct Equalities;

impl Constraint for Equalities {
    const MOST_ROWS: usize = 2 * GROUP;

    fn any(model: &Model) -> bool {
        model.features.equality && !model.equalities.is_empty()
    }

    fn make<R: Real>(makings: &mut Makings<R>, rows: &mut Rows<R>) {
        let now = makings.now;
        for (index, equality) in now.model.equalities.iter().enumerate() {
            let dofs = equality.dofs.of(now.dof_lists);
            let rests = || dofs.iter().all(|k| now.rests(now.model.dofs[*k].tree));
            let active = now.inputs.eq_active(index);
            if active.none() || dofs.is_empty() || (!now.asleep.is_empty() && rests()) {
                continue;
            }
            match &equality.tie {
                Tie::Connect(ends) => rows.connect(now, index, ends),
                Tie::Weld { ends, torquescale } => rows.weld(now, index, ends, *torquescale),
                Tie::Lengths(coupling) => rows.coupled(now, index, coupling),
            }
        }
    }
}

/// The quantity that one row of an equality holds at zero.
#[derive(Clone, Copy)]
pub(super) struct Held<R: Real> {
    pub gap: R,
    /// J̇ v: its acceleration when no dof accelerates.
    pub curving: R,
    pub invweight: R,
}

impl<R: Real> Rows<R> {
    /// Makes one block of the rows from `first` on. `size`: the length of all the gaps, by which
    /// `solref` chooses one impedance.
    pub(super) fn tie(
        &mut self,
        now: &Situation<R>,
        index: usize,
        first: usize,
        size: R,
        held: &[Held<R>],
    ) {
        let equality: &Equality<R::Value> = &now.model.equalities[index];
        let (dt, law) = (now.settings.dt, OnGuess::new(now));
        let soft = || SolRef::at(&equality.soft, size, dt, now.settings.refsafe);
        let soft = (now.settings.law == Law::SolRef).then(soft);
        // Rows of the same unit share one least softness.
        for (rows, held) in self.rows[first..].chunks_mut(GROUP).zip(held.chunks(GROUP)) {
            let least = least_softness(rows, equality.mass.get());
            for (row, held) in rows.iter_mut().zip(held) {
                if let Some(law) = &soft {
                    law.fill(row, held.gap, held.invweight, least, R::of(dt));
                    row.t -= R::of(dt) * held.curving;
                } else {
                    law.equality(row, held.gap);
                    if now.part == Part::Stage {
                        row.t = row.velocity - R::of(dt) * held.curving;
                    }
                }
            }
        }
        if now.part == Part::End && now.settings.connects_inside() {
            for at in first..self.rows.len() {
                self.rows[at].t = self.dot(now.dof_lists, &self.rows[at], &now.placed.guess);
            }
        }
        let element = Element::whole(equality.kind(), index);
        let active = now.inputs.eq_active(index);
        self.push_block(first, Set::Interval, active, now, element, equality.mass.get());
    }
}
