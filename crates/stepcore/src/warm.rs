//! The data that a step passes to the next besides positions and velocities: impulses and
//! accelerations to start from, and the sleeping trees.

use crate::real::Real;

/// The most rows of a block, which `elements/constraints.rs` ensures: after their impulses comes
/// the slip of sticking friction (`elements/stiction.rs`).
pub const SLIP: usize = 10;
/// The stored slip of a contact, as vectors by which and about which geom 2 moved [m, rad].
pub const SLIPS: usize = 6;
/// The stored numbers of a source from step to step.
pub const WARM_ROWS: usize = SLIP + SLIPS;

/// From this slot on come accelerations, from which Newton's method starts (MuJoCo's
/// `qacc_warmstart`), in the factored coordinates of their step; `WARM_ROWS` dofs each.
pub const ACCELERATIONS: u64 = 1 << 48;

/// The impulses of one contact, limit or other source, kept for the next step's start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Warm<R: Real> {
    /// Which source (see `Block::slot`); ascending in the list.
    pub slot: u64,
    /// Which of its kin (see `Block::feature`); −1 in lanes that have none.
    pub feature: R,
    /// By row of its block [N·s or N·m·s], zero beyond; from `SLIP` on slip [m] and turn [rad].
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

    /// Whether it acts: an impulse of zero equals none.
    pub fn acts(&self) -> bool {
        self.impulse.iter().any(|x| !x.is_zero())
    }
}

/// The island of a tree that does not sleep.
pub const AWAKE: usize = usize::MAX;

/// The sleeping trees; a part of the state. Empty lists: none ever was slow.
#[derive(Clone, Debug, PartialEq)]
pub struct Sleep<R: Real> {
    /// For each tree: for how many steps it has been slow.
    pub slow: Vec<u64>,
    /// For each tree: the lowest tree of the island with which it sleeps; `AWAKE` in none.
    pub island: Vec<usize>,
    /// For each entry of qpos, where a tree sleeps: its position.
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
    /// No tree sleeps.
    pub fn new() -> Self {
        Self { slow: vec![], island: vec![], qpos: vec![], kept: vec![] }
    }

    /// Whether any tree sleeps.
    pub fn any(&self) -> bool {
        self.island.iter().any(|island| *island != AWAKE)
    }

    /// Whether a tree sleeps.
    pub fn has(&self, tree: usize) -> bool {
        self.island.get(tree).is_some_and(|island| *island != AWAKE)
    }

    pub(crate) fn copy_to(&self, to: &mut Self) {
        to.slow.clone_from(&self.slow);
        to.island.clone_from(&self.island);
        to.qpos.clone_from(&self.qpos);
        to.kept.clone_from(&self.kept);
    }

    /// The same in another number type, from lane 0: nothing sleeps in lanes.
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
