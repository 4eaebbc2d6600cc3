//! The place where two shapes meet on their way through a step, if they do.
//!
//! If convex shapes are at distance φ along the normal n, a plane separates them until they have
//! approached by φ along n. So, moved by φ/(−n·way) of the whole way, they still do not overlap, and
//! the next plane is nearer to the touch: Newton's method on a convex distance, which comes from one
//! side and never passes the first touch (conservative advancement: Mirtich 1996).

use super::{meet_at, Contact};
use crate::model::{Model, Pair};
use crate::place::Placed;
use crate::real::{Mask, Real};
use crate::shapes::Touch;
use crate::spatial::{Pose, V3};

/// Planes after which shapes that are still neither met nor past count as met.
const PLANES: usize = 32;
/// Cosine of the largest angle by which a normal may turn on the way and still represent the contact.
const TURNED: f64 = 0.999;

/// The end of a way.
pub(crate) struct TimeOfImpact<R: Real> {
    /// Lanes in which the shapes meet.
    pub met: R::Mask,
    /// The lanes of `met` where the normal differs from the present one.
    pub turned: R::Mask,
    /// The part of the whole way until then.
    pub share: R,
    /// The contact then, with geom 1 at rest.
    pub pos: V3<R>,
    pub normal: V3<R>,
}

/// Returns the contact with the geoms at these poses: the touch in its slot, or for a manifold the
/// nearest one.
#[inline(always)]
fn same<R: Real, P>(
    model: &Model<R::Value>,
    pair: &Pair<P>,
    one: &Pose<R>,
    two: &Pose<R>,
    contact: &Contact<R>,
) -> Touch<R> {
    let mut found: Option<Touch<R>> = None;
    let nearest = pair.test.by_feature();
    meet_at(model, pair, [one, two], (|_| f64::INFINITY, &[]), |part, touch| match &mut found {
        Some(best) if nearest => {
            let nearer = touch.exists.and(best.exists.not().or(touch.dist.lt(best.dist)));
            *best = touch.or_else(nearer, best);
        }
        None if nearest || part == contact.part => found = Some(*touch),
        _ => {}
    });
    found.unwrap_or(Touch {
        dist: contact.dist,
        pos: contact.pos,
        normal: contact.normal,
        exists: contact.mask,
        feature: contact.feature,
    })
}

/// Moves geom 2 of a contact's pair along `way` [m], relative to geom 1, in the lanes of `open`, until
/// the two are `near` [m].
pub(crate) fn time_of_impact<R: Real>(
    model: &Model<R::Value>,
    placed: &Placed<R>,
    contact: &Contact<R>,
    way: &V3<R>,
    near: R,
    open: R::Mask,
) -> TimeOfImpact<R> {
    let pair = &contact.pair;
    let mut now = TimeOfImpact {
        met: open,
        turned: R::Mask::of(false),
        share: R::zero(),
        pos: contact.pos,
        normal: contact.normal,
    };
    let (mut dist, mut todo) = (contact.dist, open);
    for _ in 0..PLANES {
        todo = todo.and(near.lt(dist));
        if todo.none() {
            break;
        }
        let closing = -now.normal.dot(way);
        let share = now.share + dist / R::select(closing.gt(R::zero()), closing, R::one());
        let past = closing.le(R::zero()).or(R::one().lt(share));
        now.met = now.met.and(todo.and(past).not());
        todo = todo.and(past.not());
        if todo.none() {
            break;
        }
        now.share = R::select(todo, share, now.share);
        let other = &placed.geom[pair.geom2];
        let moved = Pose { pos: other.pos + way * now.share, rot: other.rot };
        let touch = same(model, pair, &placed.geom[pair.geom1], &moved, contact);
        dist = R::select(todo, touch.dist, dist);
        for k in 0..3 {
            now.pos[k] = R::select(todo, touch.pos[k], now.pos[k]);
            now.normal[k] = R::select(todo, touch.normal[k], now.normal[k]);
        }
    }
    now.turned = now.met.and(now.normal.dot(&contact.normal).lt(R::of(TURNED)));
    now
}
