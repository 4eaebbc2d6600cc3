//! Stage 2, detect: every place where shapes touch or are about to.
//!
//! Candidate pairs were chosen when the model was compiled, or in a pile are found by a broad phase
//! (`near.rs`, `kept.rs`, `broad.rs`). Each is tested here by its bounding spheres and boxes
//! (`apart.rs`), which are enlarged by the motion of the guess where contacts ahead are requested
//! (`swept.rs`), and then exactly. Contacts come out in pair order, whatever the lanes hold, so that
//! row order never depends on anything else.

mod apart;
mod broad;
mod kept;
mod near;
pub(crate) mod path;
mod swept;
#[cfg(test)]
mod tests;
mod touches;

pub use crate::shapes::frame::tangents;
pub use touches::PosedTouches;

use crate::shapes::frame::hint;

use crate::elements::{Element, Kind};
use crate::error::{Error, Result};
use crate::model::{Model, Pair, NONE};
use crate::place::Placed;
use crate::pool::Pool;
use crate::real::{Constant, Mask, Real, Value};
use crate::room::can_be_had;
use crate::shapes::{self, Hint, Hints, ShapeTest, Touch};
use crate::spatial::{Pose, V3};
use apart::near;
use core::cell::Cell;
use kept::Kept;
pub(crate) use kept::Lists;
use near::Found;
use std::sync::{Arc, Mutex};
use swept::Swept;

/// One contact between the two geoms of a pair.
#[derive(Clone, Debug)]
pub struct Contact<R: Real> {
    pub pair: Pair<R>,
    /// The index of this contact in its pair; keeps its meaning from step to step.
    pub part: usize,
    /// The features that touch: see `Touch::feature`.
    pub feature: R,
    /// Lanes in which the contact is listed.
    pub mask: R::Mask,
    /// Signed distance [m], negative = overlap.
    pub dist: R,
    /// Halfway between the surfaces.
    pub pos: V3<R>,
    /// Unit, from geom 1 to geom 2.
    pub normal: V3<R>,
    /// Vector from geom 2's contact point to `pos`, nonzero where the two only meet on their way.
    pub ahead: V3<R>,
}

/// Bytes of a contact, of its rows, and of their solution; and the number that needs no check.
const CONTACT: usize = 3500;
const FEW: usize = 20_000;

/// The output of this stage.
pub struct Detected<R: Real> {
    pub contacts: Vec<Contact<R>>,
    /// Number of times that the list grew: 0 in a run with enough `max_contacts`.
    pub grown: u64,
    swept: Swept<R>,
    pub(crate) lists: Lists,
    /// By tree: it sleeps, and is not tested against fixed geoms; empty if no tree sleeps.
    pub(crate) asleep: Vec<bool>,
    /// This many contacts were found to fit into the memory, with their rows.
    fitting: usize,
    /// By fixed pair and lane; no part of a state.
    pub(crate) hints: Vec<Hint>,
    /// The near pairs of a pile.
    kept: Kept,
    /// By part of the near pairs, where threads share the work.
    found: Vec<Mutex<Found<R>>>,
    pub(crate) pool: Option<Arc<Pool>>,
    /// Every pair is tested exactly, whatever its distance.
    #[cfg(test)]
    pub(crate) exhaustive: bool,
}

room!(Detected<R>: contacts, grown, swept, lists, asleep, fitting, hints, kept, found,
    pool; #[cfg(test)] exhaustive);

impl<R: Real> Detected<R> {
    pub fn new(model: &Model<R::Value>, max_contacts: usize) -> Self {
        let convex = |pair: &Pair<R::Value>| matches!(pair.test, ShapeTest::Convex(..));
        let last = model.pairs.iter().rposition(convex).map_or(0, |last| last + 1);
        Self {
            hints: vec![Hint::default(); R::LANES * last],
            contacts: Vec::with_capacity(max_contacts),
            grown: 0,
            swept: Swept::new(),
            lists: Lists::new(model),
            kept: Kept::default(),
            found: vec![],
            pool: None,
            asleep: vec![],
            fitting: FEW,
            #[cfg(test)]
            exhaustive: false,
        }
    }

    /// Lists the contacts of the present positions, and with `ahead` [s] also of the guess within that
    /// time (the row maker drops any that stay apart); more than the memory holds are an error.
    pub fn detect(
        &mut self,
        model: &Model<R::Value>,
        placed: &Placed<R>,
        ahead: Option<f64>,
        qpos: &[R],
    ) -> Result<()> {
        self.contacts.clear();
        if !(model.features.contact && model.features.constraint) {
            return Ok(());
        }
        if let Some(dt) = ahead {
            self.swept.sweep(model, placed, dt);
        }
        match &model.dynamic_pairs {
            Some(heap) if R::ALONE => self.detect_near(model, heap, placed, ahead.is_some())?,
            _ => self.detect_fixed(model, placed, qpos, ahead.is_some()),
        }
        self.check_room()
    }

    /// Checks that the rows of the contacts, and their solution, fit into the memory.
    fn check_room(&mut self) -> Result<()> {
        let count = self.contacts.len();
        if count > self.fitting {
            if !can_be_had(count.saturating_mul(CONTACT * R::LANES)) {
                self.contacts.clear();
                return Err(Error::value("contacts", count, "as many as the memory can hold"));
            }
            self.fitting = count;
        }
        Ok(())
    }

    /// Lists the contacts of pairs that were chosen when the model was compiled.
    fn detect_fixed(
        &mut self,
        model: &Model<R::Value>,
        placed: &Placed<R>,
        qpos: &[R],
        ahead: bool,
    ) {
        let inside = !beyond(model, qpos);
        let sleeps = self.asleep.contains(&true);
        let asks = !ahead;
        #[cfg(test)]
        let asks = asks && !self.exhaustive;
        let mut next = 0;
        while let Some(bodies) = model.body_pairs.get(next) {
            if asks && bodies.spheres.far(placed, inside) {
                next = bodies.next;
                continue;
            }
            next += 1;
            let own = bodies.pairs;
            for (pair, spheres) in own.of(&model.pairs).iter().zip(own.of(&model.spheres)) {
                if asks && spheres.far(placed, inside) {
                    continue;
                }
                let rests = |geom| rests(model, &self.asleep, geom);
                if sleeps && rests(pair.geom1) && rests(pair.geom2) {
                    continue;
                }
                self.meet_fixed(model, &placed.geom, pair, ahead);
            }
        }
    }

    /// Lists the contacts of a pair that its spheres do not keep apart.
    pub(crate) fn meet_fixed<P: Value<R>>(
        &mut self,
        model: &Model<R::Value>,
        poses: &[Pose<R>],
        pair: &Pair<P>,
        ahead: bool,
    ) {
        let more = ahead.then(|| self.swept.of(model, pair));
        let near = near(model, poses, pair, more);
        #[cfg(test)]
        let near = if self.exhaustive { R::Mask::of(true) } else { near };
        if near.none() {
            return;
        }
        let listed = listed(model, pair, more);
        let hints = match pair.test {
            ShapeTest::Convex(..) => &mut self.hints[R::LANES * pair.index..][..R::LANES],
            _ => &mut [],
        };
        let hints = Cell::from_mut(hints).as_slice_of_cells();
        meet(model, poses, pair, (within(model, pair, ahead), hints), |part, touch| {
            let mask = near.and(touch.exists.and(touch.dist.lt(listed)));
            if mask.any() {
                push(&mut self.contacts, &mut self.grown, Contact::of(pair, part, touch, mask));
            }
        });
    }

    /// Returns the lists that the spans of rows point into: see `Situation::dof_lists`.
    pub fn dof_lists<'a>(&'a self, model: &'a Model<R::Value>) -> &'a [usize] {
        self.lists.of(model)
    }
}

/// Checks for a geom that is fixed, or whose tree sleeps. For sleeping trees a mocap body is awake.
fn rests<N: Constant>(model: &Model<N>, asleep: &[bool], geom: usize) -> bool {
    let body = model.geoms[geom].body;
    let tree = model.bodies[body].tree;
    if tree == NONE {
        return asleep.is_empty() || !model.is_mocap(body);
    }
    asleep.get(tree).is_some_and(|asleep| *asleep)
}

/// Returns the distance below which the contacts of a pair are listed [m]. `more`: the motion of the
/// guess. Beyond it the row maker drops the contacts that are in a lane only because a neighbour is
/// faster; but adhesion would pull there.
fn listed<R: Real, P>(model: &Model<R::Value>, pair: &Pair<P>, more: Option<R>) -> R {
    match more {
        Some(more) if model.adheres => more,
        Some(_) => R::of(f64::INFINITY),
        None => model.material(pair).listed(),
    }
}

/// The same for the exact test, by lane.
fn within<'a, N: Constant, P>(
    model: &'a Model<N>,
    pair: &Pair<P>,
    ahead: bool,
) -> impl Fn(usize) -> f64 + use<'a, N, P> {
    let material = model.material(pair);
    move |lane| if ahead { f64::INFINITY } else { material.listed_in(lane) }
}

/// Lists a contact.
fn push<R: Real>(contacts: &mut Vec<Contact<R>>, grown: &mut u64, contact: Contact<R>) {
    if contacts.len() == contacts.capacity() {
        *grown += 1;
    }
    contacts.push(contact);
}

impl<R: Real> Contact<R> {
    fn of<P: Value<R>>(pair: &Pair<P>, part: usize, touch: &Touch<R>, mask: R::Mask) -> Self {
        Self {
            pair: pair.get(),
            part,
            feature: touch.feature,
            mask,
            dist: touch.dist,
            pos: touch.pos,
            normal: touch.normal,
            ahead: V3::zeros(),
        }
    }

    /// Returns the contact points of the two geoms, each on its body: see `ahead`.
    pub fn points(&self) -> [V3<R>; 2] {
        [self.pos, self.pos - self.ahead]
    }

    /// Returns the element of this contact.
    pub fn element(&self) -> Element {
        Element::part(Kind::Contact, self.pair.index, self.part)
    }

    /// Returns the two directions of friction; with the normal they are the contact's frame.
    pub fn tangents(&self, placed: &Placed<R>) -> [V3<R>; 2] {
        let pair = &self.pair;
        let hint = hint(pair.test, &placed.geom[pair.geom2]);
        let (y, z) = tangents(&self.normal, hint.as_ref());
        [y, z]
    }
}

/// Checks whether a joint is, in some lane, where pairs that its range keeps apart may meet after all.
fn beyond<R: Real>(model: &Model<R::Value>, qpos: &[R]) -> bool {
    let beyond = model.guards.iter().fold(R::Mask::of(false), |beyond, guard| {
        let q = qpos[guard.at];
        beyond.or(q.ge(R::of(guard.low)).and(q.le(R::of(guard.high))).not())
    });
    beyond.any()
}

/// Calls `each` with the touches of all pairs of the model that are at most `more` from being listed.
pub(crate) fn almost<R: Real>(
    model: &Model<R::Value>,
    poses: &[Pose<R>],
    more: f64,
    mut each: impl FnMut(&Pair<R::Value>, &Touch<R>),
) {
    for pair in &model.pairs {
        let listed = model.material(pair).listed::<R>() + R::of(more);
        if near(model, poses, pair, Some(listed)).any() {
            let hints = [Cell::new(Hint::default())];
            meet(model, poses, pair, (|lane| listed.lane(lane), &hints), |_, touch| {
                if touch.exists.and(touch.dist.le(listed)).any() {
                    each(pair, touch);
                }
            });
        }
    }
}

/// Returns the smallest distance of a pair's geoms [m].
pub(crate) fn distance(model: &Model, placed: &Placed<f64>, pair: &Pair) -> f64 {
    let mut least = f64::INFINITY;
    meet(model, &placed.geom, pair, (|_| f64::INFINITY, &[]), |_, touch| {
        if touch.exists {
            least = least.min(touch.dist);
        }
    });
    least
}

/// Checks that boxes or spheres about a pair's geoms are apart by more than `more` [m], which is much
/// cheaper than `distance`.
pub(crate) fn boxes_apart(model: &Model, placed: &Placed<f64>, pair: &Pair, more: f64) -> bool {
    !near(model, &placed.geom, pair, Some(more))
}

/// Tests one pair exactly: `take(part, touch)` gets the touch of each slot, if nearer than `within`
/// [m].
#[inline(always)]
fn meet<R: Real, P>(
    model: &Model<R::Value>,
    poses: &[Pose<R>],
    pair: &Pair<P>,
    look: (impl Fn(usize) -> f64, Hints),
    take: impl FnMut(usize, &Touch<R>),
) {
    meet_at(model, pair, [&poses[pair.geom1], &poses[pair.geom2]], look, take);
}

/// Does the same with the two geoms at these poses.
#[inline(always)]
fn meet_at<R: Real, P>(
    model: &Model<R::Value>,
    pair: &Pair<P>,
    [p1, p2]: [&Pose<R>; 2],
    look: (impl Fn(usize) -> f64, Hints),
    take: impl FnMut(usize, &Touch<R>),
) {
    let one = model.geoms[pair.geom1].shape(p1);
    let two = model.geoms[pair.geom2].shape(p2);
    shapes::meet(pair.test, &one, &two, look, take);
}
