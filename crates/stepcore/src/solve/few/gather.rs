//! The rows of few that lanes have, moved together.
//!
//! Worlds side by side touch with different rows, and of all rows that some lane has one lane has a
//! third or less. Its first row goes to the first slot, its second to the second: so there are as many
//! slots as the lane with the most rows has, and products, elimination and guesses, whose work grows
//! with their square and cube, do no work for rows of others. A lane's rows stay in their order, and
//! with it the order of every sum. Where that saves little, rows stay where they are: a slot each.

use super::super::dofs::distinct;
use super::super::dot::{dot, dots};
use super::super::rows::{Row, Rows};
use super::{Few, Island};
use crate::real::{Mask, Real, WIDEST};

/// Rows whose products are taken side by side.
const WIDE: usize = 4;
/// So many products of rows fewer pay for moving the rows: hopper and ant lie on either side.
const WORTH: usize = 100;

/// Which rows are gathered, and what of them is needed only here.
pub(super) struct Gathered<R: Real> {
    /// Rows that some lane has, and the lanes.
    rows: Vec<usize>,
    masks: Vec<R::Mask>,
    /// Their dofs, and by dof its place among these: see `distinct`.
    dofs: Vec<usize>,
    place: Vec<usize>,
    /// y by slot, then by place, if rows were moved.
    moved: bool,
    y: Vec<R>,
    /// D⁻¹ y of one slot, by dof.
    z: Vec<R>,
}

room!(Gathered<R>: rows, masks, dofs, place, moved, y, z);

impl<R: Real> Gathered<R> {
    pub fn new() -> Self {
        Self {
            rows: Vec::new(),
            masks: Vec::new(),
            dofs: Vec::new(),
            place: Vec::new(),
            moved: false,
            y: Vec::new(),
            z: Vec::new(),
        }
    }

    /// Lists the rows of some blocks in the lanes `mine`.
    fn list(&mut self, island: Island<R>, rows: &Rows<R>, mine: R::Mask) {
        self.rows.clear();
        self.masks.clear();
        for block in island.blocks.iter().map(|b| &rows.blocks[*b]) {
            let mask = block.mask.and(mine);
            if mask.any() {
                self.rows.extend(block.rows.range());
                self.masks.extend(block.rows.range().map(|_| mask));
            }
        }
    }

    /// How many of them each lane has, if it is worth while to move them.
    fn worth_moving(&self) -> Option<[usize; WIDEST]> {
        let all = self.rows.len();
        if R::ALONE || all * all < WORTH {
            return None;
        }
        let mut counts = [0; WIDEST];
        each_slot(&self.masks, |_, lane, slot| counts[lane] = slot + 1);
        let most = counts.into_iter().max().unwrap_or(0);
        (all * all >= most * most + WORTH).then_some(counts)
    }

    /// Finds the dofs of these rows.
    fn find_dofs(&mut self, dof_lists: &[usize], rows: &Rows<R>) {
        let lists = self.rows.iter().map(|r| rows.rows[*r].dofs.of(dof_lists));
        distinct(lists, rows.u.len(), &mut self.dofs, &mut self.place);
    }
}

/// Calls `each(row, lane, slot)` for every row of every lane.
#[inline(always)]
fn each_slot<M: Mask>(masks: &[M], mut each: impl FnMut(usize, usize, usize)) {
    let mut next = [0; WIDEST];
    for (i, mask) in masks.iter().enumerate() {
        for (lane, slot) in next[..M::LANES].iter_mut().enumerate() {
            if mask.lane(lane) {
                each(i, lane, *slot);
                *slot += 1;
            }
        }
    }
}

impl<R: Real> Few<R> {
    /// A, b and the impulses to start from.
    pub(super) fn take(&mut self, island: Island<R>, rows: &Rows<R>, mine: R::Mask) {
        self.gathered.list(island, rows, mine);
        let counts = self.gathered.worth_moving();
        let own = self.gathered.rows.len();
        let n = counts.map_or(own, |counts| counts.into_iter().max().unwrap_or(0));
        self.make_room(n);
        self.masks.clear();
        match counts {
            None => self.masks.extend_from_slice(&self.gathered.masks),
            Some(counts) => {
                let mask = |slot| R::Mask::from_lanes(|lane| slot < counts[lane]);
                self.masks.extend((0..n).map(mask));
            }
        }
        self.gathered.moved = counts.is_some();
        self.gathered.z.resize(island.inv_d.len(), R::zero());
        let Island { dof_lists, guess, .. } = island;
        let b = |row: &Row<R>| {
            let own = row.dofs.of(dof_lists);
            row.t - dot(own, &rows.y[row.y..row.y + own.len()], guess)
        };
        if counts.is_none() {
            for i in 0..n {
                let row = &rows.rows[self.gathered.rows[i]];
                (self.lo[i], self.hi[i], self.inv_s[i]) = (row.lo, row.hi, row.inv_s);
                (self.b[i], self.impulse[i]) =
                    (b(row), R::select(self.masks[i], row.impulse, R::zero()));
                self.products(island, rows, i);
                self.a[i * n + i] = row.a + row.c;
            }
            return;
        }
        self.gather(dof_lists, rows, b);
        for i in 0..n {
            self.gathered_products(island.inv_d, i);
        }
    }

    /// Lists for so many slots.
    fn make_room(&mut self, n: usize) {
        let zero = R::zero();
        for (list, len) in [
            (&mut self.lo, n),
            (&mut self.hi, n),
            (&mut self.inv_s, n),
            (&mut self.impulse, n),
            (&mut self.b, n),
            (&mut self.a, n * n),
            (&mut self.m, n * n),
            (&mut self.w, n),
            (&mut self.rest, n),
            (&mut self.inv, n),
            (&mut self.x, n),
            (&mut self.l, n),
        ] {
            list.resize(len, zero);
        }
        self.some.clear();
        self.some.reserve(n);
        for list in [&mut self.free, &mut self.high] {
            list.clear();
            list.resize(n, R::Mask::of(false));
        }
    }

    /// Rows of lanes into their slots; `b` of a row in all lanes.
    fn gather(&mut self, dof_lists: &[usize], rows: &Rows<R>, b: impl Fn(&Row<R>) -> R) {
        let n = self.b.len();
        self.gathered.find_dofs(dof_lists, rows);
        let Gathered { rows: list, masks, dofs, place, y, .. } = &mut self.gathered;
        y.clear();
        y.resize(n * dofs.len(), R::zero());
        // Lanes without a row in a slot.
        for list in [&mut self.lo, &mut self.hi, &mut self.inv_s, &mut self.impulse, &mut self.b] {
            list.fill(R::zero());
        }
        (0..n).for_each(|i| self.a[i * n + i] = R::zero());
        let (mut at, mut own_b) = (usize::MAX, R::zero());
        each_slot(masks, |i, lane, slot| {
            let row = &rows.rows[list[i]];
            if i != at {
                (at, own_b) = (i, b(row));
            }
            self.lo[slot].set_lane(lane, row.lo.lane(lane));
            self.hi[slot].set_lane(lane, row.hi.lane(lane));
            self.inv_s[slot].set_lane(lane, row.inv_s.lane(lane));
            self.impulse[slot].set_lane(lane, row.impulse.lane(lane));
            self.b[slot].set_lane(lane, own_b.lane(lane));
            self.a[slot * n + slot].set_lane(lane, (row.a + row.c).lane(lane));
            let to = &mut y[slot * dofs.len()..];
            for (k, y) in row.dofs.of(dof_lists).iter().zip(&rows.y[row.y..]) {
                to[place[*k]].set_lane(lane, y.lane(lane));
            }
        });
    }

    /// A of slot i and those before it, all on the dofs of the island.
    fn gathered_products(&mut self, inv_d: &[R], i: usize) {
        let (n, mut j) = (self.b.len(), 0);
        let Gathered { dofs, y, z, .. } = &mut self.gathered;
        let len = dofs.len();
        for (k, y) in dofs.iter().zip(&y[i * len..]) {
            z[*k] = inv_d[*k] * *y;
        }
        while j < i {
            let own = &y[j * len..];
            if j + WIDE <= i {
                let sums = dots::<R, WIDE>(dofs, own, z);
                self.a[i * n + j..i * n + j + WIDE].copy_from_slice(&sums);
                j += WIDE;
            } else {
                self.a[i * n + j] = dot(dofs, own, z);
                j += 1;
            }
        }
        self.mirror(i);
    }

    /// A of row i and the rows before it, where they stand.
    fn products(&mut self, island: Island<R>, rows: &Rows<R>, i: usize) {
        let Island { dof_lists, inv_d, .. } = island;
        let (n, mut j) = (self.b.len(), 0);
        let Gathered { rows: list, z, .. } = &mut self.gathered;
        let row = &rows.rows[list[i]];
        let own = row.dofs.of(dof_lists);
        for (k, y) in own.iter().zip(&rows.y[row.y..]) {
            z[*k] = inv_d[*k] * *y;
        }
        while j < i {
            let first = &rows.rows[list[j]];
            let dofs = first.dofs.of(dof_lists);
            let beside = |(at, r): (usize, &usize)| {
                let row = &rows.rows[*r];
                row.dofs == first.dofs && row.y == first.y + at * dofs.len()
            };
            let wide = j + WIDE <= i && list[j..j + WIDE].iter().enumerate().all(beside);
            if wide {
                let sums = dots::<R, WIDE>(dofs, &rows.y[first.y..], z);
                self.a[i * n + j..i * n + j + WIDE].copy_from_slice(&sums);
            } else {
                let y = &rows.y[first.y..first.y + dofs.len()];
                self.a[i * n + j] = dot(dofs, y, z);
            }
            j += if wide { WIDE } else { 1 };
        }
        for k in own {
            z[*k] = R::zero();
        }
        self.mirror(i);
    }

    /// A is symmetric.
    fn mirror(&mut self, i: usize) {
        let n = self.b.len();
        for j in 0..i {
            self.a[j * n + i] = self.a[i * n + j];
        }
    }

    /// Impulses within their bounds, and u = û + D⁻¹ Σ yλ.
    pub(super) fn give(&mut self, island: Island<R>, rows: &mut Rows<R>, mine: R::Mask) {
        let Island { dof_lists, inv_d, guess, .. } = island;
        let Rows { rows, y, u, .. } = rows;
        let Gathered { rows: list, masks, moved, .. } = &self.gathered;
        for r in list {
            for k in rows[*r].dofs.of(dof_lists) {
                u[*k] = R::select(mine, guess[*k], u[*k]);
            }
        }
        let mut next = [0; WIDEST];
        for (i, r) in list.iter().enumerate() {
            let row = &mut rows[*r];
            let mut impulse = row.impulse;
            if !moved {
                impulse = self.impulse[i];
            } else {
                for (lane, slot) in next[..R::LANES].iter_mut().enumerate() {
                    if masks[i].lane(lane) {
                        impulse.set_lane(lane, self.impulse[*slot].lane(lane));
                        *slot += 1;
                    }
                }
            }
            let mask = masks[i].and(mine);
            let impulse = impulse.clamp(row.lo, row.hi);
            row.impulse = R::select(mask, impulse, row.impulse);
            let dofs = row.dofs.of(dof_lists);
            Rows::kick(u, inv_d, dofs, &y[row.y..row.y + dofs.len()], row.impulse, mask);
        }
    }
}
