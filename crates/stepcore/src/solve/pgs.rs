//! Projected Gauss-Seidel in factored coordinates.
//!
//! Plain: the rows of an island in order, sweep after sweep. An interval row moves
//! its impulse by (t − Jv − cλ)/s and clamps it; a cone is solved exactly as one
//! block. A sweep touches y and u only, never a matrix of rows.

use super::dot::dot;
use super::exact::{Convex, Tangents};
use super::momentum::Momentum;
use super::rows::{Block, Row, Rows, Set};
use crate::real::{Mask, Real};
use crate::room::room;
use std::mem;

/// How long to sweep.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    pub sweeps: u32,
    /// On the scalar residual [m/s]; 0 runs every sweep.
    pub tolerance: f64,
    /// Accelerate: see `momentum.rs`. For laws whose rows are all convex; an island
    /// with a Coulomb block runs plain.
    pub momentum: bool,
    /// One sweep solves a row that is alone, and it may end there.
    pub exact: bool,
    /// A tolerance below what rounding leaves of a residual is raised to that.
    pub rounding: bool,
}

/// What rounding leaves of a residual: this many units in the last place of its terms.
const UNITS: f64 = 32.0;

/// What a solve did, lane by lane.
#[derive(Clone, Copy, Debug)]
pub struct Report<R: Real> {
    /// Sweeps or iterations of the island that took the most.
    pub sweeps: R,
    /// Row updates: rows × sweeps, summed over islands.
    pub updates: R,
    /// Newton's decrement where it stopped, √(gᵀH⁻¹g) relative to the motion; 0 under PGS.
    pub decrement: R,
    /// Lanes in which some island used up its sweeps or iterations.
    pub open: R::Mask,
}

impl<R: Real> Report<R> {
    pub fn new() -> Self {
        let zero = R::zero();
        Self { sweeps: zero, updates: zero, decrement: zero, open: R::Mask::of(false) }
    }
}

impl Report<f64> {
    /// The same in numbers that carry slopes.
    pub fn in_numbers<R: Real<Mask = bool>>(self) -> Report<R> {
        let Self { sweeps, updates, decrement, open } = self;
        Report { sweeps: R::of(sweeps), updates: R::of(updates), decrement: R::of(decrement), open }
    }
}

impl<R: Real> Default for Report<R> {
    fn default() -> Self {
        Self::new()
    }
}

/// The blocks of each island.
#[derive(Default)]
pub(super) struct Order {
    /// Block indices, island after island, ascending within one.
    pub blocks: Vec<usize>,
    /// One past the last entry of each island in `blocks`.
    pub ends: Vec<usize>,
}

room!(Order: blocks, ends);

impl Order {
    /// A counting sort: stable, and free of allocation once it has room.
    pub fn sort<R: Real>(&mut self, blocks: &[Block<R>]) {
        let islands = blocks.iter().map(|b| b.island + 1).max().unwrap_or(0);
        self.ends.clear();
        self.ends.resize(islands, 0);
        for block in blocks {
            self.ends[block.island] += 1;
        }
        let mut start = 0;
        for end in &mut self.ends {
            let count = *end;
            *end = start;
            start += count;
        }
        self.blocks.clear();
        self.blocks.resize(blocks.len(), 0);
        for (at, block) in blocks.iter().enumerate() {
            let place = &mut self.ends[block.island];
            self.blocks[*place] = at;
            *place += 1;
        }
    }

    pub fn island(&self, island: usize) -> std::ops::Range<usize> {
        let start = if island == 0 { 0 } else { self.ends[island - 1] };
        start..self.ends[island]
    }
}

/// What a cone's exact solution needs, made once a solve.
enum Cone<R: Real> {
    /// Solved row by row.
    None,
    Convex(Convex<R>),
    Coulomb(Tangents<R>),
}

/// The method's memory; one a world or pack of lanes.
pub struct Pgs<R: Real> {
    order: Order,
    /// D⁻¹ y, in the layout of `Rows::y`.
    z: Vec<R>,
    /// √(A/m) by row: makes an impulse a speed.
    weight: Vec<R>,
    /// By block.
    cones: Vec<Cone<R>>,
    /// Absent only while a solve holds it.
    momentum: Option<Momentum<R>>,
}

room!(Pgs<R>: z, weight, cones; order, momentum);

impl<R: Real> Default for Pgs<R> {
    fn default() -> Self {
        Self::new()
    }
}

impl<R: Real> Pgs<R> {
    pub fn new() -> Self {
        Self {
            order: Order::default(),
            z: Vec::new(),
            weight: Vec::new(),
            cones: Vec::new(),
            momentum: Some(Momentum::new()),
        }
    }

    /// Sweeps over `rows` from the impulses they hold; `rows.u` must hold û and
    /// the effect of these impulses, and does so again afterwards.
    ///
    /// With a tolerance an island stops, lane by lane, after the first sweep whose
    /// residual is within it. The residual costs as much as a sweep, so it is
    /// computed only where the largest change of the sweep is within it already.
    pub fn solve(
        &mut self,
        dof_lists: &[usize],
        inv_d: &[R],
        rows: &mut Rows<R>,
        limits: Limits,
    ) -> Report<R> {
        self.prepare(dof_lists, inv_d, rows, limits.tolerance > 0.0);
        let mut report = Report::new();
        let (order, mut momentum) = (mem::take(&mut self.order), self.momentum.take());
        for island in 0..order.ends.len() {
            let blocks = &order.blocks[order.island(island)];
            let convex = |b: &usize| matches!(rows.blocks[*b].set, Set::Interval | Set::Convex);
            let mut momentum =
                momentum.as_mut().filter(|_| limits.momentum && blocks.iter().all(convex));
            if let Some(momentum) = &mut momentum {
                momentum.begin(dof_lists, inv_d, rows, blocks);
            }
            let mut live = alive(rows, blocks);
            let single = if limits.exact { rows.alone(blocks) } else { R::Mask::of(false) };
            let tolerance = self.reachable(dof_lists, rows, blocks, limits);
            let mut done = R::zero();
            for sweep in 0..limits.sweeps {
                if live.none() {
                    break;
                }
                let swept = if let Some(momentum) = &mut momentum {
                    let order = momentum.order(sweep);
                    self.sweep::<true>(dof_lists, rows, order, live, &mut report)
                } else {
                    self.sweep::<false>(dof_lists, rows, blocks, live, &mut report)
                };
                done = R::select(live, done + R::one(), done);
                live = live.and(single.not());
                if live.none() {
                    break;
                }
                if let Some(momentum) = &mut momentum {
                    momentum.step(dof_lists, &self.z, rows, blocks, swept.gain, live);
                }
                live = judge(dof_lists, rows, blocks, live, swept.change, tolerance);
            }
            report.sweeps = report.sweeps.max(done);
            report.open = report.open.or(live);
        }
        (self.order, self.momentum) = (order, momentum);
        report
    }

    fn prepare(&mut self, dof_lists: &[usize], inv_d: &[R], rows: &Rows<R>, weigh: bool) {
        self.order.sort(&rows.blocks);
        self.z.clear();
        self.z.resize(rows.y.len(), R::zero());
        for row in &rows.rows {
            let dofs = row.dofs.of(dof_lists);
            let own = row.y..row.y + dofs.len();
            for ((z, y), k) in self.z[own.clone()].iter_mut().zip(&rows.y[own]).zip(dofs) {
                *z = inv_d[*k] * *y;
            }
        }
        self.weight.clear();
        self.weight.resize(rows.rows.len(), R::zero());
        self.cones.clear();
        for block in &rows.blocks {
            if weigh {
                let per_mass = R::of(1.0 / block.mass);
                for at in block.rows.range() {
                    self.weight[at] = (rows.rows[at].a * per_mass).sqrt();
                }
            }
            self.cones.push(self.cone(dof_lists, rows, block));
        }
    }

    /// The tolerance, but no less than rounding lets any row reach.
    fn reachable(
        &self,
        dof_lists: &[usize],
        rows: &Rows<R>,
        blocks: &[usize],
        limits: Limits,
    ) -> R {
        let mut tolerance = R::of(limits.tolerance);
        if !limits.rounding {
            return tolerance;
        }
        for block in blocks.iter().map(|b| &rows.blocks[*b]) {
            for at in block.rows.range() {
                let row = &rows.rows[at];
                let dofs = row.dofs.of(dof_lists);
                let mut terms = row.t.abs() + (row.c * row.impulse).abs();
                for (k, y) in dofs.iter().zip(&rows.y[row.y..]) {
                    terms += (*y * rows.u[*k]).abs();
                }
                let least = R::of(UNITS * R::EPSILON) * terms * row.inv_s * self.weight[at];
                tolerance = R::select(block.mask, tolerance.max(least), tolerance);
            }
        }
        tolerance
    }

    fn cone(&self, dof_lists: &[usize], rows: &Rows<R>, block: &Block<R>) -> Cone<R> {
        if block.set == Set::Interval {
            return Cone::None;
        }
        let own = &rows.rows[block.rows.range()];
        let len = own.first().map_or(0, |row| row.dofs.of(dof_lists).len());
        // The rows of a cone share their dofs. A missing tangent is one that nothing moves.
        let entry = |i: usize, j: usize| match (own.get(i), own.get(j)) {
            (Some(p), Some(q)) if i == j => p.a + q.c,
            (Some(p), Some(q)) => {
                let (y, z) = (&rows.y[p.y..p.y + len], &self.z[q.y..q.y + len]);
                y.iter().zip(z).fold(R::zero(), |sum, (y, z)| sum + *y * *z)
            }
            _ => R::zero(),
        };
        if block.set == Set::Convex {
            let mut q =
                [entry(0, 0), entry(1, 0), entry(1, 1), entry(2, 0), entry(2, 1), entry(2, 2)];
            if own.len() < 2 {
                q[2] = q[0];
            }
            if own.len() < 3 {
                q[5] = q[2];
            }
            return Cone::Convex(Convex::new(q, block.mu));
        }
        Cone::Coulomb(Tangents::new(entry(1, 1), entry(2, 1), entry(2, 2)))
    }

    /// One pass over the listed blocks. Not inlined: next to each other the two kinds of
    /// sweep get slower code.
    #[inline(never)]
    fn sweep<const GAIN: bool>(
        &self,
        dof_lists: &[usize],
        rows: &mut Rows<R>,
        list: &[usize],
        live: R::Mask,
        report: &mut Report<R>,
    ) -> Swept<R> {
        let Rows { rows, blocks, y, u, .. } = rows;
        let (mut largest, mut gain) = (R::zero(), R::zero());
        for at in list {
            let block = &blocks[*at];
            let mask = block.mask.and(live);
            if mask.none() {
                continue;
            }
            let own = block.rows.range();
            report.updates =
                R::select(mask, report.updates + R::of(own.len() as f64), report.updates);
            let mut sweep = Sweep::<R, GAIN> { dof_lists, y, z: &self.z, u, mask, gain };
            let weight = &self.weight[own.clone()];
            let own = &mut rows[own];
            match &self.cones[*at] {
                Cone::None => {
                    for (row, weight) in own.iter_mut().zip(weight) {
                        let change = sweep.interval(row);
                        largest = largest.max(change.abs() * *weight);
                    }
                }
                Cone::Convex(cone) => {
                    let change = sweep.convex(own, cone);
                    for (change, weight) in change.iter().zip(weight) {
                        largest = largest.max(change.abs() * *weight);
                    }
                }
                Cone::Coulomb(tangents) => {
                    let change = sweep.coulomb(own, block, tangents);
                    for (change, weight) in change.iter().zip(weight) {
                        largest = largest.max(change.abs() * *weight);
                    }
                }
            }
            gain = sweep.gain;
        }
        Swept { change: largest, gain }
    }
}

/// What a sweep did.
struct Swept<R> {
    /// The largest change of an impulse [m/s].
    change: R,
    /// With GAIN: the change of what convex rows minimise (see `momentum.rs`).
    gain: R,
}

/// Lanes that go on after a sweep with this largest change [m/s].
fn judge<R: Real>(
    dof_lists: &[usize],
    rows: &Rows<R>,
    blocks: &[usize],
    live: R::Mask,
    change: R,
    tolerance: R,
) -> R::Mask {
    let close = live.and(change.le(tolerance)).and(R::zero().lt(tolerance));
    if close.none() {
        return live;
    }
    let residual = rows.residual_of(dof_lists, blocks);
    live.and(close.and(residual.le(tolerance)).not())
}

/// Lanes in which an island has some block.
pub(super) fn alive<R: Real>(rows: &Rows<R>, blocks: &[usize]) -> R::Mask {
    blocks.iter().fold(R::Mask::of(false), |mask, b| mask.or(rows.blocks[*b].mask))
}

/// What one block's update reads and writes.
struct Sweep<'a, R: Real, const GAIN: bool> {
    dof_lists: &'a [usize],
    y: &'a [R],
    z: &'a [R],
    u: &'a mut [R],
    mask: R::Mask,
    gain: R,
}

impl<R: Real, const GAIN: bool> Sweep<'_, R, GAIN> {
    /// t − Jv − cλ.
    #[inline(always)]
    fn short(&self, row: &Row<R>) -> R {
        let dofs = row.dofs.of(self.dof_lists);
        row.t - dot(dofs, &self.y[row.y..row.y + dofs.len()], self.u) - row.c * row.impulse
    }

    /// Gives a row a new impulse, and u its effect; the change.
    #[inline(always)]
    fn set(&mut self, row: &mut Row<R>, impulse: R) -> R {
        let change = R::select(self.mask, impulse - row.impulse, R::zero());
        row.impulse = R::select(self.mask, impulse, row.impulse);
        let dofs = row.dofs.of(self.dof_lists);
        for (k, z) in dofs.iter().zip(&self.z[row.y..row.y + dofs.len()]) {
            let new = self.u[*k] + *z * change;
            self.u[*k] = R::select(self.mask, new, self.u[*k]);
        }
        change
    }

    #[inline(always)]
    fn interval(&mut self, row: &mut Row<R>) -> R {
        let short = self.short(row);
        let impulse = (row.impulse + short * row.inv_s).clamp(row.lo, row.hi);
        let change = self.set(row, impulse);
        if GAIN {
            let gain = self.gain + change * (R::of(0.5) * (row.a + row.c) * change - short);
            self.gain = R::select(self.mask, gain, self.gain);
        }
        change
    }

    fn convex(&mut self, own: &mut [Row<R>], cone: &Convex<R>) -> [R; 3] {
        let q = &cone.q;
        let (mut w, mut impulse) = ([R::zero(); 3], [R::zero(); 3]);
        for (i, row) in own.iter().enumerate().take(3) {
            w[i] = -self.short(row);
            impulse[i] = row.impulse;
        }
        // The gradient at zero impulse of this block: w − Qλ.
        let full = [[q[0], q[1], q[3]], [q[1], q[2], q[4]], [q[3], q[4], q[5]]];
        let mut b = w;
        for (b, q) in b.iter_mut().zip(&full) {
            *b -= q[0] * impulse[0] + q[1] * impulse[1] + q[2] * impulse[2];
        }
        let solution = cone.solve(b, self.mask);
        let mut change = [R::zero(); 3];
        for (i, row) in own.iter_mut().enumerate().take(3) {
            change[i] = self.set(row, solution[i]);
        }
        if GAIN {
            let mut gain = self.gain;
            for (i, q) in full.iter().enumerate() {
                let turn = q[0] * change[0] + q[1] * change[1] + q[2] * change[2];
                gain += change[i] * (w[i] + R::of(0.5) * turn);
            }
            self.gain = R::select(self.mask, gain, self.gain);
        }
        change
    }

    /// The normal as an interval, then the tangents within its friction bound.
    fn coulomb(&mut self, own: &mut [Row<R>], block: &Block<R>, plane: &Tangents<R>) -> [R; 3] {
        let q = &plane.q;
        let mut change = [R::zero(); 3];
        let Some((normal, tangents)) = own.split_first_mut() else { return change };
        let impulse = (normal.impulse + self.short(normal) * normal.inv_s).max(R::zero());
        change[0] = self.set(normal, impulse);
        let (mut g, mut x) = ([R::zero(); 2], [R::zero(); 2]);
        for (i, row) in tangents.iter().enumerate().take(2) {
            g[i] = -self.short(row);
            x[i] = row.impulse;
        }
        let g = [g[0] - (q[0] * x[0] + q[1] * x[1]), g[1] - (q[1] * x[0] + q[2] * x[1])];
        let bound = block.mu * normal.impulse;
        let x = match block.set {
            Set::CoulombBox => plane.square(g, bound),
            _ => plane.disc(g, bound, self.mask),
        };
        for (i, row) in tangents.iter_mut().enumerate().take(2) {
            change[i + 1] = self.set(row, x[i]);
        }
        change
    }
}
