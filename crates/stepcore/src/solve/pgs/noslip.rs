//! Noslip: friction solved again without a regulariser, after the main solve.
//!
//! MuJoCo's post-processing (documentation, "Algorithms", NoSlip): sweeps over the friction rows
//! alone with c = 0, while load-bearing rows keep their impulses. A cone keeps its normal impulse
//! and has friction within μ times that; each pair of opposite edges of a pyramid keeps its sum; a
//! friction loss keeps its bounds. The result solves no single problem, and normals respond to the
//! changed friction only in the next step.

use super::super::cone::Matrix;
use super::super::dot::dot;
use super::super::rows::{Row, Rows, Set, CONE, NARROW};
use super::super::solver::Unconstrained;
use super::cones::{Cones, Narrow, Tie, Wide};
use super::point::{gain, gain_in_cone};
use crate::elements::Role;
use crate::interrupt::{Meter, ROW};
use crate::real::{Mask, Real};

/// The quantities that friction rows keep constant.
#[derive(Clone, Copy)]
enum Friction {
    /// Every row by itself.
    Loss,
    /// Rows 2k and 2k + 1 are opposite edges; rows left over are no friction.
    Edges,
    /// Row 0 is the normal.
    Cone(Tie),
    /// A cone with more ways than two tangents.
    Wide(Tie),
}

/// Data of the sweeps in addition to the rows, computed once per solve.
pub(crate) struct Noslip<R: Real> {
    /// The blocks with friction.
    list: Vec<(usize, Friction)>,
    cones: Narrow<R>,
    wide: Wide<R>,
    /// Per island: lanes in which sweeps continue, and the decrease of the objective in a sweep.
    todo: Vec<R::Mask>,
    gain: Vec<R>,
}

room!(Noslip<R>: list, cones, wide, todo, gain);

impl<R: Real> Noslip<R> {
    pub fn new() -> Self {
        let (cones, wide) = (Cones::new(), Cones::new());
        Self { list: Vec::new(), cones, wide, todo: Vec::new(), gain: Vec::new() }
    }

    /// Sweep over the friction rows, from the current impulses; `rows.u` must hold their effect,
    /// and does so again afterwards. The main solve's impulses are stored for the next start.
    ///
    /// An island stops after a sweep that gains less than `cost` times `Rows::inertia`; the
    /// regulariser's part of the objective counts toward the first sweep, as in MuJoCo.
    pub fn solve(&mut self, free: Unconstrained<R>, rows: &mut Rows<R>, sweeps: u32, cost: f64) {
        rows.main.clear();
        rows.main.extend(rows.rows.iter().map(|row| row.impulse));
        self.prepare(free, rows);
        let Self { list, cones, wide, todo, gain } = self;
        let Rows { rows, blocks, y, u, inertia, .. } = rows;
        let (mut meter, work) = (Meter::default(), ROW * list.len().max(1));
        for _ in 0..sweeps {
            meter.count(work);
            for (at, friction) in list.iter() {
                let block = &blocks[*at];
                let mask = block.mask.and(todo[block.island]);
                if mask.none() {
                    continue;
                }
                let mut hard = Hard { free, y, u, mask, gain: &mut gain[block.island] };
                let own = &mut rows[block.rows.range()];
                match *friction {
                    Friction::Loss => own.iter_mut().for_each(|row| hard.loss(row)),
                    Friction::Edges => {
                        for pair in own.chunks_exact_mut(2) {
                            let [one, other] = pair else { continue };
                            hard.edges(one, other);
                        }
                    }
                    Friction::Cone(tie) => hard.cone(own, block.mu, tie, cones),
                    Friction::Wide(tie) => hard.cone(own, block.mu, tie, wide),
                }
            }
            if cost > 0.0 {
                for ((todo, gain), inertia) in todo.iter_mut().zip(&mut *gain).zip(&*inertia) {
                    *todo = todo.and((*gain + R::of(cost) * *inertia).gt(R::zero()).not());
                    *gain = R::zero();
                }
            }
        }
    }

    fn prepare(&mut self, free: Unconstrained<R>, rows: &Rows<R>) {
        let Self { list, cones, wide, todo, gain } = self;
        list.clear();
        cones.clear();
        wide.clear();
        let islands = rows.blocks.iter().map(|block| block.island + 1).max().unwrap_or(0);
        todo.clear();
        todo.resize(islands, R::Mask::of(true));
        gain.clear();
        gain.resize(islands, R::zero());
        for (at, block) in rows.blocks.iter().enumerate().filter(|(_, block)| block.mask.any()) {
            let own = &rows.rows[block.rows.range()];
            let gain = &mut gain[block.island];
            for row in own {
                let regularised = R::of(0.5) * row.c * row.impulse * row.impulse;
                *gain = R::select(block.mask, *gain - regularised, *gain);
            }
            let (set, mu) = (Set::CoulombRound, block.mu);
            let friction = match (block.set, block.role) {
                (Set::Convex, _) if own.len() > NARROW => {
                    Friction::Wide(wide.tie(set, mu, products::<R, CONE>(free, &rows.y, own)))
                }
                (Set::Convex, _) => {
                    Friction::Cone(cones.tie(set, mu, products(free, &rows.y, own)))
                }
                (Set::Interval, Role::Loss) => Friction::Loss,
                (Set::Interval, Role::Contact) if own.len() > 1 => Friction::Edges,
                _ => continue,
            };
            list.push((at, friction));
        }
    }
}

/// Returns A between the ways of a cone; zero for the normal.
fn products<R: Real, const N: usize>(
    free: Unconstrained<R>,
    y: &[R],
    own: &[Row<R>],
) -> Matrix<R, N> {
    let mut q = [[R::zero(); N]; N];
    for (i, row) in own.iter().enumerate().skip(1) {
        for (j, other) in own[..=i].iter().enumerate().skip(1) {
            q[i][j] = between(free, y, row, other);
            q[j][i] = q[i][j];
        }
    }
    q
}

/// Returns J H⁻¹ Jᵀ between two rows of one block.
fn between<R: Real>(free: Unconstrained<R>, y: &[R], one: &Row<R>, other: &Row<R>) -> R {
    let dofs = one.dofs.of(free.dof_lists);
    let both = y[one.y..][..dofs.len()].iter().zip(&y[other.y..]);
    dofs.iter().zip(both).fold(R::zero(), |sum, (k, (p, q))| sum + *p * free.inv_d[*k] * *q)
}

/// The data that an update reads and writes.
struct Hard<'a, R: Real> {
    free: Unconstrained<'a, R>,
    y: &'a [R],
    u: &'a mut [R],
    mask: R::Mask,
    gain: &'a mut R,
}

impl<R: Real> Hard<'_, R> {
    /// Returns J v − t.
    fn miss(&self, row: &Row<R>) -> R {
        let dofs = row.dofs.of(self.free.dof_lists);
        dot(dofs, &self.y[row.y..row.y + dofs.len()], self.u) - row.t
    }

    /// Sets a row's impulse, and updates u; returns the change.
    fn set(&mut self, row: &mut Row<R>, impulse: R) -> R {
        let change = impulse - row.impulse;
        row.impulse = R::select(self.mask, impulse, row.impulse);
        let dofs = row.dofs.of(self.free.dof_lists);
        let y = &self.y[row.y..row.y + dofs.len()];
        Rows::kick(self.u, self.free.inv_d, dofs, y, change, self.mask);
        change
    }

    fn note(&mut self, gain: R) {
        *self.gain = R::select(self.mask, *self.gain + gain, *self.gain);
    }

    fn loss(&mut self, row: &mut Row<R>) {
        let miss = self.miss(row);
        let impulse = row.impulse - miss * row.a.recip_or_zero();
        let change = self.set(row, impulse.clamp(row.lo, row.hi));
        self.note(gain(row.a, change, -miss));
    }

    /// The sum of both edges is load, and stays; an edge that nothing opposes is half of it.
    fn edges(&mut self, one: &mut Row<R>, other: &mut Row<R>) {
        // Unfolded: the first is a tangent by itself, the second its load (`elements/contact.rs`).
        let alone = one.lo.lt(R::zero());
        let between = between(self.free, self.y, one, other);
        let bend = R::select(alone, one.a, one.a + other.a - (between + between));
        let miss = self.miss(one);
        let slope = R::select(alone, miss, miss - self.miss(other));
        let sum = one.impulse + other.impulse;
        let tangent = one.impulse - slope * bend.recip_or_zero();
        let still = bend.le(R::zero());
        let half = R::of(0.5) * sum;
        let first = R::select(still, half, tangent.clamp(R::zero(), sum));
        let second = R::select(alone, other.impulse, sum - first);
        let change = self.set(one, R::select(alone, tangent, first));
        self.set(other, second);
        self.note(gain(bend, change, -slope));
    }

    /// Minimises ½ xᵀA x + g·x with |x| ≤ μ λ_n.
    fn cone<const N: usize, const W: usize>(
        &mut self,
        own: &mut [Row<R>],
        mu: R,
        tie: Tie,
        cones: &mut Cones<R, N, W>,
    ) {
        let Some((normal, ways)) = own.split_first_mut() else { return };
        let (mut slope, mut x) = ([R::zero(); W], [R::zero(); W]);
        for (i, row) in ways.iter().enumerate() {
            (slope[i], x[i]) = (self.miss(row), row.impulse);
        }
        let solved = cones.friction(tie, slope, &x, mu * normal.impulse, self.mask);
        let mut change = [R::zero(); W];
        for (i, row) in ways.iter_mut().enumerate() {
            change[i] = self.set(row, solved[i]);
        }
        let curved = cones.curved(tie, &change);
        self.note(gain_in_cone(R::zero(), &change, &slope, &curved));
    }
}
