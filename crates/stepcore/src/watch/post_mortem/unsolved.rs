//! Energy that rows added because they were not solved.
//!
//! A row whose velocity misses its law by w gives at most |λ|·|w| too much in a step. An element's
//! gain in a step, up to that, is the energy that its unsolved rows may have added: for a solved
//! row it is rounding, whatever the dt.

use std::collections::BTreeMap;

use super::budget::Budget;
use super::segment::Segment;
use crate::elements::Element;
use crate::observer::Observer;
use crate::real::{Mask, Real};
use crate::sim::{At, Sim};
use crate::watch::tape::taped;

/// A residual above this share of the present speeds means that the solve was stopped early.
const BROKEN_OFF: f64 = 1e-8;

/// The element whose rows violated their law most in the last solve, and by how much [m/s]; none if
/// they are solved.
pub(super) fn missed_most<R: Real>(sim: &Sim<R>, lane: usize) -> Option<(Element, f64)> {
    let lists = sim.detected.dof_lists(&sim.model);
    let blocks = sim.rows.blocks.iter().filter(|block| block.mask.lane(lane));
    let missed =
        blocks.map(|block| (block.element, sim.rows.block_residual(lists, block).lane(lane)));
    let (element, residual) = missed.max_by(|a, b| a.1.total_cmp(&b.1))?;
    let speeds = sim.rows.rows.iter().map(|row| row.velocity.lane(lane).abs());
    let most = speeds.fold(0.0, f64::max);
    (residual.is_finite() && residual > BROKEN_OFF * most).then_some((element, residual))
}

/// The element whose unsolved rows added most.
pub(super) struct Unsolved {
    pub element: Element,
    /// Energy added by these rows, and by all [J].
    pub added: f64,
    pub total: f64,
    /// The largest violation of its rows [m/s].
    pub residual: f64,
}

/// The energy that the rows of elements may have added in one step [J], and their violation [m/s].
struct Missed {
    lane: usize,
    most: BTreeMap<Element, [f64; 2]>,
}

impl<R: Real> Observer<R> for Missed {
    fn solved(&mut self, sim: &Sim<R>, _: At, share: f64) {
        let lists = sim.detected.dof_lists(&sim.model);
        for block in sim.rows.blocks.iter().filter(|block| block.mask.lane(self.lane)) {
            let rows = sim.rows.rows[block.rows.range()].iter();
            let errors = sim.row_residuals(block, self.lane);
            let given = rows.zip(errors).map(|(row, w)| row.impulse.lane(self.lane).abs() * w);
            let [most, residual] = self.most.entry(block.element.of_part()).or_default();
            *most += share * given.sum::<f64>();
            *residual = residual.max(sim.rows.block_residual(lists, block).lane(self.lane));
        }
    }
}

impl<R: Real> Segment<R> {
    /// Finds the rows that added energy because they were unsolved, as far as the budget allows.
    pub fn unsolved(&self, of: &Sim<R>, lane: usize, budget: &Budget) -> Option<Unsolved> {
        let mut sim = self.world(of)?;
        let mut sums: BTreeMap<Element, [f64; 2]> = BTreeMap::new();
        self.play(&mut sim, |sim| {
            let (effort, mut missed) = (sim.effort, Missed { lane, most: BTreeMap::new() });
            let gains = taped(sim, lane, |sim, tape| sim.step_watched(1, &mut (tape, &mut missed)));
            let gains = gains.ok()?.gains;
            for (element, [most, residual]) in missed.most {
                let gain = gains.get(&element).map_or(0.0, |gain| gain.max(0.0)).min(most);
                let [added, worst] = sums.entry(element).or_default();
                (*added, *worst) = (*added + gain, worst.max(residual));
            }
            budget.take(sim.work_since(&effort) + sim.tape()).then_some(())
        });
        let total = sums.values().map(|[added, _]| added).sum();
        let most = sums.into_iter().max_by(|a, b| a.1[0].total_cmp(&b.1[0]));
        let (element, [added, residual]) = most.filter(|(_, [added, _])| *added > 0.0)?;
        Some(Unsolved { element, added, total, residual })
    }
}
