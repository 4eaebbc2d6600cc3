//! The nearest points of two boxes that are apart, if no face contains either of them: both then lie on
//! edges.

use super::super::touch::Touch;
use super::{edges_feature, Block, Segment};
use crate::real::{Mask, Real};
use crate::spatial::V3;

/// Squared sine of an angle below which two segments count as parallel.
const PARALLEL: f64 = 1e-14;

/// Returns the contact between the two nearest edges.
pub(super) fn contact<R: Real>(a: &Block<R>, b: &Block<R>) -> Touch<R> {
    let (mut best, mut found) = (f64::INFINITY, None);
    for (one, first) in a.edges() {
        for (two, second) in b.edges() {
            // The distance of the middles excludes most pairs.
            let (between, reach) = (second.middle - first.middle, first.half + second.half);
            let nearer = best + reach.lane(0);
            if between.dot(&between).lane(0) >= nearer * nearer {
                continue;
            }
            let (_, from, gap) = segments_gap(&first, &second);
            let length = gap.dot(&gap).sqrt();
            if length.lane(0) < best {
                (best, found) =
                    (length.lane(0), Some((from, gap, length, edges_feature(one, two))));
            }
        }
    }
    let Some((from, gap, length, feature)) = found else { return super::empty() };
    Touch {
        dist: length,
        pos: from + gap * R::of(0.5),
        normal: gap * length.recip_or_zero(),
        exists: R::Mask::of(best > 0.0),
        feature: R::of(feature as f64),
    }
}

/// Returns the place on the first segment nearest to the second, its point there, and the vector from
/// there to the second's (Ericson, Real-Time Collision Detection, 2005, 5.1.9).
pub(in crate::shapes) fn segments_gap<R: Real>(
    one: &Segment<R>,
    two: &Segment<R>,
) -> (R, V3<R>, V3<R>) {
    let apart = two.middle - one.middle;
    let (cosine, cross) = (one.along.dot(&two.along), one.along.cross(&two.along));
    let (along, other) = (one.along.dot(&apart), two.along.dot(&apart));
    let square = cross.dot(&cross);
    let skew = square.lane(0) > PARALLEL;
    let s = if skew { (along - cosine * other) / square } else { R::zero() };
    let s = s.clamp(-one.half, one.half);
    let t = (cosine * s - other).clamp(-two.half, two.half);
    let s = (along + cosine * t).clamp(-one.half, one.half);
    let from = one.at(s);
    (s, from, two.at(t) - from)
}
