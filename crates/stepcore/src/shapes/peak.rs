//! The largest separation near a direction, for any features.
//!
//! A shape is the hull of pieces that do not bend sharply: a polytope of its corners, a cylinder of its
//! two end discs. With a fixed piece of each shape, the separation s_k(n) = n·w_k(n) is smooth, and s
//! is the least of them. Near its maximum few pairs of pieces matter. They are found as cutting planes
//! are (Kelley 1960): the best direction for the pairs found so far is tried, and the pair that is less
//! apart there joins them. As the pieces of a shape bend equally, all s_k have one second derivative,
//! and a step is the best of the maxima of one, on the ridge of two, and in the corner of three.

use super::separation::{across_both, Pairing};
use super::touch::unit;
use crate::spatial::V3;

/// Largest number of pairs of pieces, and of rounds.
const KEPT: usize = 8;
const ROUNDS: usize = 40;
/// Largest length of the first steps, and smallest length of any step.
const FIRST: f64 = 0.01;
const LEAST: f64 = 1e-12;
/// Over the size of the pair: a gain that is only rounding.
const ROUNDING: f64 = 1e-15;

/// A step in the plane across the direction.
type Step = [f64; 2];

/// The separation of a pair of pieces at the direction, and its slope.
#[derive(Clone, Copy, Default)]
struct Side {
    apart: f64,
    slope: Step,
}

/// Returns the direction where a search from a direction ends.
pub fn peak(pairing: &Pairing, from: &V3<f64>) -> V3<f64> {
    let mut normal = *from;
    let mut pieces = [(0, 0); KEPT];
    let mut count = 0;
    let mut add = |piece: (usize, usize)| {
        let known = pieces[..count].contains(&piece);
        if !known {
            pieces.copy_within(..KEPT - 1, 1);
            pieces[0] = piece;
            count = (count + 1).min(KEPT);
        }
        (!known, pieces, count)
    };
    let (_, mut list, mut known) = add(pairing.pieces(&normal));
    let mut apart = pairing.apart(&normal);
    let mut most = FIRST;
    for _ in 0..ROUNDS {
        let Some(step) = best_step(pairing, &normal, &list[..known], most) else { break };
        let next = unit(&(normal + step));
        let there = pairing.apart(&next);
        let (new, pieces, count) = add(pairing.pieces(&next));
        (list, known) = (pieces, count);
        if there > apart {
            (normal, apart) = (next, there);
            most = (2.0 * most).min(FIRST);
        } else if !new {
            most = 0.25 * step.dot(&step).sqrt();
            if most < LEAST {
                break;
            }
        }
    }
    normal
}

/// Returns the step to the largest least separation of these pieces, no longer than `most`; None if
/// nothing is gained.
fn best_step(
    pairing: &Pairing,
    normal: &V3<f64>,
    pieces: &[(usize, usize)],
    most: f64,
) -> Option<V3<f64>> {
    let (t, u) = across_both(normal);
    let mut sides = [Side::default(); KEPT];
    for (side, piece) in sides.iter_mut().zip(pieces) {
        let w = pairing.pinned(*piece, &-normal);
        *side = Side { apart: normal.dot(&w), slope: [t.dot(&w), u.dot(&w)] };
    }
    let sides = &sides[..pieces.len()];
    let now = sides.iter().map(|side| side.apart).fold(f64::INFINITY, f64::min);
    let (bt, bu) = (pairing.bend(normal, &t), pairing.bend(normal, &u));
    let model = Model { sides, curve: [t.dot(&bt) + now, t.dot(&bu), u.dot(&bu) + now] };
    let step = model.best(most)?;
    (model.at(step) > now + ROUNDING * pairing.size).then(|| t * step[0] + u * step[1])
}

/// Separations near a direction: least of apart + slope·d, minus dᵀ curve d / 2.
struct Model<'a> {
    sides: &'a [Side],
    /// By axes: first with first, first with second, second with second.
    curve: [f64; 3],
}

fn dot(a: Step, b: Step) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

impl Model<'_> {
    fn curved(&self, d: Step) -> Step {
        let [a, b, c] = self.curve;
        [a * d[0] + b * d[1], b * d[0] + c * d[1]]
    }

    fn at(&self, d: Step) -> f64 {
        let least = self.sides.iter().map(|side| side.apart + dot(side.slope, d));
        least.fold(f64::INFINITY, f64::min) - 0.5 * dot(d, self.curved(d))
    }

    /// Returns the best step of those that one, two or three of the sides suggest.
    fn best(&self, most: f64) -> Option<Step> {
        let mut best: Option<(Step, f64)> = None;
        let mut offer = |d: Step| {
            let length = dot(d, d).sqrt();
            let share = (most / length).min(1.0);
            let d = [d[0] * share, d[1] * share];
            let value = self.at(d);
            if length > 0.0 && length.is_finite() && best.is_none_or(|best| value > best.1) {
                best = Some((d, value));
            }
        };
        for (i, one) in self.sides.iter().enumerate() {
            offer(self.summit(one, most));
            for (k, two) in self.sides[..i].iter().enumerate() {
                offer(self.ridge(one, two, most));
                self.sides[..k].iter().for_each(|three| offer(corner(one, two, three)));
            }
        }
        best.map(|best| best.0)
    }

    /// Returns the maximum of one; a step up its slope if it has none.
    fn summit(&self, one: &Side, most: f64) -> Step {
        let ([a, b, c], [x, y]) = (self.curve, one.slope);
        let det = a * c - b * b;
        if a > 0.0 && det > 0.0 {
            return [(c * x - b * y) / det, (a * y - b * x) / det];
        }
        let share = most * dot(one.slope, one.slope).sqrt().recip();
        [x * share, y * share]
    }

    /// Returns the maximum of two where they are equal.
    fn ridge(&self, one: &Side, two: &Side, most: f64) -> Step {
        let across = [one.slope[0] - two.slope[0], one.slope[1] - two.slope[1]];
        let back = (two.apart - one.apart) / dot(across, across);
        let foot = [across[0] * back, across[1] * back];
        let length = dot(across, across).sqrt();
        let along = [-across[1] / length, across[0] / length];
        let slope = dot(along, one.slope) - dot(along, self.curved(foot));
        let bend = dot(along, self.curved(along));
        let way = if bend > 0.0 { slope / bend } else { most.copysign(slope) };
        [foot[0] + along[0] * way, foot[1] + along[1] * way]
    }
}

/// Returns the point where three are equal.
fn corner(one: &Side, two: &Side, three: &Side) -> Step {
    let [p, q] = [two, three].map(|side| {
        [side.slope[0] - one.slope[0], side.slope[1] - one.slope[1], one.apart - side.apart]
    });
    let det = p[0] * q[1] - p[1] * q[0];
    [(p[2] * q[1] - p[1] * q[2]) / det, (p[0] * q[2] - p[2] * q[0]) / det]
}
