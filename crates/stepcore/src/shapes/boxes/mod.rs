//! A box against a box.
//!
//! The axis along which the two are farthest apart, or overlap least, is a normal of one of their faces
//! or the cross product of two edges (`axes`). For a face the contacts are the other box's opposite
//! face, clipped to it (`clip`): up to eight points. For two edges it is their nearest points. Boxes
//! apart whose nearest points are corners, or a corner and an edge, have none of these: there the one
//! contact is between those points (`nearest`).
//!
//! Axes, points and their order are MuJoCo's, except for boxes that are apart and near each other only
//! at a corner. MuJoCo then lists the clipped points, or nothing, with distances along an axis that is
//! not the direction of the nearest points.

mod axes;
mod clip;
mod nearest;
#[cfg(test)]
mod tests;

use super::by_lane::{empty, OneWorld};
use super::touch::Touches;
use super::Shape;
use crate::real::{value, Mask, Real};
use crate::spatial::V3;
use axes::Axes;
pub(super) use nearest::segments_gap;

/// The largest number of contacts: a rectangle clipped by a rectangle.
pub(crate) const MOST: usize = 8;
/// Rounding of a distance, as a part of the sizes.
const ROUNDING: f64 = 1e-9;

/// The test; contacts at this distance or farther [m] may be left out.
pub(crate) struct Boxes {
    pub within: f64,
}

/// A box, relative to the centre of the first one.
#[derive(Clone, Copy)]
pub(super) struct Block<R: Real> {
    pub centre: V3<R>,
    pub axes: [V3<R>; 3],
    pub half: [R; 3],
}

impl<R: Real> Block<R> {
    fn of(shape: &Shape<R>, origin: &V3<R>) -> Self {
        let pose = shape.pose;
        Self {
            centre: pose.pos - origin,
            axes: [0, 1, 2].map(|k| pose.axis(k)),
            half: value::get(shape.size),
        }
    }

    /// Returns the edge along axis k where the other two coordinates have these signs.
    pub fn edge(&self, k: usize, positive: [bool; 2]) -> Segment<R> {
        let [u, v] = others(k);
        let end = |k: usize, positive| if positive { self.half[k] } else { -self.half[k] };
        let middle = self.axes[u] * end(u, positive[0]) + self.axes[v] * end(v, positive[1]);
        Segment { middle: self.centre + middle, along: self.axes[k], half: self.half[k] }
    }

    /// Returns all twelve edges, with their numbers.
    pub fn edges(&self) -> impl Iterator<Item = (usize, Segment<R>)> + '_ {
        (0..3).flat_map(move |k| SIGNS.map(|signs| (edge(k, signs), self.edge(k, signs))))
    }

    fn size(&self) -> f64 {
        self.half.iter().map(|half| half.lane(0)).sum()
    }
}

/// Signs of two coordinates.
const SIGNS: [[bool; 2]; 4] = [[false, false], [true, false], [false, true], [true, true]];

/// An edge: its middle, direction and half length.
pub(super) struct Segment<R: Real> {
    pub middle: V3<R>,
    pub along: V3<R>,
    pub half: R,
}

impl<R: Real> Segment<R> {
    pub fn at(&self, place: R) -> V3<R> {
        self.middle + self.along * place
    }
}

/// Returns the two axes after axis k, in cyclic order.
pub(super) fn others(k: usize) -> [usize; 2] {
    [(k + 1) % 3, (k + 2) % 3]
}

/// The box that an axis, a corner or an edge belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    First,
    Second,
}

/// Returns the number of an edge along axis k, where the other two coordinates have these signs.
pub(super) fn edge(k: usize, positive: [bool; 2]) -> usize {
    4 * k + usize::from(positive[0]) + 2 * usize::from(positive[1])
}

/// Returns the feature as one number: a corner of the first box, a corner of the second, two edges.
fn corner_feature(side: Side, corner: usize) -> usize {
    corner + if side == Side::First { 0 } else { 8 }
}

fn edges_feature(first: usize, second: usize) -> usize {
    16 + 12 * first + second
}

impl OneWorld<MOST> for Boxes {
    fn touches<R: Real>(&self, one: &Shape<R>, two: &Shape<R>) -> Touches<R, MOST> {
        let origin = one.pose.pos;
        let (a, b) = (Block::of(one, &origin), Block::of(two, &origin));
        let mut out = [empty(); MOST];
        let Some(axes) = Axes::of(&a, &b, self.within) else { return out };
        let apart = axes.apart();
        let tiny = ROUNDING * (a.size() + b.size());
        let clipped = axes.faces_meet(tiny) && {
            clip::contacts(&a, &b, &axes, &mut out);
            let listed = out.iter().filter(|touch| touch.exists.any());
            let least = listed.map(|touch| touch.dist.lane(0)).fold(f64::INFINITY, f64::min);
            // If the boxes are apart, the nearest points lie on the face, or elsewhere.
            least <= if apart > tiny { apart + tiny } else { f64::MAX }
        };
        if !clipped {
            out = [empty(); MOST];
            out[0] = match &axes.edges {
                Some(edges) if apart <= tiny || edges.nearest(&a, &b) => edges.contact(&a, &b),
                _ => nearest::contact(&a, &b),
            };
        }
        for touch in &mut out {
            touch.pos += origin;
        }
        out
    }
}
