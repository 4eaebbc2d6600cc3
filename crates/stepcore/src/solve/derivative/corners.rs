//! Corners: rows at a bound of their impulse without pressing against it (λ at its bound and w = 0,
//! both to rounding). The next change may or may not activate such a row, so the solution has a
//! derivative to each side. Exception: rows whose requirement does not change at all, such as a row
//! that repeats others.

use super::super::cone::across;
use super::super::rows::{Block, Row, Rows, Set, CONE};
use crate::elements::Element;
use crate::real::{Dual, WAYS};

/// The rounding error of a number, in units in the last place of its terms.
const UNITS: f64 = 32.0;
/// The rounding error of a slope relative to its terms: solving for slopes loses more.
const NO_SLOPE: f64 = 1e-9;

/// A way in which a block may leave its corner: two combinations of its rows that are 0.
pub(super) struct Corner {
    pub element: Element,
    row: usize,
    /// Combinations of w and of λ; one of them stays 0, and which depends on the side.
    slack: [f64; CONE],
    push: [f64; CONE],
    /// The block's first row.
    pub block: usize,
    /// Whether other active rows hold what the block holds: its impulses are then arbitrary.
    pub repeats: bool,
}

/// Returns the corners at which this solution is.
pub(super) fn corners(
    rows: &Rows<f64>,
    dof_lists: &[usize],
    inv_d: &[f64],
    guess: &[f64],
) -> Vec<Corner> {
    let mut size: Vec<f64> = guess.iter().map(|guess| guess.abs()).collect();
    let blocks = || rows.blocks.iter().filter(|block| block.mask);
    for row in blocks().flat_map(|block| &rows.rows[block.rows.range()]) {
        for (k, y) in row.dofs.of(dof_lists).iter().zip(&rows.y[row.y..]) {
            size[*k] += inv_d[*k] * (y * row.impulse).abs();
        }
    }
    let rounding = |row: &Row<f64>| {
        let terms = row.dofs.of(dof_lists).iter().zip(&rows.y[row.y..]);
        let sum: f64 = terms.map(|(k, y)| y.abs() * size[*k]).sum();
        UNITS * f64::EPSILON * (sum + row.c * row.impulse.abs() + row.t.abs())
    };
    let mut found = Vec::new();
    for block in blocks() {
        let own = &rows.rows[block.rows.range()];
        let of = |row: &Row<f64>| (rows.slack(dof_lists, row), rounding(row));
        if block.set == Set::Interval {
            for (at, row) in block.rows.range().zip(own).filter(|(_, row)| row.a + row.c > 0.0) {
                let (w, rounding) = of(row);
                let near = (row.impulse - row.lo).min(row.hi - row.impulse);
                if row.lo < row.hi && w.abs() <= rounding && near <= rounding / (row.a + row.c) {
                    found.push(Corner::new(block, at, unit(0), unit(0)));
                }
            }
        } else {
            let mut add = |slack, push| {
                found.push(Corner::new(block, block.rows.start, slack, push));
            };
            of_cone(block, own, of, &mut add);
        }
    }
    found
}

fn of_cone(
    block: &Block<f64>,
    own: &[Row<f64>],
    of: impl Fn(&Row<f64>) -> (f64, f64),
    add: &mut impl FnMut([f64; CONE], [f64; CONE]),
) {
    let (mut w, mut nearly, mut close) = ([0.0; CONE], [0.0; CONE], [0.0; CONE]);
    let mut impulse = [0.0; CONE];
    for (i, row) in own.iter().enumerate() {
        (w[i], nearly[i]) = of(row);
        close[i] = if row.a + row.c > 0.0 { nearly[i] / (row.a + row.c) } else { 0.0 };
        impulse[i] = row.impulse;
    }
    let (mu, bound, convex) = (block.mu, block.mu * impulse[0], block.set == Set::Convex);
    let most = |x: &[f64; CONE]| x[1..].iter().copied().fold(0.0, f64::max);
    let (slip, slight) = (across(&w), most(&nearly));
    if impulse[0] <= close[0] {
        let tilt = if convex { mu } else { 0.0 };
        if w[0] - tilt * slip > nearly[0] + tilt * slight {
            return;
        }
        if slip > slight {
            let mut out = w.map(|w| -tilt * w / slip);
            out[0] = 1.0;
            add(out, unit(0));
        } else {
            let asked = if tilt > 0.0 { own.len() } else { 1 };
            (0..asked).for_each(|i| add(unit(i), unit(0)));
        }
        return;
    }
    if block.set == Set::CoulombBox {
        for i in 1..own.len() {
            let end = bound - close[i] - mu * close[0];
            if mu > 0.0 && impulse[i].abs() >= end && w[i].abs() <= nearly[i] {
                let mut push = unit(i);
                push[0] = -mu.copysign(impulse[i]);
                add(unit(i), push);
            }
        }
        return;
    }
    let length = across(&impulse);
    let end = bound - most(&close) - mu * close[0];
    if length > 0.0 && length >= end && slip <= slight {
        let mut e = impulse.map(|x| x / length);
        e[0] = 0.0;
        let mut push = e;
        push[0] = -mu;
        add(e, push);
    }
}

fn unit(i: usize) -> [f64; CONE] {
    crate::real::array::from_fn(|k| if k == i { 1.0 } else { 0.0 })
}

impl Corner {
    fn new(block: &Block<f64>, row: usize, slack: [f64; CONE], push: [f64; CONE]) -> Self {
        let (element, block) = (block.element, block.rows.start);
        Self { element, row, slack, push, block, repeats: false }
    }

    /// Returns whether the block leaves its corner along some direction of these slopes.
    pub fn leaves(&self, rows: &Rows<Dual>, dof_lists: &[usize], guess: &[Dual]) -> bool {
        (0..WAYS).any(|way| {
            let (mut slack, mut push, mut scale) = (0.0, 0.0, 0.0);
            let factors = self.slack.iter().zip(&self.push);
            for (row, (of_w, of_push)) in rows.rows[self.row..].iter().zip(factors) {
                let s = row.a.value + row.c.value;
                let of_push = if self.repeats { 0.0 } else { *of_push };
                let moved = of_push * s * row.impulse.slopes[way];
                push += moved;
                scale += moved.abs();
                if *of_w == 0.0 {
                    continue;
                }
                slack += of_w * rows.slack(dof_lists, row).slopes[way];
                let mut terms = row.t.slopes[way].abs();
                for (k, y) in row.dofs.of(dof_lists).iter().zip(&rows.y[row.y..]) {
                    let (u, guess) = (rows.u[*k], guess[*k]);
                    terms += y.value.abs() * (u.slopes[way].abs() + guess.slopes[way].abs());
                    terms += y.slopes[way].abs() * (u.value.abs() + guess.value.abs());
                }
                scale += of_w.abs() * terms;
            }
            slack.abs().max(push.abs()) > NO_SLOPE * scale
        })
    }
}
