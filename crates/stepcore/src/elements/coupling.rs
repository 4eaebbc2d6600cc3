//! Joint and tendon equality: L₁ − L₁⁰ stays p(L₂ − L₂⁰), p a polynomial; a constant for one joint or
//! tendon alone. One row, J = J₁ − p′ J₂. J̇ v includes the curvature of p, but not of the path of a
//! spatial tendon.

use super::equality::Held;
use crate::model::transmission::Pulls;
use crate::model::transmission::Transmission;
use crate::model::{Coupling, Model};
use crate::real::{Constant, Real, Value};
use crate::settings::Law;
use crate::solve::{Rows, Situation};

/// A polynomial with its first two derivatives.
struct Poly<R: Real> {
    value: R,
    slope: R,
    bend: R,
}

/// By Horner's rule.
fn poly<R: Real>(coefficients: &[R::Value; 5], x: R) -> Poly<R> {
    let zero = R::zero();
    let mut at = Poly { value: zero, slope: zero, bend: zero };
    for c in coefficients.iter().rev() {
        at.bend = at.bend * x + at.slope + at.slope;
        at.slope = at.slope * x + at.value;
        at.value = at.value * x + c.get();
    }
    at
}

impl<N: Constant> Coupling<N> {
    /// ∂L₁/∂L₂ where they agree.
    pub(crate) fn slope<R: Real<Value = N>>(
        &self,
        model: &Model<N>,
        qpos: &[R],
        pulls: Pulls<R>,
    ) -> R
    where
        N: Value<R>,
    {
        self.second.map_or(R::zero(), |second| {
            let gone = second.length(model, qpos, pulls) - self.rest[1].get();
            poly(&self.polycoef, gone).slope
        })
    }
}

impl<R: Real> Rows<R> {
    pub(super) fn coupled(&mut self, now: &Situation<R>, index: usize, tie: &Coupling<R::Value>) {
        let (model, dofs) = (now.model, now.model.equalities[index].dofs);
        let pulls = now.placed.frames().pulls;
        let gone =
            |of: Transmission, rest: &R::Value| of.length(model, now.qpos, pulls) - rest.get();
        self.clear_scratch(dofs.of(now.dof_lists));
        tie.first.arms(model, now.qpos, pulls, |dof, arm| self.scratch[dof] += arm);
        let mut gap = gone(tie.first, &tie.rest[0]);
        let mut curving = R::zero();
        if let Some(second) = tie.second {
            let Poly { value, slope, bend } = poly(&tie.polycoef, gone(second, &tie.rest[1]));
            second.arms(model, now.qpos, pulls, |dof, arm| self.scratch[dof] -= slope * arm);
            gap -= value;
            let velocity = second.velocity(model, now.qpos, now.qvel, pulls);
            curving = -(bend * velocity * velocity);
        } else {
            gap -= tie.polycoef[0].get();
        }
        if now.settings.law == Law::SolRef {
            // MuJoCo's softness acts without J̇ v.
            curving = R::zero();
        }
        let first = self.rows.len();
        self.push_scratch(now, dofs).lo = R::of(f64::NEG_INFINITY);
        self.tie(now, index, first, gap, &[Held { gap, curving, invweight: tie.invweight.get() }]);
    }
}
