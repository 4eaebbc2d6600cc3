//! The system: rows, and the blocks in which they are solved.
//!
//! With w = J v⁺ + c λ − t, a block is (J, t, c, set): λ and w must meet the set's law. A row
//! stores y = L⁻ᵀJᵀ instead of J (see `place/factor.rs`), so J v = y·u and an impulse changes u by
//! D⁻¹ y λ. The solvers read this file's data and nothing else: they are independent of the rows'
//! origin.

use super::contact_islands::ContactIslands;
use super::direct::Direct;
use super::dofs::any_heap;
use super::dot::dot;
use super::free_bodies::FreeBodies;
use super::saved_solve::SavedSolve;
use super::situation::Situation;
use crate::elements::friction::MOST_WAYS;
use crate::elements::{Element, Role};
use crate::model::{Model, Span};
use crate::pool::Pool;
use crate::real::array::map;
use crate::real::{Mask, Real};
use crate::spatial::{V3, WIDE};
use std::ops::Range;
use std::sync::{Arc, Mutex};

/// One row. Impulses in N·s or N·m·s.
#[derive(Clone, Debug, PartialEq)]
pub struct Row<R: Real> {
    /// Into `Situation::dof_lists`: the dofs that the row touches, ascending and ancestor-closed.
    pub dofs: Span,
    /// First entry in `Rows::y`; as many entries as `dofs`.
    pub y: usize,
    /// Target velocity.
    pub t: R,
    /// Regulariser.
    pub c: R,
    /// A = J H⁻¹ Jᵀ = Σ y² / D.
    pub a: R,
    /// One over the denominator of an update: 1/(A + c), or 1/(A + softness) under `relaxed`.
    pub inv_s: R,
    /// Bounds of the impulse, for intervals.
    pub lo: R,
    pub hi: R,
    pub impulse: R,
    /// The impulse given in the stages of the step under `midpoint` and `rk4`. `impulse`, `t`, `c`
    /// and `Rows::u` belong to the velocity at its end alone.
    pub beside: R,
    /// J v at the start of the step, for reports.
    pub velocity: R,
    /// The distance that the row keeps, minus its margin [m or rad]; 0 for a row that restores
    /// none.
    pub gap: R,
}

impl<R: Real> Row<R> {
    /// Returns the total impulse of the step.
    pub fn total(&self) -> R {
        self.impulse + self.beside
    }

    /// Returns t − Jv − cλ.
    #[inline(always)]
    pub(super) fn short(&self, dof_lists: &[usize], y: &[R], u: &[R]) -> R {
        let dofs = self.dofs.of(dof_lists);
        self.t - dot(dofs, &y[self.y..self.y + dofs.len()], u) - self.c * self.impulse
    }

    /// Returns λ + (t − Jv − cλ)/s within its bounds.
    #[inline(always)]
    pub(super) fn updated(&self, short: R) -> R {
        (self.impulse + short * self.inv_s).clamp(self.lo, self.hi)
    }

    /// Returns the row of one lane; numbers without their slopes.
    pub(super) fn at_lane<S: Real<Mask = bool>>(&self, lane: usize) -> Row<S> {
        self.in_numbers(|x| S::of(x.lane(lane)))
    }

    /// Converts to other numbers.
    pub(crate) fn in_numbers<S: Real>(&self, of: impl Fn(&R) -> S) -> Row<S> {
        let Self { dofs, y, t, c, a, inv_s, lo, hi, impulse, beside, velocity, gap } = self;
        Row {
            dofs: *dofs,
            y: *y,
            t: of(t),
            c: of(c),
            a: of(a),
            inv_s: of(inv_s),
            lo: of(lo),
            hi: of(hi),
            impulse: of(impulse),
            beside: of(beside),
            velocity: of(velocity),
            gap: of(gap),
        }
    }
}

/// The most rows of a block that is a cone: the normal, two tangents, torsion and two ways of
/// rolling. Blocks of intervals may have any number.
pub(crate) const CONE: usize = 6;
/// In a plane: normal and tangent.
pub(crate) const PLANAR: usize = 2;
/// A cone with at most this many rows (normal and tangents) has separate formulas.
pub(crate) const NARROW: usize = 3;
/// With torsion.
pub(crate) const SPINNING: usize = 4;

/// The law between a block's impulses and its residual velocities.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Set {
    /// Each row by itself: λ in [lo, hi].
    Interval,
    /// Row 0 is the normal. λ ∈ K, w ∈ K*, λ·w = 0 with the round cone |λ_t| ≤ μ λ_n. Rows with
    /// another coefficient are scaled so that it is μ: see `elements/friction.rs`.
    Convex,
    /// Row 0 is the normal. λ ∈ K, w + (μ|w_t|, 0, 0) ∈ K*, complementary; round cone.
    CoulombRound,
    /// The same with the box |λ_i| ≤ μ λ_n.
    CoulombBox,
}

/// Consecutive rows solved together.
#[derive(Clone, Debug, PartialEq)]
pub struct Block<R: Real> {
    pub rows: Span,
    pub set: Set,
    /// Lanes in which the block exists.
    pub mask: R::Mask,
    /// Friction of a cone.
    pub mu: R,
    /// Mass of the trees that the block touches, for its residual.
    pub mass: R,
    /// The element that the block came from.
    pub element: Element,
    pub role: Role,
    /// Its permanent number, for warm starts; ascending.
    pub slot: u64,
    /// The slots in which it may have been in the step before: see `feature`.
    pub kin: Range<u64>,
    /// The touching features, which identify a contact among its kin: see `Touch::feature`.
    pub feature: R,
    pub island: usize,
    /// The slot's place within its island: see `Model::ranks`.
    pub rank: u32,
}

impl<R: Real> Block<R> {
    /// Returns the entries of its curvature: one per row for intervals, n for a cone of n rows.
    pub(super) fn curves(&self) -> usize {
        if self.set == Set::Interval {
            self.rows.len
        } else {
            self.rows.len * self.rows.len
        }
    }

    /// Returns the block of one lane; numbers without their slopes.
    pub(super) fn at_lane<S: Real<Mask = bool>>(&self, lane: usize) -> Block<S> {
        self.in_numbers(|mask| mask.lane(lane), |x| S::of(x.lane(lane)))
    }

    /// Converts to other numbers.
    pub(crate) fn in_numbers<S: Real>(
        &self,
        lanes: impl Fn(&R::Mask) -> S::Mask,
        of: impl Fn(&R) -> S,
    ) -> Block<S> {
        let Self { rows, set, mask, mu, mass, element, role, slot, kin, feature, island, rank } =
            self;
        Block {
            rows: *rows,
            set: *set,
            mask: lanes(mask),
            mu: of(mu),
            mass: of(mass),
            element: *element,
            role: *role,
            slot: *slot,
            kin: kin.clone(),
            feature: of(feature),
            island: *island,
            rank: *rank,
        }
    }
}

/// A contact's impulse without a row, already in the guess: see `elements/penalty.rs`.
#[derive(Clone, Debug)]
pub struct Push<R: Real> {
    pub element: Element,
    /// As in a row.
    pub dofs: Span,
    pub y: usize,
    /// [N·s]
    pub impulse: R,
}

/// The slip of a contact in this step.
#[derive(Clone, Debug)]
pub(crate) struct Anchor<R: Real> {
    /// The index of the block.
    pub block: usize,
    pub slide: V3<R>,
    pub turn: V3<R>,
    /// Per way, in the scale of its row.
    pub along: [R; MOST_WAYS],
    /// dt K d: a row's t per slip.
    pub pull: R,
}

/// The rows of one step.
pub struct Rows<R: Real> {
    pub rows: Vec<Row<R>>,
    pub blocks: Vec<Block<R>>,
    pub pushes: Vec<Push<R>>,
    pub y: Vec<R>,
    /// u = L v, by dof: first the guess, then with the effect of every impulse up to now.
    pub u: Vec<R>,
    /// The u that Newton's method tries first; if empty, the u with the rows' impulses.
    pub(crate) start: Vec<R>,
    /// Each row's impulse from the main solve, if noslip has changed friction since; else empty.
    pub(crate) main: Vec<R>,
    /// Per block, for contacts whose friction sticks.
    pub(crate) anchors: Vec<Anchor<R>>,
    /// The largest overlap that `max_recovery_speed` left in this step [m].
    pub unrecovered: R,
    pub(crate) scratch: Vec<R>,
    /// y of a contact's normal and ways of friction, from which its edges are made.
    pub(crate) ways: Vec<R>,
    /// v̂, while rows are built.
    pub(crate) guess: Vec<R>,
    pub(crate) direct: Direct<R>,
    pub(crate) saved_solve: SavedSolve<R>,
    /// Whether some island may hold so many trees that the order of elimination matters.
    pub(crate) heap: bool,
    /// Per tree: see `Model::islands`.
    pub(super) islands: Vec<usize>,
    /// Per island: the trace of the mass matrix, if a tolerance is a share of it.
    pub(crate) inertia: Vec<R>,
    /// Per slot: see `Model::ranks`.
    ranks: Vec<u32>,
    /// Islands of the current rows, which replace both.
    pub(crate) contact_islands: Option<ContactIslands>,
    /// Rows of parts of the contacts, if threads share the work.
    pub(crate) parts: Vec<Mutex<Rows<R>>>,
    pub(crate) pool: Option<Arc<Pool>>,
}

room!(Rows<R>: rows, blocks, pushes, y, u, start, main, anchors, unrecovered, scratch, ways, guess, direct,
    saved_solve, heap, islands, inertia, ranks, contact_islands, parts,
    pool);

/// The guess along a row.
pub(crate) struct Guessed<R: Real> {
    /// φ + dt·J v̂ < 0: the guess violates the row.
    pub closing: R::Mask,
    /// J v̂ minus J v of the start.
    pub gained: R,
}

impl<R: Real> Rows<R> {
    pub fn new(model: &Model<R::Value>) -> Self {
        let islands = model.islands();
        let heap = model.dynamic_pairs.is_some() || any_heap(&islands);
        Self {
            rows: Vec::new(),
            blocks: Vec::new(),
            pushes: Vec::new(),
            main: Vec::new(),
            anchors: Vec::new(),
            y: Vec::new(),
            u: vec![R::zero(); model.nv],
            start: Vec::new(),
            unrecovered: R::zero(),
            scratch: vec![R::zero(); WIDE * model.nv],
            ways: Vec::new(),
            guess: vec![R::zero(); model.nv],
            direct: Direct::new(model.nv),
            saved_solve: SavedSolve::new(model.nv),
            ranks: model.ranks(&islands),
            heap,
            contact_islands: model.dynamic_pairs.is_some().then(ContactIslands::default),
            islands,
            inertia: Vec::new(),
            parts: Vec::new(),
            pool: None,
        }
    }

    /// Creates rows without a model, for rows made by hand.
    pub(crate) fn bare(nv: usize) -> Self {
        let u = vec![R::zero(); nv];
        Self {
            rows: Vec::new(),
            blocks: Vec::new(),
            pushes: Vec::new(),
            main: Vec::new(),
            anchors: Vec::new(),
            y: Vec::new(),
            scratch: u.clone(),
            ways: Vec::new(),
            guess: u.clone(),
            unrecovered: R::zero(),
            direct: Direct::new(nv),
            saved_solve: SavedSolve::new(nv),
            heap: false,
            u,
            start: Vec::new(),
            islands: Vec::new(),
            inertia: Vec::new(),
            ranks: Vec::new(),
            contact_islands: None,
            parts: Vec::new(),
            pool: None,
        }
    }

    pub fn clear(&mut self) {
        self.rows.clear();
        self.blocks.clear();
        self.pushes.clear();
        self.main.clear();
        self.anchors.clear();
        self.y.clear();
        self.start.clear();
        self.unrecovered = R::zero();
    }

    /// Returns y·x over a row's dofs.
    #[inline(always)]
    pub fn dot(&self, dof_lists: &[usize], row: &Row<R>, x: &[R]) -> R {
        let dofs = row.dofs.of(dof_lists);
        dot(dofs, &self.y[row.y..row.y + dofs.len()], x)
    }

    /// Takes J from `scratch` (set on `dofs`), lifts it to y, and computes A and J v.
    pub(crate) fn push_scratch(&mut self, now: &Situation<R>, dofs: Span) -> &mut Row<R> {
        let (list, metric) = (dofs.of(now.dof_lists), &now.placed.metric);
        let (start, path) = (self.y.len(), R::FILLS && metric.is_path(list));
        if !path {
            metric.lift(list, &mut self.scratch);
        }
        self.y.extend(list.iter().map(|k| self.scratch[*k]));
        if path {
            metric.lift_path::<1>(list, &mut self.y[start..]);
        }
        self.push_lifted(now, dofs, start)
    }

    /// Sets `scratch` to y of unit forces on the last dofs of a path, `WIDE` at most, side by side.
    pub(crate) fn lift_last(&mut self, now: &Situation<R>, path: &[usize], count: usize) {
        let own = &mut self.scratch[..WIDE * path.len()];
        own.fill(R::zero());
        for i in 0..count {
            own[(path.len() - count + i) * WIDE + i] = R::one();
        }
        now.placed.metric.lift_path::<WIDE>(path, own);
    }

    /// Pushes the row of one of them.
    pub(crate) fn push_last(&mut self, now: &Situation<R>, dofs: Span, which: usize) {
        let start = self.y.len();
        self.y.extend(self.scratch.chunks_exact(WIDE).map(|y| y[which]).take(dofs.len));
        self.push_lifted(now, dofs, start);
    }

    /// Pushes the row whose y is last, and computes A and J v.
    #[inline(always)]
    fn push_lifted(&mut self, now: &Situation<R>, dofs: Span, start: usize) -> &mut Row<R> {
        let (mut a, mut velocity) = (R::zero(), R::zero());
        for (&k, y) in dofs.of(now.dof_lists).iter().zip(&self.y[start..]) {
            a += *y * *y * now.placed.metric.inv_d[k];
            velocity += *y * now.placed.u[k];
        }
        self.push_row(dofs, start, a, velocity)
    }

    pub(super) fn push_row(&mut self, dofs: Span, y: usize, a: R, velocity: R) -> &mut Row<R> {
        let zero = R::zero();
        self.rows.push(Row {
            dofs,
            y,
            t: zero,
            c: zero,
            a,
            inv_s: zero,
            lo: zero,
            hi: R::of(f64::INFINITY),
            impulse: zero,
            beside: zero,
            velocity,
            gap: zero,
        });
        let at = self.rows.len() - 1;
        &mut self.rows[at]
    }

    /// Closes the rows from `first` on into one block.
    pub(crate) fn push_block(
        &mut self,
        first: usize,
        set: Set,
        mask: R::Mask,
        now: &Situation<R>,
        element: Element,
        mass: R,
    ) -> &mut Block<R> {
        let rows = Span { start: first, len: self.rows.len() - first };
        assert!(set == Set::Interval || rows.len <= CONE, "a cone of {} rows", rows.len);
        let dofs = self.rows[first].dofs.of(now.dof_lists);
        let island = dofs.first().map_or(0, |k| self.islands[now.model.dofs[*k].tree]);
        let slot = now.model.slot(element);
        let rank = self.ranks.get(slot as usize).copied().unwrap_or(0);
        let mu = R::zero();
        self.blocks.push(Block {
            rows,
            set,
            mask,
            mu,
            mass,
            element,
            role: element.kind.role(),
            slot,
            kin: slot..slot + 1,
            feature: mu,
            island,
            rank,
        });
        let at = self.blocks.len() - 1;
        &mut self.blocks[at]
    }

    /// Returns the guess along a row at distance φ.
    pub(crate) fn guessed(&self, now: &Situation<R>, row: usize, phi: R) -> Guessed<R> {
        let row = &self.rows[row];
        let velocity = self.dot(now.dof_lists, row, &now.placed.guess);
        let closing = (phi + R::of(now.settings.dt) * velocity).lt(R::zero());
        Guessed { closing, gained: velocity - row.velocity }
    }

    /// Removes the row pushed last.
    pub(crate) fn pop_row(&mut self) {
        if let Some(row) = self.rows.pop() {
            self.y.truncate(row.y);
        }
    }

    /// u ← u + D⁻¹ y · change, in the lanes of `mask`.
    #[inline(always)]
    pub fn kick(u: &mut [R], inv_d: &[R], dofs: &[usize], y: &[R], change: R, mask: R::Mask) {
        for (k, y) in dofs.iter().zip(y) {
            let new = u[*k] + inv_d[*k] * *y * change;
            u[*k] = R::select(mask, new, u[*k]);
        }
    }

    /// Adds the effect of the rows' current impulses to u.
    pub fn apply_impulses(&mut self, dof_lists: &[usize], inv_d: &[R]) {
        for block in &self.blocks {
            let mut own = &self.rows[block.rows.range()];
            // Four at a time, each dof's sum in the order of the rows.
            while let [a, b, c, d, rest @ ..] = own {
                let dofs = a.dofs.of(dof_lists);
                let y = map([a, b, c, d], |row| &self.y[row.y..row.y + dofs.len()]);
                let change = map([a, b, c, d], |row| row.impulse);
                own = rest;
                let free = if block.mask.all() { FreeBodies::ascending(dofs) } else { None };
                if let Some(free) = free {
                    free.kick_four(y, change, inv_d, &mut self.u);
                    continue;
                }
                for (at, k) in dofs.iter().enumerate() {
                    let (mut new, inv_d) = (self.u[*k], inv_d[*k]);
                    for i in 0..4 {
                        new += inv_d * y[i][at] * change[i];
                    }
                    self.u[*k] = R::select(block.mask, new, self.u[*k]);
                }
            }
            for row in own {
                let dofs = row.dofs.of(dof_lists);
                let y = &self.y[row.y..row.y + dofs.len()];
                Self::kick(&mut self.u, inv_d, dofs, y, row.impulse, block.mask);
            }
        }
    }

    /// Returns whether some block exists in some lane.
    pub fn any(&self) -> bool {
        self.blocks.iter().any(|block| block.mask.any())
    }
}
