//! Contacts of a pair of shapes that are near, from their poses.
//!
//! A contact is a signed distance, the point halfway between the surfaces and a
//! unit normal from geom 1 to geom 2; `frame.rs` completes its frame. Distances
//! are always reported: the caller compares them with margin and gap.

use crate::real::{Mask, Real};
use crate::spatial::V3;

/// One contact.
#[derive(Clone, Copy, Debug)]
pub struct Touch<R: Real> {
    /// Signed distance of the surfaces: negative = overlap.
    pub dist: R,
    /// Halfway between the surfaces.
    pub pos: V3<R>,
    /// Unit length, from geom 1 to geom 2.
    pub normal: V3<R>,
    /// The lanes that have this contact at all, whatever its distance.
    pub exists: R::Mask,
    /// The features that touch (a corner, a pair of edges), as a whole number below 2²⁴: it keeps its
    /// meaning from step to step. It is 0 if the slot itself has a meaning.
    pub feature: R,
}

/// The contacts of a pair, by slot. Up to two slots keep their meaning from step to step; in a manifold
/// with more, the features do. Either finds the impulse that starts the next solve.
pub type Touches<R, const N: usize> = [Touch<R>; N];

impl<R: Real> Touch<R> {
    /// Returns this touch where the mask holds, the other elsewhere.
    #[inline(always)]
    pub fn or_else(&self, mask: R::Mask, other: &Self) -> Self {
        Self {
            dist: R::select(mask, self.dist, other.dist),
            pos: select3(mask, &self.pos, &other.pos),
            normal: select3(mask, &self.normal, &other.normal),
            exists: mask.and(self.exists).or(mask.not().and(other.exists)),
            feature: R::select(mask, self.feature, other.feature),
        }
    }

    /// Returns the same numbers without a contact in any lane.
    #[inline(always)]
    pub fn absent(self) -> Self {
        Self { exists: R::Mask::of(false), ..self }
    }
}

/// Returns `yes` where the mask holds, `no` elsewhere.
#[inline(always)]
pub fn select3<R: Real>(mask: R::Mask, yes: &V3<R>, no: &V3<R>) -> V3<R> {
    V3::new(
        R::select(mask, yes.x, no.x),
        R::select(mask, yes.y, no.y),
        R::select(mask, yes.z, no.z),
    )
}

/// Below this fraction of the radii two centres count as one.
const SAME_POINT: f64 = 1e-14;
/// Sine of an angle that is only rounding.
const NO_ANGLE: f64 = 1e-15;

/// A ball somewhere on a shape; `axis` is the shape's z, a spare direction.
#[derive(Clone, Copy, Debug)]
pub struct Ball<R: Real> {
    pub centre: V3<R>,
    pub radius: R,
    pub axis: V3<R>,
}

/// Returns the contact of two balls: every round pair ends here with its nearest points. With both
/// centres in one place the normal is across both axes or, if the axes are parallel, the world's x:
/// MuJoCo's choice.
#[inline(always)]
pub fn balls<R: Real>(a: &Ball<R>, b: &Ball<R>) -> Touch<R> {
    let apart = b.centre - a.centre;
    let length = apart.dot(&apart).sqrt();
    let dist = length - a.radius - b.radius;
    let same = length.le(R::of(SAME_POINT) * (a.radius + b.radius));
    let some_are_same = same.any();
    let mut normal = apart * (R::one() / length);
    if some_are_same {
        let cross = a.axis.cross(&b.axis);
        let parallel = cross.dot(&cross).lt(R::of(NO_ANGLE * NO_ANGLE));
        let spare = select3(parallel, &V3::x(), &unit(&cross));
        normal = select3(same, &spare, &normal);
    }
    let pos = a.centre + normal * (a.radius + R::of(0.5) * dist);
    Touch { dist, pos, normal, exists: R::Mask::of(true), feature: R::zero() }
}

#[inline(always)]
pub(crate) fn unit<R: Real>(v: &V3<R>) -> V3<R> {
    v * (R::one() / v.dot(v).sqrt())
}
