//! One pass over blocks: each is solved while all others keep their impulses.

use super::super::cone::{times, InCone, Matrix};
use super::super::rows::{Block, Row, Rows, Set, NARROW};
use super::cones::{Cones, Narrow, Tie, Wide};
use super::packed::{Packed, Target};
use super::point::{gain, gain_in_cone, Swept};
use super::side_by_side::{SideBySide, SEEN};
use crate::real::array::from_fn;
use crate::real::{Mask, Real};

/// The update method of a block, and its place among blocks with the same method.
#[derive(Clone, Copy)]
enum How {
    /// Row by row.
    Rows,
    /// A contact of a pile: see `packed.rs`.
    Packed(u32),
    Cone(Tie),
    /// A cone with more ways than two tangents.
    Wide(Tie),
}

/// Data of the sweeps in addition to the rows, computed once per solve.
pub(in super::super) struct Sweeps<R: Real> {
    /// D⁻¹ y of blocks that are not packed, in the layout of `Rows::y`.
    z: Vec<R>,
    /// √(A/m) by row: converts an impulse to a speed.
    pub weight: Vec<R>,
    /// Per block.
    how: Vec<How>,
    packed: Vec<Packed<R>>,
    side_by_side: SideBySide<R>,
    /// Whether the current island is in `side_by_side`.
    pub joined: bool,
    cones: Narrow<R>,
    wide: Wide<R>,
}

room!(Sweeps<R>: z, weight, how, packed, side_by_side, joined, cones, wide);

impl<R: Real> Sweeps<R> {
    pub fn new() -> Self {
        Self {
            z: Vec::new(),
            weight: Vec::new(),
            how: Vec::new(),
            packed: Vec::new(),
            side_by_side: SideBySide::new(),
            joined: false,
            cones: Cones::new(),
            wide: Cones::new(),
        }
    }

    /// Prepares for these rows; `weigh`: changes will be compared with a tolerance.
    pub fn prepare(&mut self, dof_lists: &[usize], inv_d: &[R], rows: &Rows<R>, weigh: bool) {
        self.z.resize(rows.y.len(), R::zero());
        self.weight.clear();
        self.weight.resize(rows.rows.len(), R::zero());
        self.how.clear();
        self.packed.clear();
        self.cones.clear();
        self.wide.clear();
        for block in &rows.blocks {
            let range = block.rows.range();
            let own = &rows.rows[range.clone()];
            let weight = &mut self.weight[range];
            if weigh {
                let per_mass = R::one() / block.mass;
                for (weight, row) in weight.iter_mut().zip(own) {
                    *weight = (row.a * per_mass).sqrt();
                }
            }
            let packed = Packed::of(dof_lists, inv_d, rows, block, weight, &mut self.cones);
            let how = if let Some(packed) = packed {
                self.packed.push(packed);
                How::Packed((self.packed.len() - 1) as u32)
            } else {
                self.scale(dof_lists, inv_d, &rows.y, own);
                self.cone(dof_lists, rows, block)
            };
            self.how.push(how);
        }
    }

    /// Computes z of some rows.
    fn scale(&mut self, dof_lists: &[usize], inv_d: &[R], y: &[R], rows: &[Row<R>]) {
        for row in rows {
            let dofs = row.dofs.of(dof_lists);
            let own = row.y..row.y + dofs.len();
            for ((z, y), k) in self.z[own.clone()].iter_mut().zip(&y[own]).zip(dofs) {
                *z = inv_d[*k] * *y;
            }
        }
    }

    /// Switch to an island whose blocks will be swept in this order, without the gain. The pyramids
    /// of a single world are put side by side if enough bodies are separate and it is `allowed`.
    pub fn join(&mut self, inv_d: &[R], rows: &Rows<R>, list: &[usize], allowed: bool) {
        self.joined = false;
        if !R::ALONE {
            return;
        }
        let pyramid = |at: &usize| match self.how[*at] {
            How::Packed(place) => {
                let packed = &self.packed[place as usize];
                matches!(packed.tie, Tie::Bounds).then_some(packed)
            }
            _ => None,
        };
        let single = allowed && list.len() > SEEN;
        if !single || !list.iter().all(|at| pyramid(at).is_some()) {
            return;
        }
        let contacts = list.iter().filter_map(|at| {
            let packed = pyramid(at).filter(|packed| packed.mask.any())?;
            Some((rows.blocks[*at].rows.start as u32, packed))
        });
        self.joined = self.side_by_side.take(inv_d, &rows.u, contacts);
    }

    /// Measures the gain of contacts side by side; `on`: they are swept with momentum.
    pub fn measure(&mut self, inv_d: &[R], on: bool) {
        if R::ALONE && self.joined {
            self.side_by_side.measure(inv_d, on);
        }
    }

    /// Starts the next sweep at momentum's point, if contacts side by side have momentum.
    pub fn go_on(&mut self) {
        if R::ALONE && self.joined {
            self.side_by_side.go_on();
        }
    }

    /// Writes the impulses of packed blocks to the rows, and updates u from contacts side by side.
    pub fn store(&self, rows: &mut Rows<R>, list: &[usize]) {
        if R::ALONE && self.joined {
            return self.side_by_side.store(rows);
        }
        for at in list {
            if let How::Packed(place) = self.how[*at] {
                let own = rows.blocks[*at].rows.range();
                self.packed[place as usize].store(&mut rows.rows[own]);
            }
        }
    }

    fn cone(&mut self, dof_lists: &[usize], rows: &Rows<R>, block: &Block<R>) -> How {
        if block.set == Set::Interval {
            return How::Rows;
        }
        if block.rows.len > NARROW {
            let q = self.matrix(dof_lists, rows, block);
            return How::Wide(self.wide.tie(block.set, block.mu, q));
        }
        let q = self.matrix(dof_lists, rows, block);
        How::Cone(self.cones.tie(block.set, block.mu, q))
    }

    /// Returns y D⁻¹ yᵀ + C of a cone. A missing way is one that nothing moves.
    fn matrix<const N: usize>(
        &self,
        dof_lists: &[usize],
        rows: &Rows<R>,
        block: &Block<R>,
    ) -> Matrix<R, N> {
        let own = &rows.rows[block.rows.range()];
        // The rows of a cone share their dofs.
        let len = own.first().map_or(0, |row| row.dofs.of(dof_lists).len());
        let mut q = [[R::zero(); N]; N];
        for (i, p) in own.iter().enumerate() {
            for (j, r) in own[..i].iter().enumerate() {
                let (y, z) = (&rows.y[p.y..p.y + len], &self.z[r.y..r.y + len]);
                q[i][j] = y.iter().zip(z).fold(R::zero(), |sum, (y, z)| sum + *y * *z);
                q[j][i] = q[i][j];
            }
            q[i][i] = p.a + p.c;
        }
        if let (Set::Convex, Some(last)) = (block.set, own.last()) {
            // A missing way gets a positive entry, which meets zeros only.
            (own.len()..N).for_each(|i| q[i][i] = last.a + last.c);
        }
        q
    }

    /// Makes one pass over the listed blocks. Not inlined: next to each other the two kinds of sweep
    /// get slower code.
    #[inline(never)]
    pub fn sweep<const GAIN: bool>(
        &mut self,
        dof_lists: &[usize],
        inv_d: &[R],
        rows: &mut Rows<R>,
        list: &[usize],
        todo: R::Mask,
    ) -> Swept<R> {
        if R::ALONE && self.joined {
            return self.side_by_side.sweep();
        }
        let Rows { rows, blocks, y, u, .. } = rows;
        let (mut largest, mut gain) = (R::zero(), R::zero());
        for at in list {
            let how = self.how[*at];
            if let How::Packed(place) = how {
                let packed = &mut self.packed[place as usize];
                let mask = packed.mask.and(todo);
                if mask.none() {
                    continue;
                }
                let own = if GAIN { &mut rows[blocks[*at].rows.range()] } else { &mut [][..] };
                let mut to = Target { inv_d, u, mask };
                let done = packed.update::<GAIN>(own, &mut self.cones, &mut to);
                largest = largest.max(done.change);
                if GAIN {
                    gain = R::select(mask, gain + done.gain, gain);
                }
                continue;
            }
            let block = &blocks[*at];
            let mask = block.mask.and(todo);
            if mask.none() {
                continue;
            }
            let own = block.rows.range();
            let mut sweep = Update::<R, GAIN> { dof_lists, y, z: &self.z, u, mask, gain, largest };
            let weight = &self.weight[own.clone()];
            sweep.block(&mut rows[own], block, weight, how, &mut self.cones, &mut self.wide);
            (gain, largest) = (sweep.gain, sweep.largest);
        }
        Swept { change: largest, gain }
    }
}

/// The data that one block's update reads and writes.
struct Update<'a, R: Real, const GAIN: bool> {
    dof_lists: &'a [usize],
    y: &'a [R],
    z: &'a [R],
    u: &'a mut [R],
    mask: R::Mask,
    gain: R,
    largest: R,
}

impl<R: Real, const GAIN: bool> Update<'_, R, GAIN> {
    #[inline(always)]
    fn block(
        &mut self,
        own: &mut [Row<R>],
        block: &Block<R>,
        weight: &[R],
        how: How,
        cones: &mut Narrow<R>,
        wide: &mut Wide<R>,
    ) {
        match how {
            How::Rows | How::Packed(_) => {
                for (row, weight) in own.iter_mut().zip(weight) {
                    let change = self.interval(row);
                    self.note(&[change], &[*weight]);
                }
            }
            How::Cone(tie) => self.cone(own, block, weight, tie, cones),
            How::Wide(tie) => self.cone(own, block, weight, tie, wide),
        }
    }

    #[inline(always)]
    fn cone<const N: usize, const W: usize>(
        &mut self,
        own: &mut [Row<R>],
        block: &Block<R>,
        weight: &[R],
        tie: Tie,
        cones: &mut Cones<R, N, W>,
    ) {
        let change = match tie {
            Tie::Convex(at) => self.convex(own, &mut cones.convex[at as usize]),
            _ => self.coulomb(own, block.mu, tie, cones),
        };
        self.note(&change, weight);
    }

    #[inline(always)]
    fn note(&mut self, change: &[R], weight: &[R]) {
        for (change, weight) in change.iter().zip(weight) {
            self.largest = self.largest.max(change.abs() * *weight);
        }
    }

    #[inline(always)]
    fn short(&self, row: &Row<R>) -> R {
        row.short(self.dof_lists, self.y, self.u)
    }

    /// Sets a row's impulse, and updates u; returns the change.
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
        let change = self.set(row, row.updated(short));
        if GAIN {
            let gain = self.gain + gain(row.a + row.c, change, short);
            self.gain = R::select(self.mask, gain, self.gain);
        }
        change
    }

    /// Solves the block's minimum in one piece.
    fn convex<const N: usize>(&mut self, own: &mut [Row<R>], cone: &mut InCone<R, N>) -> [R; N] {
        let (mut w, mut impulse) = ([R::zero(); N], [R::zero(); N]);
        for (i, row) in own.iter().enumerate() {
            w[i] = -self.short(row);
            impulse[i] = row.impulse;
        }
        // The gradient at zero impulse of this block: w − Qλ.
        let held = times(&cone.q, &impulse);
        let solution = cone.least(&from_fn(|i| w[i] - held[i]), self.mask);
        let mut change = [R::zero(); N];
        for (i, row) in own.iter_mut().enumerate() {
            change[i] = self.set(row, solution[i]);
        }
        if GAIN {
            let gain = gain_in_cone(self.gain, &change, &w, &times(&cone.q, &change));
            self.gain = R::select(self.mask, gain, self.gain);
        }
        change
    }

    /// Updates the normal as an interval, then the ways within its friction bound.
    fn coulomb<const N: usize, const W: usize>(
        &mut self,
        own: &mut [Row<R>],
        mu: R,
        tie: Tie,
        cones: &mut Cones<R, N, W>,
    ) -> [R; N] {
        let mut change = [R::zero(); N];
        let Some((normal, ways)) = own.split_first_mut() else { return change };
        let impulse = (normal.impulse + self.short(normal) * normal.inv_s).max(R::zero());
        change[0] = self.set(normal, impulse);
        let (mut slope, mut x) = ([R::zero(); W], [R::zero(); W]);
        for (i, row) in ways.iter().enumerate() {
            slope[i] = -self.short(row);
            x[i] = row.impulse;
        }
        let x = cones.friction(tie, slope, &x, mu * normal.impulse, self.mask);
        for (i, row) in ways.iter_mut().enumerate() {
            change[i + 1] = self.set(row, x[i]);
        }
        change
    }
}
