//! A capsule against a capsule.
//!
//! Skew axes: one contact, between the nearest points of the two segments. Axes within 1e-4 rad of
//! parallel: two, at the ends of the common stretch of the segments, where one contact would hop from
//! end to end.

use super::touch::{balls, select3, unit, Ball, Touch, Touches};
use crate::real::{Mask, Real};
use crate::spatial::{Pose, V3};

/// Squared sine of the angle below which two axes count as parallel.
const PARALLEL: f64 = 1e-8;
/// Squared length, over the squared size of the pair, below which a segment is a point.
const POINT: f64 = 1e-15;
/// Squared distance of two axes, over the same, below which their difference, mostly rounding, is a
/// worse direction than the one across both.
const CROSSED: f64 = 1e-8;

/// A capsule's axis as a start and a whole-length direction.
struct Segment<R: Real> {
    start: V3<R>,
    along: V3<R>,
    radius: R,
    axis: V3<R>,
}

impl<R: Real> Segment<R> {
    #[inline(always)]
    fn of(pose: &Pose<R>, radius: R, half: R) -> Self {
        let axis = pose.axis(2);
        let reach = axis * half;
        let start = pose.pos - reach;
        Self { start, along: (pose.pos + reach) - start, radius, axis }
    }

    /// Returns the ball at a share, 0 to 1, of the length.
    #[inline(always)]
    fn ball(&self, share: R) -> Ball<R> {
        Ball { centre: self.start + self.along * share, radius: self.radius, axis: self.axis }
    }
}

/// Two slots. Skew: slot 0 alone, the nearest points. Parallel: slot 0 is the end towards a's −z, slot
/// 1 the end towards its +z; for capsules one behind the other both are in the same place. `ha`, `hb`
/// are half the lengths of the axes.
pub fn capsule_capsule<R: Real>(
    a: &Pose<R>,
    ra: R,
    ha: R,
    b: &Pose<R>,
    rb: R,
    hb: R,
) -> Touches<R, 2> {
    let within = |share: R| share.clamp(R::zero(), R::one());
    let (p, q) = (Segment::of(a, ra, ha), Segment::of(b, rb, hb));
    let between = q.start - p.start;
    let cross = p.along.cross(&q.along);
    let cross2 = cross.dot(&cross);
    let (pp, qq) = (p.along.dot(&p.along), q.along.dot(&q.along));
    let pq = p.along.dot(&q.along);
    let (pd, qd) = (p.along.dot(&between), q.along.dot(&between));

    let size = ra + ha + rb + hb;
    let smallest = R::of(POINT) * size * size;
    let (p_long, q_long) = (pp.gt(smallest), qq.gt(smallest));
    // Single precision cannot resolve so small an angle.
    let small = R::of(PARALLEL.max(16.0 * R::epsilon()));
    let parallel = p_long.and(q_long).and(cross2.le(small * pp * qq));

    // From a place on p to q's nearest point; if this is an end of q, p's nearest point to the end.
    let nearest = |s: R| {
        let free = R::select(q_long, (pq * s - qd) / qq, R::zero());
        let t = within(free);
        let at_end = free.lt(R::zero()).or(free.gt(R::one())).or(q_long.not());
        let again = within((pq * t + pd) / pp);
        let s = R::select(at_end.and(p_long), again, s);
        let (one, two) = (p.ball(s), q.ball(t));
        let inner = s.gt(R::zero()).and(s.lt(R::one())).and(at_end.not());
        let crossed = inner.and(p_long).and(parallel.not());
        across(balls(&one, &two), &one, &two, &cross, crossed, R::of(CROSSED) * size * size)
    };
    // Skew: start at the common perpendicular's foot. Parallel: at both ends of p.
    let foot = within(between.cross(&q.along).dot(&cross) / cross2);
    let seed = R::select(p_long.and(parallel.not()), foot, R::zero());
    let first = nearest(seed);
    if parallel.none() {
        return [first, first.absent()];
    }
    // Lanes that are not parallel keep the numbers of slot 0, as when run alone.
    let mut second = nearest(R::select(parallel, R::one(), seed));
    second.exists = parallel;
    [first, second]
}

/// Returns the same contact with its normal across both axes, where they cross (`crossed`) and are
/// nearer than the root of `close`.
#[inline(always)]
fn across<R: Real>(
    touch: Touch<R>,
    one: &Ball<R>,
    two: &Ball<R>,
    cross: &V3<R>,
    crossed: R::Mask,
    close: R,
) -> Touch<R> {
    let apart = two.centre - one.centre;
    let there = crossed.and(apart.dot(&apart).lt(close));
    if there.none() {
        return touch;
    }
    let way = unit(cross);
    let way = select3(apart.dot(&way).lt(R::zero()), &-way, &way);
    let pos = one.centre + way * (one.radius + R::of(0.5) * touch.dist);
    Touch {
        normal: select3(there, &way, &touch.normal),
        pos: select3(there, &pos, &touch.pos),
        ..touch
    }
}
