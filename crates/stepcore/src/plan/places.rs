//! The things that a step places, in order, and how: decided when a model is compiled.

/// How a body is placed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Way {
    /// A free joint: the first of its positions, and its first dof.
    Free { qpos: usize, dof: usize },
    /// It never turns.
    Sliding,
    /// Its tree moves in a plane.
    Planar,
    /// Through its joints, one by one.
    Jointed,
}

/// The part of a geom's pose that contacts need.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Part {
    Centre,
    /// And one axis.
    Axis,
    Whole,
}

/// Something on a tree that sleeps with it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Place<T> {
    pub index: usize,
    pub tree: usize,
    pub how: T,
}

/// Everything that a step places.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Places {
    pub bodies: Vec<Place<Way>>,
    pub geoms: Vec<Place<Part>>,
    /// Trees whose mass matrix and bias force change.
    pub weighed: Vec<usize>,
}
