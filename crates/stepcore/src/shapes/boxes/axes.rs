//! The fifteen axes along which two boxes can be apart: Gottschalk, Lin, Manocha, OBBTree (1996).
//!
//! With the centres t apart and L a unit vector, the gap along L is |t·L| less the reach of either box
//! along L. If all are negative, the largest is the depth of the overlap.

use super::super::touch::Touch;
use super::{edge, edges_feature, others, Block, Segment, Side};
use crate::real::{Mask, Real};
use crate::spatial::V3;

/// Squared sine of an angle below which two edges count as parallel: a face has their axis.
const PARALLEL: f64 = 1e-14;
/// A face is preferred to two edges, since a manifold holds better than one point, unless the edges'
/// gap is larger by this share of the face's …
const FACES_FIRST: f64 = 0.05;
/// … or the two axes are farther apart than this cosine. Both are MuJoCo's numbers.
const ALIKE: f64 = 0.99;

/// All axes of two boxes, and the best of either kind.
pub(super) struct Axes<R: Real> {
    /// Axis i of the first box against axis j of the second: cosines.
    pub cosines: [[R; 3]; 3],
    pub face: Face<R>,
    pub edges: Option<Edges<R>>,
}

/// A face, and the height of the other box above it.
pub(super) struct Face<R: Real> {
    pub side: Side,
    pub axis: usize,
    gap: R,
    /// Along the axis, from the first box to the second.
    pub positive: bool,
}

/// The cross product of an edge of either box.
pub(super) struct Edges<R: Real> {
    axes: [usize; 2],
    gap: R,
    /// Unit, from the first box to the second.
    normal: V3<R>,
    /// Signs of the other two coordinates of each box on its edge.
    ends: [[bool; 2]; 2],
    /// The edges' gap is the largest of all.
    best: bool,
    /// The axis is nearly the face's.
    alike: bool,
}

impl<R: Real> Axes<R> {
    /// Finds the axes; among equal ones the first counts: faces of the first box, of the second, then
    /// edges. None: some axis shows that the boxes are `within` [m] apart or more.
    pub fn of(a: &Block<R>, b: &Block<R>, within: f64) -> Option<Self> {
        let (mut cosines, mut span) = ([[R::zero(); 3]; 3], [[R::zero(); 3]; 3]);
        let between = b.centre - a.centre;
        let (mut ta, mut tb) = ([R::zero(); 3], [R::zero(); 3]);
        for i in 0..3 {
            for j in 0..3 {
                cosines[i][j] = a.axes[i].dot(&b.axes[j]);
                span[i][j] = cosines[i][j].abs();
            }
            ta[i] = a.axes[i].dot(&between);
            tb[i] = b.axes[i].dot(&between);
        }

        let mut face = Face { side: Side::First, axis: 0, gap: R::zero(), positive: true };
        let mut best = f64::NEG_INFINITY;
        let mut consider = |side, axis, along: R, reach: R| {
            let gap = along.abs() - reach;
            if gap.lane(0) > best {
                best = gap.lane(0);
                face = Face { side, axis, gap, positive: along.lane(0) >= 0.0 };
            }
        };
        for i in 0..3 {
            let other = span[i][0] * b.half[0] + span[i][1] * b.half[1] + span[i][2] * b.half[2];
            consider(Side::First, i, ta[i], a.half[i] + other);
        }
        for j in 0..3 {
            let other = span[0][j] * a.half[0] + span[1][j] * a.half[1] + span[2][j] * a.half[2];
            consider(Side::Second, j, tb[j], b.half[j] + other);
        }

        if face.gap.lane(0) >= within {
            return None;
        }

        // aᵢ × bⱼ = c[i₁][j] a[i₂] − c[i₂][j] a[i₁]: the reach of each box follows from the cosines.
        let (mut pair, mut best, mut turned) = (None, (R::zero(), R::zero()), false);
        for i in 0..3 {
            let [i1, i2] = others(i);
            for j in 0..3 {
                let [j1, j2] = others(j);
                let square = cosines[i1][j] * cosines[i1][j] + cosines[i2][j] * cosines[i2][j];
                if square.lane(0) < PARALLEL {
                    continue;
                }
                let along = ta[i2] * cosines[i1][j] - ta[i1] * cosines[i2][j];
                let reach = a.half[i1] * span[i2][j]
                    + a.half[i2] * span[i1][j]
                    + b.half[j1] * span[i][j2]
                    + b.half[j2] * span[i][j1];
                let length = square.sqrt();
                let gap = (along.abs() - reach) / length;
                if pair.is_none() || gap.lane(0) > best.0.lane(0) {
                    (pair, best, turned) = (Some([i, j]), (gap, length), along.lane(0) < 0.0);
                }
            }
        }
        let edges = pair.map(|axes| {
            let (gap, length) = best;
            let sign = if turned { -R::one() } else { R::one() };
            let normal = a.axes[axes[0]].cross(&b.axes[axes[1]]) * (sign / length);
            let face_axis = match face.side {
                Side::First => a.axes[face.axis],
                Side::Second => b.axes[face.axis],
            };
            let outward = |block: &Block<R>, k: usize, sign: f64| {
                others(k).map(|k| sign * block.axes[k].dot(&normal).lane(0) >= 0.0)
            };
            Edges {
                axes,
                gap,
                normal,
                ends: [outward(a, axes[0], 1.0), outward(b, axes[1], -1.0)],
                best: gap.lane(0) > face.gap.lane(0),
                alike: face_axis.dot(&normal).lane(0).abs() > ALIKE,
            }
        });
        let axes = Self { cosines, face, edges };
        (axes.apart() < within).then_some(axes)
    }

    /// Returns the gap of the boxes along the best axis [m]; if negative, the depth of their overlap.
    pub fn apart(&self) -> f64 {
        let face = self.face.gap.lane(0);
        self.edges.as_ref().map_or(face, |edges| face.max(edges.gap.lane(0)))
    }

    /// Checks that the face makes the contacts, not the edges. `tiny`: rounding of a distance [m].
    pub fn faces_meet(&self, tiny: f64) -> bool {
        let Some(edges) = &self.edges else { return true };
        let face = self.face.gap.lane(0);
        let more = edges.gap.lane(0) - face;
        !edges.best || edges.alike && more <= FACES_FIRST * face.abs() + tiny
    }
}

impl<R: Real> Edges<R> {
    fn segments(&self, a: &Block<R>, b: &Block<R>) -> [Segment<R>; 2] {
        [a.edge(self.axes[0], self.ends[0]), b.edge(self.axes[1], self.ends[1])]
    }

    /// Returns the nearest places of their lines, along either from its middle. With w from middle to
    /// middle and c the cosine between them: s = (u·w − c v·w)/(1 − c²), t = (c u·w − v·w)/(1 − c²).
    fn places([one, two]: &[Segment<R>; 2]) -> [R; 2] {
        let apart = two.middle - one.middle;
        let (cosine, cross) = (one.along.dot(&two.along), one.along.cross(&two.along));
        let (along, other) = (one.along.dot(&apart), two.along.dot(&apart));
        let inverse = R::one() / cross.dot(&cross);
        [(along - cosine * other) * inverse, (cosine * along - other) * inverse]
    }

    /// Checks that the nearest points of boxes apart are the ones of the two edges' lines.
    pub fn nearest(&self, a: &Block<R>, b: &Block<R>) -> bool {
        let segments = self.segments(a, b);
        let places = Self::places(&segments);
        let within = |k: usize| places[k].lane(0).abs() <= segments[k].half.lane(0);
        self.best && within(0) && within(1)
    }

    /// Returns the contact, halfway between the nearest points.
    pub fn contact(&self, a: &Block<R>, b: &Block<R>) -> Touch<R> {
        let segments = self.segments(a, b);
        let [s, t] = Self::places(&segments);
        let [one, two] = [0, 1].map(|k| edge(self.axes[k], self.ends[k]));
        Touch {
            dist: self.gap,
            pos: (segments[0].at(s) + segments[1].at(t)) * R::of(0.5),
            normal: self.normal,
            exists: R::Mask::of(true),
            feature: R::of(edges_feature(one, two) as f64),
        }
    }
}
