//! The edges of contacts that slide along two tangents, with whole pyramids built at once.
//!
//! Normal and tangents are lifted side by side, and the four edges are computed from each dof's
//! entries, so that no tangent is stored. Contacts of two free bodies with the same directions,
//! such as the contacts of two boxes, are vectorised: an operation handles one number of each. The
//! numbers equal the results of `push_relative` and `push_edges`, bit for bit.

use super::relative::{is_free, SIX};
use super::rows::Rows;
use super::situation::Situation;
use super::suspect;
use crate::model::{Pair, NONE};
use crate::real::{Mask, Real};
use crate::scene::JointType;
use crate::spatial::V3;

/// The normal and two tangents.
const WAYS: usize = 3;
/// Two per tangent.
const EDGES: usize = 4;

/// One of the two bodies of N contacts.
struct Side<R: Real, const N: usize> {
    /// Its first dof.
    first: usize,
    /// The contact points, from the origin of the body's motion.
    arm: [[R; N]; 3],
    /// The directions along which the body's motion counts.
    along: [V3<R>; WAYS],
}

/// The edges of N contacts: the starts of their y, and A = J M⁻¹ Jᵀ and J v of directions and edges.
pub(crate) struct Pyramids<R: Real, const N: usize> {
    y: usize,
    ways: [[R; N]; WAYS],
    velocities: [[R; N]; WAYS],
    edges: [[R; N]; EDGES],
}

impl<R: Real> Rows<R> {
    /// Computes the y of the edges J_n ± μ J_t for the relative velocity of two bodies at `at`,
    /// `along` the normal and two tangents. Returns None for several contacts if the bodies are not
    /// free, or if a direction may be rounding to be dropped: such contacts are built one by one.
    pub(crate) fn lift_pyramids<const N: usize>(
        &mut self,
        now: &Situation<R>,
        own: ([usize; 2], &Pair<R>),
        at: &[[V3<R>; 2]; N],
        along: &[V3<R>; WAYS],
        mu: R,
    ) -> Option<Pyramids<R, N>> {
        match (self.lift_free_pyramids(now, own, at, along, mu), at.as_slice()) {
            (None, [at]) => {
                let (y, sums, edges) = self.lift_pyramid(now, own, at, along, mu);
                let each = |of: R| [of; N];
                let [ways, velocities] =
                    [sums.a, sums.velocity].map(|[n, a, b, _]| [n, a, b].map(each));
                Some(Pyramids { y, ways, velocities, edges: edges.map(each) })
            }
            (made, _) => made,
        }
    }

    /// Computes the same for free bodies only.
    fn lift_free_pyramids<const N: usize>(
        &mut self,
        now: &Situation<R>,
        (bodies, pair): ([usize; 2], &Pair<R>),
        at: &[[V3<R>; 2]; N],
        along: &[V3<R>; WAYS],
        mu: R,
    ) -> Option<Pyramids<R, N>> {
        let list = pair.dofs.of(now.dof_lists);
        let sides = [side(now, bodies, 0, at, along)?, side(now, bodies, 1, at, along)?];
        let count = sides.iter().flatten().count();
        if now.model.couples || list.len() != count * SIX {
            return None;
        }
        let none = [R::zero(); N];
        let mut made = Pyramids {
            y: self.y.len(),
            ways: [none; WAYS],
            velocities: [none; WAYS],
            edges: [none; EDGES],
        };
        let mut lines = [[[none; SIX]; EDGES]; 2];
        for (lines, first) in lines.iter_mut().zip(list.iter().step_by(SIX)) {
            let mine = sides.iter().flatten().find(|side| side.first == *first);
            made.add(now, mine?, mu, lines);
        }
        if made.ways.iter().flatten().any(|a| suspect(*a, pair.mass).any()) {
            return None;
        }
        self.y.resize(made.y + N * EDGES * list.len(), R::zero());
        let rows = self.y[made.y..].chunks_exact_mut(list.len());
        for (at, row) in rows.enumerate() {
            let (c, i) = (at / EDGES, at % EDGES);
            for (lines, out) in lines.iter().zip(row.chunks_exact_mut(SIX)) {
                for k in 0..SIX {
                    out[k] = lines[i][k][c];
                }
            }
        }
        Some(made)
    }

    /// Pushes the rows of one of the contacts.
    pub(crate) fn push_pyramid<const N: usize>(
        &mut self,
        made: &Pyramids<R, N>,
        which: usize,
        pair: &Pair<R>,
        mu: R,
    ) {
        let start = made.y + which * EDGES * pair.dofs.len;
        let [normal, tangents @ ..] = made.velocities.map(|way| way[which]);
        for (k, a) in made.edges.iter().enumerate() {
            let by = mu * tangents[k / 2];
            let velocity = if k % 2 == 0 { normal + by } else { normal - by };
            self.push_row(pair.dofs, start + k * pair.dofs.len, a[which], velocity);
        }
    }
}

/// Returns one of two bodies if it is free, Some(None) if it cannot move; else None.
#[inline(always)]
fn side<R: Real, const N: usize>(
    now: &Situation<R>,
    bodies: [usize; 2],
    which: usize,
    at: &[[V3<R>; 2]; N],
    along: &[V3<R>; WAYS],
) -> Option<Option<Side<R, N>>> {
    let body = &now.model.bodies[bodies[which]];
    if body.tree == NONE {
        return Some(None);
    }
    let chain = body.chain.of(&now.model.dof_lists);
    let first = *chain.first()?;
    let joint = &now.model.joints[now.model.dofs[first].joint];
    if joint.kind != JointType::Free || !is_free(now.model, chain) {
        return None;
    }
    let origin = &now.placed.origin[body.tree];
    let mut arm = [[R::zero(); N]; 3];
    for c in 0..N {
        for axis in 0..3 {
            arm[axis][c] = at[c][which][axis] - origin[axis];
        }
    }
    let [n, a, b] = along;
    let along = if which == 0 { [-n, -a, -b] } else { *along };
    Some(Some(Side { first, arm, along }))
}

impl<R: Real, const N: usize> Side<R, N> {
    /// J of a direction by dof: a free body moves along the world's axes and turns about its axes.
    /// The omitted terms are products with 0, added to numbers that are never −0.
    #[inline(always)]
    fn jacobian(&self, now: &Situation<R>, way: usize) -> [[R; N]; SIX] {
        let (d, [x, y, z]) = (&self.along[way], &self.arm);
        let mut torque = [[R::zero(); N]; 3];
        for c in 0..N {
            torque[0][c] = y[c] * d.z - z[c] * d.y;
            torque[1][c] = z[c] * d.x - x[c] * d.z;
            torque[2][c] = x[c] * d.y - y[c] * d.x;
        }
        let mut j = [[R::zero(); N]; SIX];
        for k in 0..3 {
            let axis = &now.placed.motion[self.first + 3 + k].ang;
            for c in 0..N {
                j[k][c] += d[k];
                j[3 + k][c] +=
                    (axis.x * torque[0][c] + axis.y * torque[1][c]) + axis.z * torque[2][c];
            }
        }
        j
    }
}

impl<R: Real, const N: usize> Side<R, N> {
    /// `jacobian` of each direction of the first contact, side by side; the last place is empty.
    #[inline(always)]
    fn jacobians(&self, now: &Situation<R>) -> [[R; EDGES]; SIX] {
        let [n, a, b] = &self.along;
        let [x, y, z] = self.arm.map(|arm| arm[0]);
        let d: [[R; EDGES]; 3] = crate::real::array::from_fn(|k| [n[k], a[k], b[k], R::zero()]);
        let mut torque = [[R::zero(); EDGES]; 3];
        for i in 0..EDGES {
            torque[0][i] = y * d[2][i] - z * d[1][i];
            torque[1][i] = z * d[0][i] - x * d[2][i];
            torque[2][i] = x * d[1][i] - y * d[0][i];
        }
        let mut j = [[R::zero(); EDGES]; SIX];
        for k in 0..3 {
            let axis = &now.placed.motion[self.first + 3 + k].ang;
            for i in 0..EDGES {
                j[k][i] += d[k][i];
                j[3 + k][i] +=
                    (axis.x * torque[0][i] + axis.y * torque[1][i]) + axis.z * torque[2][i];
            }
        }
        j
    }
}

impl<R: Real, const N: usize> Pyramids<R, N> {
    /// Adds a body's part of the sums, and sets its y of the edges.
    #[inline(always)]
    fn add(
        &mut self,
        now: &Situation<R>,
        side: &Side<R, N>,
        mu: R,
        lines: &mut [[[R; N]; SIX]; EDGES],
    ) {
        // Lanes already fill vectors.
        if R::ALONE && N == 1 {
            return self.add_one(now, side, mu, lines);
        }
        let metric = &now.placed.metric;
        let Self { ways: own, velocities, edges, .. } = self;
        let mut ways = [[[R::zero(); N]; SIX]; WAYS];
        for (i, way) in ways.iter_mut().enumerate() {
            *way = side.jacobian(now, i);
            metric.lift_six(side.first, way);
        }
        let inv_d = &metric.inv_d[side.first..][..SIX];
        let u = &now.placed.u[side.first..][..SIX];
        for k in 0..SIX {
            for c in 0..N {
                let (own, p, q) = (ways[0][k][c], mu * ways[1][k][c], mu * ways[2][k][c]);
                lines[0][k][c] = own + p;
                lines[1][k][c] = own - p;
                lines[2][k][c] = own + q;
                lines[3][k][c] = own - q;
            }
        }
        for i in 0..WAYS {
            let (mut a, mut velocity) = (own[i], velocities[i]);
            for k in 0..SIX {
                for c in 0..N {
                    a[c] += ways[i][k][c] * ways[i][k][c] * inv_d[k];
                    velocity[c] += ways[i][k][c] * u[k];
                }
            }
            (own[i], velocities[i]) = (a, velocity);
        }
        for i in 0..EDGES {
            let mut a = edges[i];
            for k in 0..SIX {
                for c in 0..N {
                    a[c] += lines[i][k][c] * lines[i][k][c] * inv_d[k];
                }
            }
            edges[i] = a;
        }
    }
    /// The same for one contact: its normal and tangents number by number, and its edges.
    #[inline(always)]
    fn add_one(
        &mut self,
        now: &Situation<R>,
        side: &Side<R, N>,
        mu: R,
        lines: &mut [[[R; N]; SIX]; EDGES],
    ) {
        let metric = &now.placed.metric;
        let inv_d = &metric.inv_d[side.first..][..SIX];
        let u = &now.placed.u[side.first..][..SIX];
        let mut ways = side.jacobians(now);
        metric.lift_six(side.first, &mut ways);
        let [mut own, mut velocities, mut edges] = [[R::zero(); EDGES]; 3];
        for i in 0..WAYS {
            (own[i], velocities[i]) = (self.ways[i][0], self.velocities[i][0]);
        }
        for i in 0..EDGES {
            edges[i] = self.edges[i][0];
        }
        for k in 0..SIX {
            let way = &ways[k];
            let (n, p, q) = (way[0], mu * way[1], mu * way[2]);
            let line = [n + p, n - p, n + q, n - q];
            for i in 0..EDGES {
                own[i] += way[i] * way[i] * inv_d[k];
                velocities[i] += way[i] * u[k];
                edges[i] += line[i] * line[i] * inv_d[k];
                lines[i][k][0] = line[i];
            }
        }
        for i in 0..WAYS {
            (self.ways[i][0], self.velocities[i][0]) = (own[i], velocities[i]);
        }
        for i in 0..EDGES {
            self.edges[i][0] = edges[i];
        }
    }
}
