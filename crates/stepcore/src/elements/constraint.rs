//! The kinds of elements that are rows, and the list of them. A new one is one file and one
//! line at the end of this file.

use super::connect::Connect;
use super::contact::Contacts;
use super::friction_loss::FrictionLoss;
use super::limit::Limit;
use crate::detect::Detected;
use crate::model::Model;
use crate::real::Real;
use crate::solve::{Rows, Situation, CONE};
use crate::state::WARM_ROWS;

/// What row makers read, and the contacts that they judge.
pub(crate) struct Makings<'a, R: Real> {
    pub now: &'a Situation<'a, R>,
    pub detected: &'a mut Detected<R>,
}

/// One kind of element that is rows.
pub(crate) trait Constraint {
    /// The most rows of one block, and of one that is a cone.
    const MOST_ROWS: usize;
    const MOST_CONE_ROWS: usize = 0;

    /// Whether a model has any, so that a step asks at all.
    fn any(model: &Model) -> bool;

    /// Makes the rows of all its elements that exist now.
    fn make<R: Real>(makings: &mut Makings<R>, rows: &mut Rows<R>);
}

macro_rules! constraints {
    ($($kind:ident),+ $(,)?) => {
        // What keeps and solves blocks has room for those of every kind.
        $(const _: () = assert!($kind::MOST_ROWS <= WARM_ROWS);
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
constraints!(Connect, FrictionLoss, Limit, Contacts);

impl<R: Real> Rows<R> {
    /// Makes every row that exists now.
    pub fn make(&mut self, now: &Situation<R>, detected: &mut Detected<R>) {
        self.clear();
        self.u.copy_from_slice(&now.placed.guess);
        if now.model.features.constraint && any(now.model) {
            make_all(&mut Makings { now, detected }, self);
            self.assign_islands(now.model);
        }
    }
}
