//! A capsule against a box: up to two contacts, so that a capsule that lies on a face, or along an
//! edge, rests on both ends of the common stretch.
//!
//! If the capsule's axis misses the box, the first contact is at the axis' point nearest to the box. The
//! second is at the far end of the part of the axis that is above the same face, or next to the same
//! edge. Both are computed as for a ball there. These are MuJoCo's points, except that MuJoCo lists the
//! first contact twice if there is no second. If the axis passes through the box, no ball determines the
//! way out: the shortest one counts, along a face's normal or across an edge and the axis.

use super::boxes::{edge, others, segments_gap, Block, Segment};
use super::by_lane::{empty, OneWorld};
use super::touch::{Touch, Touches};
use super::Shape;
use crate::real::{value, Constant, Mask, Real, Value};
use crate::spatial::V3;

/// Rounding of a distance, as a part of the sizes.
const ROUNDING: f64 = 1e-9;
/// Difference of depths that count as equal, as such a part.
const TIE: f64 = 1e-12;
/// Difference between two ways to compute a distance, as a part of it.
const EVEN: f64 = 1e-15;
/// Distance, as a part of the sizes, below which the features give a better direction than the points.
const THIN: f64 = 1e-6;
/// Squared sine of an angle below which the axis counts as parallel to an edge.
const PARALLEL: f64 = 1e-14;
pub(crate) struct CapsuleBox;

/// The capsule's axis and the box, in the box's frame.
struct Lying<R: Real> {
    axis: Segment<R>,
    radius: R,
    cuboid: Block<R>,
}

impl OneWorld<2> for CapsuleBox {
    fn touches<R: Real>(&self, one: &Shape<R>, two: &Shape<R>) -> Touches<R, 2> {
        let cuboid = two.pose;
        let lying = Lying {
            axis: Segment {
                middle: cuboid.to_local(&(one.pose.pos - cuboid.pos)),
                along: cuboid.to_local(&one.pose.axis(2)),
                half: one.size[1].get(),
            },
            radius: one.size[0].get(),
            cuboid: Block {
                centre: V3::zeros(),
                axes: [V3::x(), V3::y(), V3::z()],
                half: value::get(two.size),
            },
        };
        let size = one.size[1].lane(0) + two.size.iter().map(|x| x.lane(0)).sum::<f64>();
        let way = lying.way_out();
        let mut out = if way.gap.lane(0) > ROUNDING * size {
            lying.beside(&way, size)
        } else {
            lying.through(&way)
        };
        if out[1].exists.any() && out[1].feature == out[0].feature {
            out[1].feature += R::of(32.0);
        }
        for touch in &mut out {
            touch.pos = cuboid.pos + cuboid.to_world(&touch.pos);
            touch.normal = cuboid.to_world(&touch.normal);
        }
        out
    }
}

/// The direction in which axis and box are farthest apart, or overlap least.
struct WayOut<R: Real> {
    gap: R,
    /// Unit, out of the box.
    normal: V3<R>,
    /// The face, or for an edge its direction.
    face: Option<usize>,
    edge: usize,
}

impl<R: Real> Lying<R> {
    /// Finds the way out among three faces and three cross products of an edge with the axis.
    fn way_out(&self) -> WayOut<R> {
        let (axis, half) = (&self.axis, &self.cuboid.half);
        let sign = |x: R| if x.lane(0) < 0.0 { -R::one() } else { R::one() };
        let mut best: Option<WayOut<R>> = None;
        for k in 0..3 {
            let gap = axis.middle[k].abs() - (half[k] + axis.half * axis.along[k].abs());
            if best.as_ref().is_none_or(|best| gap.lane(0) > best.gap.lane(0)) {
                let normal = self.cuboid.axes[k] * sign(axis.middle[k]);
                best = Some(WayOut { gap, normal, face: Some(k), edge: 0 });
            }
        }
        for k in 0..3 {
            let across = self.cuboid.axes[k].cross(&axis.along);
            let square = across.dot(&across);
            if square.lane(0) < PARALLEL {
                continue;
            }
            let raw = across * (R::one() / square.sqrt());
            let normal = raw * sign(raw.dot(&axis.middle));
            let [u, v] = others(k);
            let reach = half[u] * normal[u].abs() + half[v] * normal[v].abs();
            let gap = normal.dot(&axis.middle) - reach;
            // A face is preferred to equal ones.
            let tiny = TIE * (half[0] + half[1] + half[2]).lane(0);
            if best.as_ref().is_some_and(|now| gap.lane(0) > now.gap.lane(0) + tiny) {
                best = Some(WayOut { gap, normal, face: None, edge: k });
            }
        }
        best.unwrap_or(WayOut { gap: R::zero(), normal: V3::z(), face: Some(2), edge: 0 })
    }

    /// Returns the stretch of the axis whose coordinates k are within the box's.
    fn over(&self, axes: &[usize]) -> Option<[R; 2]> {
        let (mut low, mut high) = (-self.axis.half, self.axis.half);
        for &k in axes {
            let (start, slope, half) =
                (self.axis.middle[k], self.axis.along[k], self.cuboid.half[k]);
            if slope.lane(0) == 0.0 {
                if start.lane(0).abs() > half.lane(0) {
                    return None;
                }
                continue;
            }
            let (a, b) = ((-half - start) / slope, (half - start) / slope);
            let (a, b) = if slope.lane(0) > 0.0 { (a, b) } else { (b, a) };
            low = low.max(a);
            high = high.min(b);
        }
        (low.lane(0) <= high.lane(0)).then_some([low, high])
    }

    /// Returns the contacts of an axis that passes through the box, or is on its surface.
    fn through(&self, way: &WayOut<R>) -> Touches<R, 2> {
        let Some(face) = way.face else { return [self.crossing(way), empty()] };
        let Some([low, high]) = self.over(&others(face)) else {
            return [self.crossing(way), empty()];
        };
        let [mut first, mut second] = [low, high].map(|place| {
            let point = self.axis.at(place);
            let gap = way.normal.dot(&point) - self.cuboid.half[face];
            self.touch(place, gap, -way.normal)
        });
        if second.dist.lane(0) < first.dist.lane(0) {
            (first, second) = (second, first);
        }
        [first, second]
    }

    /// Returns the contact between the axis and the edge of the box that is farthest along the way out.
    fn crossing(&self, way: &WayOut<R>) -> Touch<R> {
        let ends = others(way.edge).map(|k| way.normal[k].lane(0) >= 0.0);
        let (place, _, _) = segments_gap(&self.axis, &self.cuboid.edge(way.edge, ends));
        let feature = R::of((3 + edge(way.edge, ends)) as f64);
        Touch { feature, ..self.touch(place, way.gap, -way.normal) }
    }

    /// Returns the contact of a ball at this place, whose centre is at this gap along `normal`.
    fn touch(&self, place: R, gap: R, normal: V3<R>) -> Touch<R> {
        let dist = gap - self.radius;
        Touch {
            dist,
            pos: self.axis.at(place) + normal * (self.radius + R::of(0.5) * dist),
            normal,
            exists: R::Mask::of(true),
            feature: self.feature(place),
        }
    }

    /// Returns the feature: an end of the axis (1 and 2), or the edge (from 3) or corner (from 15) of
    /// the box nearest to a place between.
    fn feature(&self, place: R) -> R {
        let name = if place.lane(0) <= -self.axis.half.lane(0) {
            1
        } else if place.lane(0) >= self.axis.half.lane(0) {
            2
        } else {
            let point = self.axis.at(place);
            let inside =
                |k: usize| self.cuboid.half[k].lane(0) * (1.0 + ROUNDING) - point[k].lane(0).abs();
            // The edge runs along the coordinate that is farthest inside.
            let along = (1..3).fold(0, |best, k| if inside(k) > inside(best) { k } else { best });
            let positive = |k: usize| point[k].lane(0) >= 0.0;
            if inside(along) < 0.0 {
                15 + (0..3).map(|k| usize::from(positive(k)) << k).sum::<usize>()
            } else {
                3 + edge(along, others(along).map(positive))
            }
        };
        R::of(name as f64)
    }

    /// Returns the contact of a ball at this place, whose centre is outside.
    fn ball(&self, place: R) -> Touch<R> {
        let apart = self.from(&self.axis.at(place));
        let length = apart.dot(&apart).sqrt();
        self.touch(place, length, apart * (R::one() / length))
    }

    /// Returns the vector from a point to the box.
    fn from(&self, point: &V3<R>) -> V3<R> {
        V3::from_fn(|k, _| {
            let half = self.cuboid.half[k];
            point[k].clamp(-half, half) - point[k]
        })
    }

    /// Returns the place on the axis nearest to the box: an end, unless an edge is nearer.
    fn nearest(&self) -> R {
        let length = |v: V3<R>| v.dot(&v).lane(0).sqrt();
        let [first, last] = [-self.axis.half, self.axis.half];
        let (mut place, mut best) = (first, length(self.from(&self.axis.at(first))));
        let end = length(self.from(&self.axis.at(last)));
        if end < best {
            (place, best) = (last, end);
        }
        // If the axis is along an edge the end counts, unless the axis comes nearer from there.
        let ahead = self.axis.along * if place == last { -R::one() } else { R::one() };
        let nears = ahead.dot(&self.from(&self.axis.at(place))).lane(0) > TIE * best;
        best *= if nears { 1.0 + EVEN } else { 1.0 - ROUNDING };
        for (_, edge) in self.cuboid.edges() {
            let (there, _, gap) = segments_gap(&self.axis, &edge);
            let gap = length(gap);
            if gap < best {
                (place, best) = (there, gap);
            }
        }
        place
    }

    /// Returns the contacts of an axis that misses the box.
    fn beside(&self, way: &WayOut<R>, size: f64) -> Touches<R, 2> {
        let place = self.nearest();
        let mut first = self.ball(place);
        let further = (first.dist + self.radius - way.gap).lane(0);
        if way.gap.lane(0) < THIN * size && further < EVEN * size {
            first = self.touch(place, way.gap, -way.normal);
        }
        let second = self.second(place, &first.normal);
        let apart = (second.lane(0) - place.lane(0)).abs();
        let there = apart > ROUNDING * self.axis.half.lane(0);
        [first, if there { self.ball(second) } else { empty() }]
    }

    /// Returns the place of the second contact, given the nearest point.
    fn second(&self, place: R, normal: &V3<R>) -> R {
        let point = self.axis.at(place);
        let outside = |k: &usize| point[*k].lane(0).abs() > self.cuboid.half[*k].lane(0);
        let steep = |k: usize| normal[k].lane(0).abs();
        let face = (1..3).fold(0, |best, k| if steep(k) > steep(best) { k } else { best });
        let beside = [0, 1, 2].map(|k| outside(&k));
        match beside.iter().filter(|out| **out).count() {
            0 | 1 => {
                // Above a face: the far end of the part above it.
                let far = |[low, high]: [R; 2]| {
                    let upper = (high - place).lane(0) > (place - low).lane(0);
                    if upper {
                        high
                    } else {
                        low
                    }
                };
                self.over(&others(face)).map_or(place, far)
            }
            2 => {
                let side = (0..3).find(|k| *k != face && beside[*k]).unwrap_or(face);
                let along = 3 - face - side;
                if along > 2 || along == face {
                    return place;
                }
                let ends = self.over(&[along]).unwrap_or([place, place]);
                self.across(place, side, ends).unwrap_or_else(|| self.nearer(ends))
            }
            _ => self.nearer([-self.axis.half, self.axis.half]),
        }
    }

    /// Returns the place as far across the face from an edge as the face is wide.
    fn across(&self, place: R, side: usize, [low, high]: [R; 2]) -> Option<R> {
        let (slope, half) = (self.axis.along[side], self.cuboid.half[side]);
        if slope.lane(0) == 0.0 {
            return None;
        }
        let wide = (half + half) / slope.abs();
        let start = self.axis.at(place)[side].lane(0);
        let there = if (start < 0.0) == (slope.lane(0) > 0.0) {
            (place + wide).min(high)
        } else {
            (place - wide).max(low)
        };
        let above = self.axis.at(there)[side].lane(0).abs() <= half.lane(0);
        let moved = (there - place).lane(0).abs() > ROUNDING * self.axis.half.lane(0);
        (above && moved).then_some(there)
    }

    /// Returns the one of two places that is nearer to the box.
    fn nearer(&self, [low, high]: [R; 2]) -> R {
        let [a, b] = [low, high].map(|place| {
            let apart = self.from(&self.axis.at(place));
            apart.dot(&apart).lane(0)
        });
        if a < b {
            low
        } else {
            high
        }
    }
}
