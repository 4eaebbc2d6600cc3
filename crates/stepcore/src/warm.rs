//! Data that a step passes to the next besides positions and velocities: impulses and accelerations
//! to start from, and the sleeping trees.

use crate::real::Real;

/// The most rows of a block, ensured by `elements/constraints.rs`: their impulses are followed by
/// the slip of sticking friction (`elements/stiction.rs`).
pub const SLIP: usize = 10;
/// The stored numbers of a contact's slip: two vectors, the shift and the rotation of geom 2 [m, rad].
pub const SLIPS: usize = 6;
/// The stored numbers of a source.
pub const WARM_ROWS: usize = SLIP + SLIPS;

/// Slots from this one on hold accelerations, from which Newton's method starts (MuJoCo's
/// `qacc_warmstart`), in the factored coordinates of their step; `WARM_ROWS` dofs each.
pub const ACCELERATIONS: u64 = 1 << 48;

/// The impulses of one contact, limit or other source, stored for the next step's start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Warm<R: Real> {
    /// The slot of the source (see `Block::slot`); ascending in the list.
    pub slot: u64,
    /// The feature among its kin (see `Block::feature`); −1 in lanes without one.
    pub feature: R,
    /// Per row of its block [N·s or N·m·s], zero beyond; from `SLIP` on slip [m] and turn [rad].
    pub impulse: [R; WARM_ROWS],
}

impl<R: Real> Warm<R> {
    /// The same in every lane.
    pub fn of(plain: &Warm<f64>) -> Self {
        Self { slot: plain.slot, feature: R::of(plain.feature), impulse: plain.impulse.map(R::of) }
    }

    /// One lane's part.
    pub fn in_lane(&self, lane: usize) -> Warm<f64> {
        Warm {
            slot: self.slot,
            feature: self.feature.lane(lane),
            impulse: self.impulse.map(|x| x.lane(lane)),
        }
    }

    /// Returns whether it acts: an impulse of zero counts as none.
    pub fn acts(&self) -> bool {
        self.impulse.iter().any(|x| !x.is_zero())
    }
}

/// The island of a tree that does not sleep.
pub const AWAKE: usize = usize::MAX;

/// The sleeping trees; a part of the state. Empty lists: no tree ever was slow.
#[derive(Clone, Debug, PartialEq)]
pub struct Sleep<R: Real> {
    /// Per tree: the number of steps for which it has been slow.
    pub slow: Vec<u64>,
    /// Per tree: the lowest tree of its sleeping island; `AWAKE` if it does not sleep.
    pub island: Vec<usize>,
    /// Per entry of qpos, if its tree sleeps: its position.
    pub qpos: Vec<R>,
    /// The impulses of each island's last step awake; ascending slots within one.
    pub kept: Vec<(usize, Warm<R>)>,
}

room!(Sleep<R>: slow, island, qpos, kept);

impl<R: Real> Default for Sleep<R> {
    fn default() -> Self {
        Self::new()
    }
}

impl<R: Real> Sleep<R> {
    /// Creates it with no sleeping tree.
    pub fn new() -> Self {
        Self { slow: vec![], island: vec![], qpos: vec![], kept: vec![] }
    }

    /// Returns whether some tree sleeps.
    pub fn any(&self) -> bool {
        self.island.iter().any(|island| *island != AWAKE)
    }

    /// Returns whether a tree sleeps.
    pub fn has(&self, tree: usize) -> bool {
        self.island.get(tree).is_some_and(|island| *island != AWAKE)
    }

    pub(crate) fn copy_to(&self, to: &mut Self) {
        to.slow.clone_from(&self.slow);
        to.island.clone_from(&self.island);
        to.qpos.clone_from(&self.qpos);
        to.kept.clone_from(&self.kept);
    }

    /// Converts to other numbers, from lane 0, as no tree sleeps in lanes.
    pub fn cast<Q: Real>(&self) -> Sleep<Q> {
        let number = |x: R| Q::of(x.lane(0));
        let warm = |w: &Warm<R>| Warm::of(&w.in_lane(0));
        Sleep {
            slow: self.slow.clone(),
            island: self.island.clone(),
            qpos: self.qpos.iter().map(|x| number(*x)).collect(),
            kept: self.kept.iter().map(|(island, w)| (*island, warm(w))).collect(),
        }
    }
}
