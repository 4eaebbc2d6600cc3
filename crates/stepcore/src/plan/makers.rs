//! The kinds of rows that a model can have, in the order of their slots.

/// The file of `elements/` that makes them: see `elements/constraints.rs`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Maker {
    Equalities,
    FrictionLoss,
    Limit,
    Contacts,
}
