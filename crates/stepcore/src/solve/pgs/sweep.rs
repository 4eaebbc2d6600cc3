//! One pass over blocks: each gets its own solution while all others hold theirs.

use super::super::dot::dot;
use super::super::exact::{Convex, Tangents};
use super::super::free::{moves, Free};
use super::super::rows::{Block, Row, Rows, Set, CONE, NARROW};
use super::super::wide::Wide;
use crate::real::{Mask, Real};
use crate::room::room;

/// What a cone's exact solution needs, made once a solve.
enum Cone<R: Real> {
    /// Solved row by row.
    None,
    /// The four edges of a pyramid between free bodies of a heap.
    Edges(Edges<R>),
    Convex(Convex<R>),
    Coulomb(Tangents<R>),
    /// More ways than two tangents: its place in `Sweeps::wide`.
    Wide(usize),
}

/// Rows in a pyramid.
const EDGES: usize = 4;

/// Four interval rows on the same free bodies.
struct Edges<R> {
    free: Free,
    /// y D⁻¹ yᵀ below the diagonal: how much each row moves the later ones.
    beside: [[R; EDGES]; EDGES],
}

/// What sweeps need of the rows at hand, beside them.
pub(in super::super) struct Sweeps<R: Real> {
    /// D⁻¹ y, in the layout of `Rows::y`.
    pub z: Vec<R>,
    /// √(A/m) by row: makes an impulse a speed.
    pub weight: Vec<R>,
    /// By block.
    cones: Vec<Cone<R>>,
    wide: Vec<Wide<R>>,
}

room!(Sweeps<R>: z, weight, cones, wide;);

impl<R: Real> Sweeps<R> {
    pub fn new() -> Self {
        Self { z: Vec::new(), weight: Vec::new(), cones: Vec::new(), wide: Vec::new() }
    }

    /// For these rows; `weigh`: changes will be judged.
    pub fn prepare(&mut self, dof_lists: &[usize], inv_d: &[R], rows: &Rows<R>, weigh: bool) {
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
        self.wide.clear();
        for block in &rows.blocks {
            if weigh {
                let per_mass = R::of(1.0 / block.mass);
                for at in block.rows.range() {
                    self.weight[at] = (rows.rows[at].a * per_mass).sqrt();
                }
            }
            let cone = self.cone(dof_lists, rows, block);
            self.cones.push(cone);
        }
    }

    fn cone(&mut self, dof_lists: &[usize], rows: &Rows<R>, block: &Block<R>) -> Cone<R> {
        if block.set == Set::Interval {
            return self.edges(dof_lists, rows, block).map_or(Cone::None, Cone::Edges);
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
        if own.len() > NARROW {
            let convex = block.set == Set::Convex;
            let whole = |i: usize, j: usize| {
                // A normal is solved by itself under Coulomb's law.
                let apart = !convex && (i == 0 || j == 0);
                let missing = i == j && i >= own.len();
                match own.last() {
                    // Something positive, which meets zeros only.
                    Some(last) if missing && convex => last.a + last.c,
                    _ if apart => R::zero(),
                    _ => entry(i, j),
                }
            };
            let q = core::array::from_fn(|i| core::array::from_fn(|j| whole(i, j)));
            let wide = if convex { Wide::convex(q, block.mu) } else { Wide::coulomb(q, block.mu) };
            self.wide.push(wide);
            return Cone::Wide(self.wide.len() - 1);
        }
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

    fn edges(&self, dof_lists: &[usize], rows: &Rows<R>, block: &Block<R>) -> Option<Edges<R>> {
        let own = &rows.rows[block.rows.range()];
        if !rows.heap || own.len() != EDGES {
            return None;
        }
        let free = Free::of(own[0].dofs.of(dof_lists))?;
        let len = free.len();
        if own.iter().enumerate().any(|(at, row)| row.y != own[0].y + at * len) {
            return None;
        }
        let mut beside = [[R::zero(); EDGES]; EDGES];
        for i in 1..EDGES {
            for j in 0..i {
                let (y, z) = (&rows.y[own[i].y..][..len], &self.z[own[j].y..][..len]);
                beside[i][j] = y.iter().zip(z).fold(R::zero(), |sum, (y, z)| sum + *y * *z);
            }
        }
        Some(Edges { free, beside })
    }

    /// One pass over the listed blocks. Not inlined: next to each other the two kinds of
    /// sweep get slower code.
    #[inline(never)]
    pub fn sweep<const GAIN: bool>(
        &self,
        dof_lists: &[usize],
        rows: &mut Rows<R>,
        list: &[usize],
        live: R::Mask,
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
            let mut sweep = Update::<R, GAIN> { dof_lists, y, z: &self.z, u, mask, gain };
            let weight = &self.weight[own.clone()];
            let own = &mut rows[own];
            match &self.cones[*at] {
                Cone::None => {
                    for (row, weight) in own.iter_mut().zip(weight) {
                        let change = sweep.interval(row);
                        largest = largest.max(change.abs() * *weight);
                    }
                }
                Cone::Edges(edges) => {
                    let change = sweep.edges(own, edges);
                    for (change, weight) in change.iter().zip(weight) {
                        largest = largest.max(change.abs() * *weight);
                    }
                }
                Cone::Convex(cone) => {
                    let change = sweep.convex(own, cone);
                    for (change, weight) in change.iter().zip(weight) {
                        largest = largest.max(change.abs() * *weight);
                    }
                }
                Cone::Wide(at) => {
                    let cone = &self.wide[*at];
                    let change = if block.set == Set::Convex {
                        sweep.convex_wide(own, cone)
                    } else {
                        sweep.coulomb_wide(own, block, cone)
                    };
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
pub(in super::super) struct Swept<R> {
    /// The largest change of an impulse [m/s].
    pub change: R,
    /// With GAIN: the change of what convex rows minimise (see `momentum.rs`).
    pub gain: R,
}

/// What one block's update reads and writes.
struct Update<'a, R: Real, const GAIN: bool> {
    dof_lists: &'a [usize],
    y: &'a [R],
    z: &'a [R],
    u: &'a mut [R],
    mask: R::Mask,
    gain: R,
}

impl<R: Real, const GAIN: bool> Update<'_, R, GAIN> {
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

    /// Row by row as `interval`, but u is read once before and written once after: what the rows
    /// do to each other goes by `beside`.
    #[inline(always)]
    fn edges(&mut self, own: &mut [Row<R>], edges: &Edges<R>) -> [R; EDGES] {
        let mut change = [R::zero(); EDGES];
        let Some(own) = own.first_chunk_mut::<EDGES>() else { return change };
        let start = own[0].y;
        let velocity: [R; EDGES] = edges.free.dots(&self.y[start..], self.u);
        for i in 0..EDGES {
            let row = &mut own[i];
            let mut short = row.t - velocity[i] - row.c * row.impulse;
            for j in 0..i {
                short -= edges.beside[i][j] * change[j];
            }
            let impulse = (row.impulse + short * row.inv_s).clamp(row.lo, row.hi);
            change[i] = R::select(self.mask, impulse - row.impulse, R::zero());
            row.impulse = R::select(self.mask, impulse, row.impulse);
            if GAIN {
                let gain =
                    self.gain + change[i] * (R::of(0.5) * (row.a + row.c) * change[i] - short);
                self.gain = R::select(self.mask, gain, self.gain);
            }
        }
        let moved = moves(&change);
        if moved.any() {
            edges.free.kick(&self.z[start..], &change, self.u, moved);
        }
        change
    }

    fn convex(&mut self, own: &mut [Row<R>], cone: &Convex<R>) -> [R; NARROW] {
        let q = &cone.q;
        let (mut w, mut impulse) = ([R::zero(); NARROW], [R::zero(); NARROW]);
        for (i, row) in own.iter().enumerate() {
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
        let mut change = [R::zero(); NARROW];
        for (i, row) in own.iter_mut().enumerate() {
            change[i] = self.set(row, solution[i]);
        }
        if GAIN {
            let mut gain = self.gain;
            for (i, q) in full.iter().enumerate() {
                let bent = q[0] * change[0] + q[1] * change[1] + q[2] * change[2];
                gain += change[i] * (w[i] + R::of(0.5) * bent);
            }
            self.gain = R::select(self.mask, gain, self.gain);
        }
        change
    }

    /// The normal as an interval, then the tangents within its friction bound.
    fn coulomb(
        &mut self,
        own: &mut [Row<R>],
        block: &Block<R>,
        plane: &Tangents<R>,
    ) -> [R; NARROW] {
        let q = &plane.q;
        let mut change = [R::zero(); NARROW];
        let Some((normal, tangents)) = own.split_first_mut() else { return change };
        let impulse = (normal.impulse + self.short(normal) * normal.inv_s).max(R::zero());
        change[0] = self.set(normal, impulse);
        let (mut g, mut x) = ([R::zero(); 2], [R::zero(); 2]);
        for (i, row) in tangents.iter().enumerate() {
            g[i] = -self.short(row);
            x[i] = row.impulse;
        }
        let g = [g[0] - (q[0] * x[0] + q[1] * x[1]), g[1] - (q[1] * x[0] + q[2] * x[1])];
        let bound = block.mu * normal.impulse;
        let x = match block.set {
            Set::CoulombBox => plane.square(g, bound),
            _ => plane.disc(g, bound, self.mask),
        };
        for (i, row) in tangents.iter_mut().enumerate() {
            change[i + 1] = self.set(row, x[i]);
        }
        change
    }

    /// As `convex`, of all six rows.
    fn convex_wide(&mut self, own: &mut [Row<R>], cone: &Wide<R>) -> [R; CONE] {
        let (mut w, mut impulse) = ([R::zero(); CONE], [R::zero(); CONE]);
        for (i, row) in own.iter().enumerate() {
            w[i] = -self.short(row);
            impulse[i] = row.impulse;
        }
        let b = less(&w, cone, &impulse, 0);
        let solution = cone.solve(b, self.mask);
        let mut change = [R::zero(); CONE];
        for (i, row) in own.iter_mut().enumerate() {
            change[i] = self.set(row, solution[i]);
        }
        if GAIN {
            let half = change.map(|x| R::of(-0.5) * x);
            let slope = less(&w, cone, &half, 0);
            let gain = change.iter().zip(slope).fold(self.gain, |gain, (x, w)| gain + *x * w);
            self.gain = R::select(self.mask, gain, self.gain);
        }
        change
    }

    /// As `coulomb`, of all six rows.
    fn coulomb_wide(&mut self, own: &mut [Row<R>], block: &Block<R>, cone: &Wide<R>) -> [R; CONE] {
        let mut change = [R::zero(); CONE];
        let Some((normal, ways)) = own.split_first_mut() else { return change };
        let impulse = (normal.impulse + self.short(normal) * normal.inv_s).max(R::zero());
        change[0] = self.set(normal, impulse);
        let (mut w, mut x) = ([R::zero(); CONE], [R::zero(); CONE]);
        for (i, row) in ways.iter().enumerate() {
            w[i + 1] = -self.short(row);
            x[i + 1] = row.impulse;
        }
        let g = less(&w, cone, &x, 1);
        let bound = block.mu * normal.impulse;
        let x = match block.set {
            Set::CoulombBox => cone.square(&g, bound, &x, self.mask),
            _ => cone.ball(g, bound, self.mask),
        };
        for (i, row) in ways.iter_mut().enumerate() {
            change[i + 1] = self.set(row, x[i + 1]);
        }
        change
    }
}

/// w − Qλ: the gradient at zero impulse of the block.
fn less<R: Real>(w: &[R; CONE], cone: &Wide<R>, x: &[R; CONE], first: usize) -> [R; CONE] {
    core::array::from_fn(|i| {
        let terms = cone.q[i].iter().zip(x).skip(first);
        terms.fold(w[i], |w, (q, x)| w - *q * *x)
    })
}
