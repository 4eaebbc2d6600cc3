//! The list of elements that are rows: a new kind is one file and one line here.

use super::constraint::{Constraint, Makings};
use super::contact::Contacts;
use super::equality::Equalities;
use super::friction_loss::FrictionLoss;
use super::limit::Limit;
use super::tendon_friction::TendonFriction;
use super::tendon_limit::TendonLimit;
use crate::detect::Contact;
use crate::model::Model;
use crate::real::Real;
use crate::solve::{Part, Rows, Situation, CONE};
use crate::warm::SLIP;

macro_rules! constraints {
    ($($kind:ident),+ $(,)?) => {
        // What keeps and solves blocks has room for those of every kind.
        $(const _: () = assert!($kind::MOST_ROWS <= SLIP);
        const _: () = assert!($kind::MOST_CONE_ROWS <= CONE);)+

        /// The model can have rows at all.
        fn any(model: &Model) -> bool {
            $($kind::any(model))||+
        }

        fn make_all<R: Real>(makings: &mut Makings<R>, rows: &mut Rows<R>) {
            $($kind::make(makings, rows);)+
        }
    };
}

// In the order of their slots: see `model/slots.rs`.
constraints!(Equalities, FrictionLoss, TendonFriction, Limit, TendonLimit, Contacts);

impl<R: Real> Rows<R> {
    /// Makes every row that exists now.
    pub fn make(&mut self, now: &Situation<R>, contacts: &mut [Contact<R>]) {
        self.clear();
        self.u.copy_from_slice(&now.placed.guess);
        if now.model.features.constraint && any(now.model) {
            let mut makings = Makings { now, contacts };
            match now.part {
                Part::Whole | Part::End => make_all(&mut makings, self),
                Part::Start | Part::Stage => Equalities::make(&mut makings, self),
            }
            self.find_islands(now.model, now.dof_lists);
        }
    }
}
