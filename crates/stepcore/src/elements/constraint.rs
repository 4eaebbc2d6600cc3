//! The trait of elements that have rows.

use crate::detect::Contact;
use crate::model::Model;
use crate::real::Real;
use crate::solve::{Rows, Situation};

/// The input of row makers, with the contacts that they judge.
pub(crate) struct Makings<'a, R: Real> {
    pub now: &'a Situation<'a, R>,
    pub contacts: &'a mut [Contact<R>],
}

/// A kind of element that has rows.
pub(crate) trait Constraint {
    /// The largest number of rows of one block, and of one that is a cone.
    const MOST_ROWS: usize;
    const MOST_CONE_ROWS: usize = 0;

    /// Checks whether a model has any that is switched on.
    fn any(model: &Model) -> bool;

    /// Makes the rows of all its elements that exist now.
    fn make<R: Real>(makings: &mut Makings<R>, rows: &mut Rows<R>);
}
