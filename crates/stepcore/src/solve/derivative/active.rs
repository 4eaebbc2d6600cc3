//! Active rows to first order: the directions in which a block's impulses move.
//!
//! - An interval row strictly within its bounds moves by itself and keeps w = 0; at a bound
//!   it stays there.
//! - A cone without impulse stays so. Strictly inside, every row moves and keeps w = 0.
//! - On the surface λ = n (1, μe), |e| = 1. It moves out, along (1, μe), and round, along each
//!   (0, e⊥), where e turns by dθ and the impulse by dφ = μn·dθ. Round, e⊥·w_t = 0 is kept,
//!   and turning e changes that by −(e·w_t) dθ. Out, a convex cone keeps w_n + μ e·w_t = 0 and
//!   a Coulomb cone w_n = 0: friction follows the normal, whatever that does to the normal.
//! - A tangent of a box at its bound ±μn follows the normal, and one within keeps w = 0.

use super::super::cone::across;
use super::super::dot::dot;
use super::super::rows::{Block, Rows, Set, CONE};
use crate::real::{Dual, WAYS};

/// The tolerance for points on a cone's surface, in roundings.
const ON_SURFACE: f64 = 8.0;

/// Returns whether friction of this length is at its bound.
pub(super) fn on_surface(length: f64, bound: f64) -> bool {
    length >= bound * (1.0 - ON_SURFACE * f64::EPSILON)
}

const NORMAL: [f64; CONE] = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0];

/// A free direction of one block.
#[derive(Clone, Copy, Debug)]
pub(super) struct Direction {
    /// The first row that it moves, and the number of rows.
    row: usize,
    len: usize,
    /// dλ of the rows per unit of a, and the combination of their w that stays constant.
    pub push: [f64; CONE],
    test: [f64; CONE],
    /// The change of that combination when the surface turns.
    bend: f64,
    /// e·w_t: the change of that combination as the cone widens.
    wider: f64,
    /// A scale that makes the matrix's diagonal about 1.
    pub size: f64,
}

impl Direction {
    fn new(row: usize, len: usize, push: [f64; CONE], test: [f64; CONE]) -> Self {
        Self { row, len, push, test, bend: 0.0, wider: 0.0, size: 0.0 }
    }

    fn single(row: usize) -> Self {
        Self::new(row, 1, NORMAL, NORMAL)
    }

    pub fn rows(&self) -> std::ops::Range<usize> {
        self.row..self.row + self.len
    }

    /// Returns the slopes of the constant combination, at constant impulses.
    pub fn slack(&self, rows: &Rows<Dual>, dof_lists: &[usize]) -> [f64; WAYS] {
        let mut sum = [0.0; WAYS];
        for (at, test) in self.rows().zip(self.test) {
            let slack = rows.slack(dof_lists, &rows.rows[at]);
            for (sum, slope) in sum.iter_mut().zip(slack.slopes) {
                *sum += test * slope;
            }
        }
        if self.wider != 0.0 {
            let own = rows.blocks.iter().find(|block| block.rows.start == self.row);
            for (sum, slope) in sum.iter_mut().zip(own.map_or([0.0; WAYS], |own| own.mu.slopes)) {
                *sum += self.wider * slope;
            }
        }
        sum
    }
}

/// The ways perpendicular to e in a block of `len` rows: for two tangents, e turned by a quarter;
/// for more, the other columns of the reflection that takes e to an axis.
fn rounds(e: &[f64; CONE], len: usize) -> impl Iterator<Item = [f64; CONE]> {
    let large = (1..len).fold(1, |large, i| if e[i].abs() > e[large].abs() { i } else { large });
    let mut u = *e;
    u[0] = 0.0;
    u[large] += 1.0f64.copysign(e[large]);
    let per_size = 1.0 / (1.0 + e[large].abs());
    let quarter = [0.0, -e[2], e[1], 0.0, 0.0, 0.0];
    (1..len).filter(move |way| if len == 3 { *way == 1 } else { *way != large }).map(move |way| {
        if len == 3 {
            return quarter;
        }
        crate::real::array::from_fn(|i| f64::from(u8::from(i == way)) - u[way] * u[i] * per_size)
    })
}

/// Sᵀ(A + C)P + B, from rows that hold a solution.
pub(super) struct Matrix<'a> {
    rows: &'a Rows<f64>,
    dof_lists: &'a [usize],
    inv_d: &'a [f64],
    /// D⁻¹ Σ y x of one direction, by dof.
    spread: Vec<f64>,
}

impl<'a> Matrix<'a> {
    pub fn new(rows: &'a Rows<f64>, dof_lists: &'a [usize], inv_d: &'a [f64]) -> Self {
        Self { rows, dof_lists, inv_d, spread: vec![0.0; inv_d.len()] }
    }

    /// Returns the directions of these blocks in which something can move.
    pub fn directions<'b>(
        &mut self,
        blocks: impl Iterator<Item = &'b Block<f64>>,
    ) -> Vec<Direction> {
        let mut directions = Vec::new();
        for block in blocks {
            self.add(block, &mut directions);
        }
        directions.retain_mut(|direction| {
            let moved = self.energy(direction, &direction.push);
            let most = self.energy(direction, &direction.test).max(moved) + direction.bend;
            direction.size = if most > 0.0 { 1.0 / most.sqrt() } else { 0.0 };
            most > 0.0
        });
        directions
    }

    fn add(&self, block: &Block<f64>, out: &mut Vec<Direction>) {
        let range = block.rows.range();
        let own = &self.rows.rows[range.clone()];
        if block.set == Set::Interval {
            let free = own.iter().zip(range);
            let free = free.filter(|(row, _)| row.impulse > row.lo && row.impulse < row.hi);
            out.extend(free.map(|(_, at)| Direction::single(at)));
            return;
        }
        let mut impulse = [0.0; CONE];
        impulse.iter_mut().zip(own).for_each(|(impulse, row)| *impulse = row.impulse);
        let n = impulse[0];
        if n <= 0.0 {
            return;
        }
        let (mu, bound, normal) = (block.mu, block.mu * n, NORMAL);
        if block.set == Set::CoulombBox {
            let mut along = Direction::new(range.start, own.len(), normal, normal);
            for i in 1..own.len() {
                if impulse[i].abs() < bound {
                    out.push(Direction::single(range.start + i));
                } else {
                    along.push[i] = mu.copysign(impulse[i]);
                }
            }
            out.push(along);
            return;
        }
        let length = across(&impulse);
        if !on_surface(length, bound) {
            out.extend(range.map(Direction::single));
            return;
        }
        // The direction of friction; the first entry is not part of it.
        let mut e = impulse.map(|x| if length > 0.0 { x / length } else { 0.0 });
        if length <= 0.0 {
            e[1] = 1.0;
        }
        let mut along = e.map(|e| mu * e);
        along[0] = 1.0;
        let mut slack = 0.0;
        for (row, e) in own.iter().zip(e).skip(1) {
            slack += e * self.rows.slack(self.dof_lists, row);
        }
        let convex = block.set == Set::Convex;
        let (test, wider) = if convex { (along, slack) } else { (normal, 0.0) };
        out.push(Direction { wider, ..Direction::new(range.start, own.len(), along, test) });
        if own.len() < 3 || bound <= 0.0 {
            return;
        }
        let bend = (-slack).max(0.0) / bound;
        for round in rounds(&e, own.len()) {
            out.push(Direction { bend, ..Direction::new(range.start, own.len(), round, round) });
        }
    }

    /// xᵀ(A + C)x over a direction's rows.
    fn energy(&mut self, direction: &Direction, x: &[f64; CONE]) -> f64 {
        self.spread(direction, x);
        let energy = self.tested(direction, x) + self.softened(direction, x, x);
        self.clear(direction);
        energy
    }

    /// Returns the matrix, row by row, each direction scaled by its size.
    pub fn of(&mut self, directions: &[Direction]) -> Vec<f64> {
        let n = directions.len();
        let mut matrix = vec![0.0; n * n];
        for (j, direction) in directions.iter().enumerate() {
            self.spread(direction, &direction.push);
            for (i, other) in directions.iter().enumerate() {
                let mut entry = self.tested(other, &other.test);
                if other.row == direction.row {
                    entry += self.softened(direction, &other.test, &direction.push);
                }
                if i == j {
                    entry += direction.bend;
                }
                matrix[i * n + j] = entry * other.size * direction.size;
            }
            self.clear(direction);
        }
        matrix
    }

    /// Sets `spread` to D⁻¹ Σ y x.
    fn spread(&mut self, direction: &Direction, x: &[f64; CONE]) {
        for (row, x) in self.rows.rows[direction.rows()].iter().zip(x) {
            for (k, y) in row.dofs.of(self.dof_lists).iter().zip(&self.rows.y[row.y..]) {
                self.spread[*k] += self.inv_d[*k] * y * x;
            }
        }
    }

    fn clear(&mut self, direction: &Direction) {
        for row in &self.rows.rows[direction.rows()] {
            for k in row.dofs.of(self.dof_lists) {
                self.spread[*k] = 0.0;
            }
        }
    }

    /// Σ x y·spread.
    fn tested(&self, direction: &Direction, x: &[f64; CONE]) -> f64 {
        let own = self.rows.rows[direction.rows()].iter().zip(x);
        let own = own.filter(|(_, x)| **x != 0.0).map(|(row, x)| {
            x * dot(row.dofs.of(self.dof_lists), &self.rows.y[row.y..], &self.spread)
        });
        own.sum()
    }

    /// Σ test c push.
    fn softened(&self, direction: &Direction, test: &[f64; CONE], push: &[f64; CONE]) -> f64 {
        let own = self.rows.rows[direction.rows()].iter().zip(test).zip(push);
        own.map(|((row, test), push)| test * row.c * push).sum()
    }
}
