//! The element that made a run leave the finite numbers: the first whose force, growing, became the
//! strongest of all on the way there; not the first that shows a NaN. Once a run explodes, inertial
//! forces outgrow the original cause, because they are quadratic.
//!
//! Forces and moments are compared by their effect: Q² / M, the rate at which a force Q speeds up
//! the inertia M that it acts on [W/s], whatever its unit.

use crate::elements::forces::strengths;
use crate::elements::{Element, Kind};
use crate::real::{Mask, Real};
use crate::sim::{At, Sim};
use crate::state::State;
use crate::watch::past::put_back;

/// An element that exceeds all of the step before by this factor is exploding, not moving.
const GROWN: f64 = 2.0;

/// Strength of every element in one lane.
type Strengths = Vec<(Element, f64)>;

/// The element that became the strongest on the way from old states to the present
/// one, or that is the strongest there. `sim` is a copy that may be moved about.
pub(super) fn strongest<R: Real>(
    mut sim: Sim<R>,
    past: &[&[R]],
    present: &State<R>,
    lane: usize,
) -> Option<Element> {
    let mut strengths: Vec<Strengths> = Vec::new();
    for kept in past.iter().map(Some).chain([None]) {
        match kept {
            Some(kept) => put_back(kept, lane, &mut sim.state),
            None => present.copy_to(&mut sim.state),
        }
        if sim.place_detect_solve(At::State).is_ok() {
            strengths.push(sim.strengths(lane));
        }
    }
    blamed(&strengths)
}

impl<R: Real> Sim<R> {
    /// Strength of each element at the state of the last solve.
    fn strengths(&self, lane: usize) -> Strengths {
        let model = &*self.model;
        let inertia = |k: usize| self.placed.mass[model.dofs[k].row.start].lane(lane);
        let mut entries = strengths(&self.moment(At::State), lane, &inertia);
        for (index, joint) in model.joints.iter().enumerate() {
            let bias = |k: usize| self.placed.bias[k].lane(lane).powi(2) / inertia(k);
            let strength = (joint.dof..joint.dof + joint.dofs()).map(bias).sum();
            entries.push((Element::whole(Kind::Inertia, index), strength));
        }
        let rate = 1.0 / self.clock.seconds;
        for block in self.rows.blocks.iter().filter(|block| block.mask.lane(lane)) {
            let rows = &self.rows.rows[block.rows.range()];
            let strength = rows
                .iter()
                .map(|row| (row.total().lane(lane) * rate).powi(2) * row.a.lane(lane))
                .sum();
            entries.push((block.element.of_part(), strength));
        }
        entries.retain(|(element, strength)| *strength != 0.0 && self.is_there(*element, lane));
        entries
    }

    /// Whether the inputs have such an element: absent inputs give no number where nothing acts.
    fn is_there(&self, element: Element, lane: usize) -> bool {
        let (model, index) = (&self.model, element.index as usize);
        let acts = |forces: &[R]| forces.iter().any(|force| force.lane(lane) != 0.0);
        match element.kind {
            Kind::JointForce => {
                let joint = &model.joints[index];
                acts(&self.inputs.qfrc_applied()[joint.dof..joint.dof + joint.dofs()])
            }
            Kind::BodyForce => acts(&self.inputs.xfrc_applied()[6 * index..6 * index + 6]),
            _ => true,
        }
    }
}

/// The first element whose strength at least doubled and exceeded all others together; else the
/// strongest at the end.
fn blamed(ledgers: &[Strengths]) -> Option<Element> {
    let finite = |ledger: &Strengths| ledger.iter().map(|(_, s)| s).filter(|s| s.is_finite()).sum();
    for pair in ledgers.windows(2) {
        // Next to an element that is not finite, no other is strong.
        if let Some((element, _)) = pair[0].iter().find(|(_, s)| !s.is_finite()) {
            return Some(*element);
        }
        let total: f64 = finite(&pair[1]);
        for (element, strength) in &pair[1] {
            let before =
                pair[0].iter().find(|(other, _)| other == element).map_or(0.0, |(_, s)| *s);
            let grown = *strength > 2.0 * before && *strength > GROWN * finite(&pair[0]);
            if grown && (*strength > 0.5 * total || !strength.is_finite()) {
                return Some(*element);
            }
        }
    }
    // A strength that is NaN exceeds all numbers, whatever its sign.
    let rank = |entry: &(Element, f64)| if entry.1.is_nan() { f64::INFINITY } else { entry.1 };
    let strongest = |a: &&(Element, f64), b: &&(Element, f64)| rank(a).total_cmp(&rank(b));
    let last = ledgers.last().and_then(|ledger| ledger.iter().rev().max_by(strongest));
    last.map(|(element, _)| *element)
}
