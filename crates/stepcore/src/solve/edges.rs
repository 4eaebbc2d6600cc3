//! The edges of a contact between free bodies, whose pyramid is made at once.
//!
//! Normal and tangents are lifted side by side, and each dof's entries of the four edges made of
//! them, so that no way of friction is stored. The numbers are those of `push_relative` and
//! `push_edges`, bit for bit.

use super::relative::{all_free, Side, SIX};
use super::rows::{Rows, Situation};
use super::suspect;
use crate::model::Pair;
use crate::real::{Mask, Real};
use crate::spatial::V3;

/// The normal and two tangents.
const WAYS: usize = 3;
/// Two a tangent.
const EDGES: usize = 4;

/// A J M⁻¹ Jᵀ and J v of some rows, as their dofs are summed.
struct Sums<R: Real> {
    ways: [R; WAYS],
    velocities: [R; WAYS],
    edges: [R; EDGES],
}

impl<R: Real> Rows<R> {
    /// Pushes the edges J_n ± μ J_t of how two bodies' points `at` slide, `along` the normal and two
    /// tangents. Pushes nothing and returns false where the bodies are not free, or where a way may
    /// be rounding that is to be dropped, which is looked at row by row.
    pub(crate) fn push_pyramid(
        &mut self,
        now: &Situation<R>,
        (bodies, pair): ([usize; 2], &Pair),
        at: &[V3<R>; 2],
        along: &[V3<R>; WAYS],
        mu: R,
    ) -> bool {
        let sides = [
            Side::of(now, bodies[0], &at[0], along.map(|d| -d)),
            Side::of(now, bodies[1], &at[1], *along),
        ];
        let list = pair.dofs.of(now.dof_lists);
        if !all_free(now.model, list, &sides) {
            return false;
        }
        let (start, len) = (self.y.len(), list.len());
        self.y.resize(start + EDGES * len, R::zero());
        let sums = edges(now, list, &sides, mu, &mut self.y[start..]);
        if sums.ways.iter().any(|a| suspect(*a, pair.mass).any()) {
            self.y.truncate(start);
            return false;
        }
        let [normal, tangents @ ..] = sums.velocities;
        for (k, a) in sums.edges.into_iter().enumerate() {
            let by = mu * tangents[k / 2];
            let velocity = if k % 2 == 0 { normal + by } else { normal - by };
            self.push_row(pair.dofs, start + k * len, a, velocity);
        }
        true
    }
}

/// y of the edges into `out`, one row after another.
#[inline(always)]
fn edges<R: Real>(
    now: &Situation<R>,
    list: &[usize],
    sides: &[Option<Side<R, WAYS>>; 2],
    mu: R,
    out: &mut [R],
) -> Sums<R> {
    let (zero, len) = (R::zero(), list.len());
    let mut sums = Sums { ways: [zero; WAYS], velocities: [zero; WAYS], edges: [zero; EDGES] };
    for from in (0..len).step_by(SIX) {
        let first = list[from];
        let Some(side) = sides.iter().flatten().find(|side| side.begins(first)) else { continue };
        let mut x = side.of_six(now, first);
        now.placed.metric.lift_six(first, &mut x);
        let inv_d = &now.placed.metric.inv_d[first..first + SIX];
        let u = &now.placed.u[first..first + SIX];
        let mut lines = [[zero; SIX]; EDGES];
        for k in 0..SIX {
            let own = x[k];
            let (p, q) = (mu * own[1], mu * own[2]);
            let each = [own[0] + p, own[0] - p, own[0] + q, own[0] - q];
            for i in 0..WAYS {
                sums.ways[i] += own[i] * own[i] * inv_d[k];
                sums.velocities[i] += own[i] * u[k];
            }
            for i in 0..EDGES {
                sums.edges[i] += each[i] * each[i] * inv_d[k];
                lines[i][k] = each[i];
            }
        }
        for (i, line) in lines.iter().enumerate() {
            out[i * len + from..][..SIX].copy_from_slice(line);
        }
    }
    sums
}
