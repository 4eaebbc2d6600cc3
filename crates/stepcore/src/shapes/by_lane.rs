//! Tests that branch too freely for lanes: one world at a time, in double precision.
//!
//! A hull against a hull takes other steps in every world, so eight of them together would do all steps
//! of all. Such a test is written for numbers of one lane (`f64`, and numbers that also carry slopes or
//! counts), may branch on comparisons, and gets one lane after the other. Lanes equal scalars bit for
//! bit by construction; single precision is the result in double, rounded.

use super::touch::{Touch, Touches};
use super::Shape;
use crate::real::{Constant, Mask, Real, WIDEST};
use crate::spatial::{Pose, M3, V3};

/// A test of one pair of shapes in one world.
pub trait OneWorld<const N: usize> {
    /// `R` has one lane, and is as precise as `f64`: `x.lane(0)` is its number.
    fn touches<R: Real>(&self, one: &Shape<R>, two: &Shape<R>) -> Touches<R, N>;
}

/// Runs such a test in every lane; `test` returns it for each.
pub fn by_lane<R: Real, T: OneWorld<N>, const N: usize>(
    test: impl Fn(usize) -> T,
    one: &Shape<R>,
    two: &Shape<R>,
) -> Touches<R, N> {
    if R::ALONE && R::epsilon() <= f64::EPSILON {
        return test(0).touches(one, two);
    }
    let mut out = [empty::<R>(); N];
    let mut exists = [[false; WIDEST]; N];
    for lane in 0..R::LANES {
        let (p1, p2) = (pose(one.pose, lane), pose(two.pose, lane));
        let touches =
            test(lane).touches(&one.at(&p1, &size(one, lane)), &two.at(&p2, &size(two, lane)));
        for (slot, touch) in touches.iter().enumerate() {
            exists[slot][lane] = touch.exists;
            let to = &mut out[slot];
            to.dist.set_lane(lane, touch.dist);
            to.feature.set_lane(lane, touch.feature);
            for i in 0..3 {
                to.pos[i].set_lane(lane, touch.pos[i]);
                to.normal[i].set_lane(lane, touch.normal[i]);
            }
        }
    }
    for (to, exists) in out.iter_mut().zip(exists) {
        to.exists = R::Mask::from_lanes(|lane| exists[lane]);
    }
    out
}

/// Returns a slot without a contact. Its numbers are finite, so that they may be computed with.
pub fn empty<R: Real>() -> Touch<R> {
    Touch {
        dist: R::one(),
        pos: V3::zeros(),
        normal: V3::x(),
        exists: R::Mask::of(false),
        feature: R::zero(),
    }
}

/// Returns one lane of a size.
fn size<R: Real>(shape: &Shape<R>, lane: usize) -> [f64; 3] {
    shape.size.each_ref().map(|x| x.lane(lane))
}

/// Returns one lane of a pose. In lower precision the axes are only nearly at right angles. They are
/// made orthogonal, since values computed from their cosines and from their components must agree to
/// the digits that the tests have.
fn pose<R: Real>(pose: &Pose<R>, lane: usize) -> Pose<f64> {
    let rot = M3::from_fn(|i, k| pose.rot[(i, k)].lane(lane));
    let coarse = R::epsilon() > f64::EPSILON;
    Pose {
        pos: V3::new(pose.pos.x.lane(lane), pose.pos.y.lane(lane), pose.pos.z.lane(lane)),
        rot: if coarse { upright(&rot) } else { rot },
    }
}

/// Returns the rotation with the same third axis, whose first axis is as near as possible.
fn upright(rot: &M3<f64>) -> M3<f64> {
    let z = rot.column(2).normalize();
    let x = rot.column(0) - z * z.dot(&rot.column(0));
    let x = x.normalize();
    M3::from_columns(&[x, z.cross(&x), z])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::real::Lanes;

    /// Two touches of numbers that show their lanes.
    struct Both;

    impl OneWorld<2> for Both {
        fn touches<R: Real>(&self, one: &Shape<R>, two: &Shape<R>) -> Touches<R, 2> {
            let dist = two.pose.pos.x - one.pose.pos.x;
            let there = dist.lane(0) > 2.0;
            let touch = Touch { dist, exists: R::Mask::of(there), ..empty() };
            [touch, Touch { feature: R::of(7.0), pos: one.pose.pos, ..touch }]
        }
    }

    fn at<R: Real>(x: impl Fn(usize) -> f64) -> Pose<R> {
        let mut pose: Pose<R> = Pose { pos: V3::zeros(), rot: M3::identity() };
        (0..R::LANES).for_each(|lane| pose.pos.x.set_lane(lane, x(lane)));
        pose
    }

    #[test]
    fn every_lane_is_its_own_world() {
        let (one, two) = (at::<Lanes>(|k| k as f64), at(|k| 2.5 * k as f64));
        let size = [1.0; 3].map(|x| Constant::by_lane(&[x]));
        let shape = |pose| Shape { pose, size: &size, hull: None, field: None };
        let [first, second] = by_lane(|_| Both, &shape(&one), &shape(&two));
        for lane in 0..<Lanes>::LANES {
            assert_eq!(first.dist.lane(lane), 1.5 * lane as f64);
            assert_eq!(second.pos.x.lane(lane), lane as f64);
            assert_eq!(second.feature.lane(lane), 7.0);
            assert_eq!(first.exists.lane(lane), 1.5 * lane as f64 > 2.0);
        }
    }
}
