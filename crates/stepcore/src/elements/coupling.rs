//! Joint equality: q₁ − q₁⁰ stays p(q₂ − q₂⁰), p a polynomial; of one joint alone, a constant.
//! One row, J = (1, −p′).

use super::equality::Held;
use crate::model::Coupling;
use crate::real::Real;
use crate::settings::Law;
use crate::solve::{Rows, Situation};

/// A polynomial with its first two derivatives.
struct Poly<R: Real> {
    value: R,
    slope: R,
    bend: R,
}

/// By Horner's rule.
fn poly<R: Real>(coefficients: &[f64; 5], x: R) -> Poly<R> {
    let zero = R::zero();
    let mut at = Poly { value: zero, slope: zero, bend: zero };
    for c in coefficients.iter().rev() {
        at.bend = at.bend * x + at.slope + at.slope;
        at.slope = at.slope * x + at.value;
        at.value = at.value * x + R::of(*c);
    }
    at
}

impl<R: Real> Rows<R> {
    pub(super) fn joint_equality(&mut self, now: &Situation<R>, index: usize, tie: &Coupling) {
        let (model, dofs) = (now.model, now.model.equalities[index].dofs);
        let joint = |at: usize| &model.joints[at];
        let gone = |at: usize, rest: f64| now.qpos[joint(at).qpos] - R::of(rest);
        self.clear_scratch(dofs.of(now.dof_lists));
        self.scratch[joint(tie.first).dof] = R::one();
        let mut gap = gone(tie.first, tie.rest[0]);
        let mut curving = R::zero();
        if let Some(second) = tie.second {
            let Poly { value, slope, bend } = poly(&tie.polycoef, gone(second, tie.rest[1]));
            let dof = joint(second).dof;
            self.scratch[dof] = -slope;
            gap -= value;
            let velocity = now.qvel[dof];
            curving = -(bend * velocity * velocity);
        } else {
            gap -= R::of(tie.polycoef[0]);
        }
        if now.settings.law == Law::SolRef {
            // MuJoCo's softness acts without it.
            curving = R::zero();
        }
        let first = self.rows.len();
        self.push_scratch(now, dofs).lo = R::of(f64::NEG_INFINITY);
        self.tie(now, index, first, gap, &[Held { gap, curving, invweight: tie.invweight }]);
    }
}
