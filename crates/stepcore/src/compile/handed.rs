//! What code leaves to the stages between two parts of a step: what goes by single lanes, or needs a general
//! routine. Numbers are known, or stand for their places in the memory of code.

use std::sync::{Arc, Mutex};

use crate::real::traced::{Traced, TracedMask, HANDED};
use crate::real::Real;
use crate::solve::{Row, Rows};
use crate::spatial::Pose;

/// Work that was found while the step was written down, in order.
pub(crate) type HandedList = Arc<Mutex<Vec<Handed>>>;

pub(crate) enum Handed {
    Pairs(Box<HandedPairs>),
    Rows(Box<HandedRows>),
}

impl Handed {
    /// What was handed over begins at this place of the memory.
    pub fn begins_at(&mut self, first: u32) {
        match self {
            Self::Pairs(pairs) => pairs.begins_at(first),
            Self::Rows(rows) => rows.begins_at(first),
        }
    }
}

/// Pairs that are asked about: where they are near, and the poses of their geoms, each number by its place in
/// the memory of code.
#[derive(Default)]
pub(crate) struct HandedPairs {
    pub pairs: Vec<(usize, TracedMask)>,
    pub geoms: Vec<(usize, Pose<Traced>)>,
}

impl HandedPairs {
    /// What was handed over begins at this place.
    pub fn begins_at(&mut self, first: u32) {
        self.pairs.iter_mut().for_each(|(_, near)| near.begins_at(HANDED, first));
        for (_, pose) in &mut self.geoms {
            pose.pos.iter_mut().chain(pose.rot.iter_mut()).for_each(|x| x.begins_at(HANDED, first));
        }
    }
}

/// The system of a step, each of its numbers by the place where it is found.
pub(crate) struct HandedRows {
    pub rows: Rows<Traced>,
    pub dof_lists: Vec<usize>,
    pub inv_d: Vec<Traced>,
    pub guess: Vec<Traced>,
    /// What the solver leaves: u, and the impulses.
    pub u: Vec<u32>,
    pub impulses: Vec<u32>,
}

/// What a solver reads of a row.
pub(super) fn numbers<R: Real>(row: &mut Row<R>) -> [&mut R; 8] {
    let Row { t, c, a, inv_s, lo, hi, impulse, velocity, .. } = row;
    [t, c, a, inv_s, lo, hi, impulse, velocity]
}

impl HandedRows {
    /// What was handed over begins at this place of the memory.
    pub fn begins_at(&mut self, first: u32) {
        let number = |x: &mut Traced| x.begins_at(HANDED, first);
        let Self { rows, inv_d, guess, u, impulses, .. } = self;
        for block in &mut rows.blocks {
            block.mask.begins_at(HANDED, first);
            number(&mut block.mu);
            number(&mut block.mass);
        }
        rows.rows.iter_mut().flat_map(numbers).for_each(number);
        let lists = [&mut rows.y, &mut rows.u, &mut rows.inertia, inv_d, guess];
        lists.into_iter().flatten().for_each(number);
        u.iter_mut().chain(impulses).for_each(|place| *place = *place - HANDED + first);
    }
}
