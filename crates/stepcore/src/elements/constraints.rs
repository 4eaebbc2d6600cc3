//! The list of elements that have rows: a new kind is one file and one line here.

use super::constraint::{Constraint, Makings};
use super::contact::Contacts;
use super::equality::Equalities;
use super::friction_loss::FrictionLoss;
use super::limit::Limit;
use crate::detect::Contact;
use crate::model::Model;
use crate::plan::makers::Maker;
use crate::real::Real;
use crate::solve::{Part, Rows, Situation, CONE};
use crate::warm::SLIP;

macro_rules! constraints {
    ($($kind:ident),+ $(,)?) => {
        // The storage and the solvers of blocks have room for blocks of every kind.
        $(const _: () = assert!($kind::MOST_ROWS <= SLIP);
        const _: () = assert!($kind::MOST_CONE_ROWS <= CONE);)+

        /// The kinds of rows that a model can have, in the order of their slots.
        pub(crate) fn makers(model: &Model) -> Vec<Maker> {
            let mut makers = vec![];
            if model.features.constraint {
                $(if $kind::any(model) {
                    makers.push(Maker::$kind);
                })+
            }
            makers
        }

        fn make<R: Real>(maker: Maker, makings: &mut Makings<R>, rows: &mut Rows<R>) {
            match maker {
                $(Maker::$kind => $kind::make(makings, rows)),+
            }
        }
    };
}

// In the order of their slots: see `model/slots.rs`.
constraints!(Equalities, FrictionLoss, Limit, Contacts);

impl<R: Real> Rows<R> {
    /// Makes every row that exists now.
    pub fn make(&mut self, now: &Situation<R>, contacts: &mut [Contact<R>]) {
        self.begin(&now.placed.guess);
        let ties = matches!(now.part, Part::Start | Part::Stage);
        let mut makings = Makings { now, contacts };
        for maker in &now.model.makers {
            if !ties || *maker == Maker::Equalities {
                make(*maker, &mut makings, self);
            }
        }
        self.find_islands(now.model, now.dof_lists);
    }

    /// Clears the rows and starts from this guess.
    pub(crate) fn begin(&mut self, guess: &[R]) {
        self.clear();
        self.u.copy_from_slice(guess);
    }
}
