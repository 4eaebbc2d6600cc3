//! Explicit pairs, and the override of the parameters of contacts.

use super::Softness;

/// Two geoms that collide regardless of their bodies, masks and excludes, with separate contact
/// parameters: MuJoCo's `pair`.
#[derive(Clone, Debug, PartialEq)]
pub struct ExplicitPair {
    pub name: String,
    pub geom1: usize,
    pub geom2: usize,
    pub condim: u32,
    /// Sliding along both tangents [1], torsional [m], rolling about both [m].
    pub friction: [f64; 5],
    /// A contact has rows below `margin` [m] and is listed up to `gap` above that.
    pub margin: f64,
    pub gap: f64,
    pub soft: Softness,
    /// The solref of the friction rows of a cone; None: the one of `soft`.
    pub solreffriction: Option<[f64; 2]>,
    /// The largest pulling force of each of its contacts [N].
    pub adhesion: f64,
}

impl Default for ExplicitPair {
    fn default() -> Self {
        Self {
            name: String::new(),
            geom1: 0,
            geom2: 0,
            condim: 3,
            friction: [1.0, 1.0, 0.005, 0.0001, 0.0001],
            margin: 0.0,
            gap: 0.0,
            soft: Softness::default(),
            solreffriction: None,
            adhesion: 0.0,
        }
    }
}

/// Contact parameters that override every contact's: MuJoCo's `o_margin` and others.
#[derive(Clone, Debug, PartialEq)]
pub struct ContactOverride {
    pub margin: f64,
    pub friction: [f64; 5],
    pub soft: Softness,
}
