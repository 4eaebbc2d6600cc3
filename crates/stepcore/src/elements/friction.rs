//! The ways in which a contact's friction pushes: along two tangents (condim 3), about the normal
//! (torsion, condim 4), and about both tangents (rolling, condim 6).
//!
//! Each way j has a coefficient, and friction is bounded by Σ (λ_j/μ_j)² ≤ λ_n² (round) or by
//! |λ_j| ≤ μ_j λ_n (box, and the edges J_n ± μ_j J_j of a pyramid). A row is made in the measure that
//! makes μ_j the coefficient μ of the first: its Jacobian is (μ_j/μ) J_j, and its impulse λ_j μ/μ_j, so
//! that torsion and rolling, whose μ_j are lengths, are velocities [m/s] and impulses [N·s] as well.
//! Then the solvers need one cone only, |λ_t| ≤ μ λ_n, and MuJoCo's regulariser R_j = R₁ μ₁²/μ_j² is
//! one number for all.

use crate::model::{Material, Model, Pair};
use crate::real::{Constant, Real, Value};
use crate::settings::Law;

/// MuJoCo's `mjMINMU`: under `solref` no coefficient of friction is smaller.
const LEAST: f64 = 1e-5;
/// Two tangents, the normal, and both tangents again.
pub(crate) const MOST_WAYS: usize = 5;

/// The axis of a way, along or about which friction acts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Axis {
    Normal,
    Tangent(usize),
}

/// One way that has a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Way<R: Real> {
    pub axis: Axis,
    /// It turns about its axis instead of sliding along it.
    pub turns: bool,
    /// μ_j/μ: the scale of its row over J_j.
    pub scale: R,
}

/// The axis of each way, and whether the way turns, in the order of `Material::friction`.
const DIRECTIONS: [(Axis, bool); MOST_WAYS] = [
    (Axis::Tangent(0), false),
    (Axis::Tangent(1), false),
    (Axis::Normal, true),
    (Axis::Tangent(0), true),
    (Axis::Tangent(1), true),
];

/// The ways of a contact that have rows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ways<R: Real> {
    list: [Way<R>; MOST_WAYS],
    count: usize,
    /// The number of ways without rows, because nothing can move in them.
    pub still: usize,
    /// The coefficient of the first way, which is the cone's.
    pub mu: R,
    /// Some coefficient is not zero.
    pub rubs: bool,
    /// MuJoCo's μ₁, which its regularisers use, and its share of μ.
    pub slide: R,
    pub share: R,
}

/// Returns the number of ways in which the friction of a pair's contacts has rows: under `solref`, and
/// under the other laws; and the number of its ways in which nothing can move.
pub fn ways(model: &Model, pair: &Pair) -> (usize, usize, usize) {
    let material = model.material(pair);
    let soft = Ways::<f64>::soft(pair.still, material);
    let plain = Ways::<f64>::plain(pair.still, material);
    (soft.list().len(), plain.list().len(), soft.still)
}

impl<R: Real> Ways<R> {
    /// Returns the ways under the law for a contact whose tangents are `still`.
    pub fn under(law: Law, still: [bool; 2], material: &Material<R::Value>) -> Self {
        if law == Law::SolRef {
            Self::soft(still, material)
        } else {
            Self::plain(still, material)
        }
    }

    /// Returns the ways under `solref`: every coefficient is at least MuJoCo's least.
    pub fn soft(still: [bool; 2], material: &Material<R::Value>) -> Self {
        Self::of(still, material, LEAST)
    }

    /// Returns the ways under the other laws: a way without friction has no row.
    pub fn plain(still: [bool; 2], material: &Material<R::Value>) -> Self {
        Self::of(still, material, 0.0)
    }

    fn of(fixed: [bool; 2], material: &Material<R::Value>, least: f64) -> Self {
        let own = &material.friction;
        let bounded = |mu: &R::Value| Value::calc([mu], |[mu]| mu.max(least));
        let one = R::one();
        // Most coefficients are equal, and a division takes as long as a row's other numbers.
        let ratio = |a: &R::Value, b: &R::Value| match a == b {
            true => one,
            false => Value::calc([a, b], |[a, b]| a.max(least) / b.max(least)),
        };
        let mut ways = Self {
            list: DIRECTIONS.map(|(axis, turns)| Way { axis, turns, scale: one }),
            count: 0,
            still: 0,
            mu: R::zero(),
            rubs: false,
            slide: bounded(&own[0]),
            share: one,
        };
        let directions = material.condim.saturating_sub(1) as usize;
        let mut first = None;
        for (direction, friction) in own.iter().enumerate().take(directions) {
            if fixed.get(direction) == Some(&true) {
                ways.still += 1;
            } else if least > 0.0 || friction.is_positive() {
                let first = *first.get_or_insert_with(|| {
                    ways.mu = bounded(friction);
                    ways.share = ratio(&own[0], friction);
                    friction
                });
                let (axis, turns) = DIRECTIONS[direction];
                ways.list[ways.count] = Way { axis, turns, scale: ratio(friction, first) };
                ways.count += 1;
            }
        }
        if ways.count == 0 {
            ways.mu = ways.slide;
        }
        ways.rubs = ways.count > 0 || least > 0.0 || own[0].is_positive();
        ways
    }

    pub fn list(&self) -> &[Way<R>] {
        &self.list[..self.count]
    }

    /// Returns the physical size of one unit of a cone row's impulse [1, or m].
    pub fn scale_of_row(&self, row: usize) -> R {
        match row.checked_sub(1).and_then(|way| self.list().get(way)) {
            Some(way) => way.scale,
            None => R::one(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Softness;

    fn material(condim: u32, friction: [f64; 5]) -> Material {
        Material {
            condim,
            friction,
            margin: 0.0,
            gap: 0.0,
            soft: Softness::default(),
            solreffriction: None,
            adhesion: 0.0,
        }
    }

    #[test]
    fn ways_are_in_the_measure_of_the_first() {
        let all = material(6, [0.5, 0.5, 0.01, 0.002, 0.002]);
        let ways = Ways::<f64>::soft([false; 2], &all);
        let found: Vec<_> = ways.list().iter().map(|way| (way.axis, way.turns)).collect();
        let (first, second) = (Axis::Tangent(0), Axis::Tangent(1));
        let want = [(first, false), (second, false), (Axis::Normal, true)];
        assert_eq!(found, [want.as_slice(), &[(first, true), (second, true)]].concat());
        let scales: Vec<f64> = ways.list().iter().map(|way| way.scale).collect();
        assert_eq!((ways.mu, ways.share, ways.still), (0.5, 1.0, 0));
        assert_eq!(scales, [1.0, 1.0, 0.02, 0.004, 0.004]);
        let rows: Vec<f64> = (0..6).map(|row| ways.scale_of_row(row)).collect();
        assert_eq!(rows, [1.0, 1.0, 1.0, 0.02, 0.004, 0.004]);
    }

    #[test]
    fn ways_without_friction_or_motion_have_no_rows() {
        let torsion = material(4, [0.0, 0.0, 0.01, 0.002, 0.002]);
        assert_eq!(Ways::<f64>::plain([false; 2], &torsion).list().len(), 1);
        assert_eq!(Ways::<f64>::plain([false; 2], &torsion).mu, 0.01);
        let least = Ways::<f64>::soft([false; 2], &torsion);
        assert_eq!((least.list().len(), least.mu, least.list()[2].scale), (3, 1e-5, 0.01 / 1e-5));
        let one = Ways::<f64>::soft([true, false], &material(3, [0.8, 0.4, 0.0, 0.0, 0.0]));
        assert_eq!((one.list().len(), one.still), (1, 1));
        assert_eq!((one.mu, one.slide, one.share), (0.4, 0.8, 2.0));
        let none = Ways::<f64>::soft([true; 2], &material(3, [0.8, 0.8, 0.0, 0.0, 0.0]));
        assert_eq!((none.list().len(), none.still, none.mu), (0, 2, 0.8));
        assert!(Ways::<f64>::plain([false; 2], &material(1, [0.8; 5])).list().is_empty());
    }
}
