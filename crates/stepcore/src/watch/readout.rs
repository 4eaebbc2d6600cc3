//! What a user reads of a simulation beside its state, one lane (world) at a time.
//!
//! Poses and matrices are those of the last `refresh` or solve; rows, contacts and
//! constraint forces those of the last solve.

use crate::detect::Contact;
use crate::model::NONE;
use crate::real::{Mask, Real};
use crate::sim::Sim;
use crate::solve::{Block, Row, Set};
use crate::spatial::{rotate, splat, Quat, M3, V3};
use nalgebra::Vector3;

impl<R: Real> Sim<R> {
    /// The mass matrix, armature included, row by row (nv × nv).
    pub fn mass_matrix(&self, lane: usize) -> Vec<f64> {
        let model = &*self.model;
        let mut full = vec![0.0; model.nv * model.nv];
        for (k, dof) in model.dofs.iter().enumerate() {
            for at in dof.row.range() {
                let j = model.row_dofs[at];
                let value = self.placed.mass[at].lane(lane);
                full[k * model.nv + j] = value;
                full[j * model.nv + k] = value;
            }
        }
        full
    }

    /// How a body's frame moves with every dof: linear velocity of its origin in 3 rows
    /// of nv numbers, then its angular velocity in 3.
    pub fn jacobian(&self, body: usize, lane: usize) -> Vec<f64> {
        let model = &*self.model;
        let mut rows = vec![0.0; 6 * model.nv];
        let tree = model.bodies[body].tree;
        if tree == NONE {
            return rows;
        }
        let arm = self.placed.xpos[body] - self.placed.origin[tree];
        for &k in model.bodies[body].chain.of(&model.dof_lists) {
            let motion = &self.placed.motion[k];
            let lin = motion.lin + motion.ang.cross(&arm);
            for axis in 0..3 {
                rows[axis * model.nv + k] = lin[axis].lane(lane);
                rows[(axis + 3) * model.nv + k] = motion.ang[axis].lane(lane);
            }
        }
        rows
    }

    /// Where something fixed to a body is.
    pub fn attached(&self, body: usize, pos: &Vector3<f64>, quat: &[f64; 4]) -> (V3<R>, M3<R>) {
        let placed = &self.placed;
        let turn = placed.xquat[body].mul(&Quat::splat(quat)).matrix();
        (placed.xpos[body] + rotate(&placed.xmat[body], &splat(pos)), turn)
    }

    /// Generalised force of every row together, Jᵀλ/dt = Lᵀ Σ yλ / dt.
    pub fn constraint_force(&self, lane: usize) -> Vec<f64> {
        let model = &*self.model;
        let mut force = vec![R::zero(); model.nv];
        if !self.rows.any() {
            return vec![0.0; model.nv];
        }
        for (_, row) in self.live_rows(lane) {
            let dofs = row.dofs.of(&model.dof_lists);
            for (k, y) in dofs.iter().zip(&self.rows.y[row.y..]) {
                force[*k] += *y * row.total();
            }
        }
        self.placed.metric.lower(&mut force);
        force.iter().map(|f| f.lane(lane) / self.clock.seconds).collect()
    }

    /// The rows that exist in a lane, each with the index of its block.
    pub fn live_rows(&self, lane: usize) -> impl Iterator<Item = (usize, &Row<R>)> {
        let blocks = self.rows.blocks.iter().enumerate();
        blocks.filter(move |(_, block)| block.mask.lane(lane)).flat_map(|(index, block)| {
            self.rows.rows[block.rows.range()].iter().map(move |row| (index, row))
        })
    }

    /// The contacts that exist in a lane, each with its index.
    pub fn live_contacts(&self, lane: usize) -> impl Iterator<Item = (usize, &Contact<R>)> {
        self.detected
            .contacts
            .iter()
            .enumerate()
            .filter(move |(_, contact)| contact.mask.lane(lane))
    }

    /// Force of a contact on geom 2, in world axes [N].
    pub fn contact_force(&self, contact: &Contact<R>, lane: usize) -> [f64; 3] {
        let element = contact.element();
        if let Some(block) = self.rows.blocks.iter().find(|block| block.element == element) {
            return self.block_force(block, contact, lane);
        }
        // Pushes along the normal, then along the tangents that move something.
        let tangents = contact.tangents(&self.model, &self.placed);
        let moving = tangents.iter().zip(self.model.pairs[contact.pair].still);
        let moving = moving.filter(|(_, still)| !still).map(|(tangent, _)| tangent);
        let ways = std::iter::once(&contact.normal).chain(moving);
        let pushes = self.rows.pushes.iter().filter(|push| push.element == element);
        let parts = ways
            .zip(pushes)
            .map(|(way, push)| scaled(way, push.impulse.lane(lane) / self.clock.seconds, lane));
        parts.fold([0.0; 3], |sum, part| std::array::from_fn(|axis| sum[axis] + part[axis]))
    }

    fn block_force(&self, block: &Block<R>, contact: &Contact<R>, lane: usize) -> [f64; 3] {
        let rows = &self.rows.rows[block.rows.range()];
        let impulse: Vec<f64> = rows.iter().map(|row| row.total().lane(lane)).collect();
        let bounded = |at: usize| rows[at].lo.lane(lane) >= 0.0;
        let still = self.model.pairs[contact.pair].still;
        let tangents = contact.tangents(&self.model, &self.placed);
        let moving = tangents.iter().zip(still).filter(|(_, still)| !still);
        // A pyramid's rows are its edges J_n ± μ J_t and, if need be, their fold; a pair of edges
        // whose normal nothing moves is a tangent without bounds, and its load.
        let edges = block.set == Set::Interval;
        let loads = || (0..impulse.len()).filter(|at| bounded(*at)).map(|at| impulse[at]);
        let normal = if edges { loads().sum() } else { impulse[0] };
        let mut force = scaled(&contact.normal, normal / self.clock.seconds, lane);
        for (k, (tangent, _)) in moving.enumerate() {
            let along = match impulse.len() {
                1 => 0.0,
                _ if edges && !bounded(2 * k) => block.mu.lane(lane) * impulse[2 * k],
                _ if edges => block.mu.lane(lane) * (impulse[2 * k] - impulse[2 * k + 1]),
                _ => impulse[k + 1],
            };
            let part = scaled(tangent, along / self.clock.seconds, lane);
            force = std::array::from_fn(|axis| force[axis] + part[axis]);
        }
        force
    }

    /// How the rows that exist in a lane push each other, at the last solve.
    pub fn coupling(&self, lane: usize) -> Coupling {
        let dof_lists = &self.model.dof_lists;
        let live: Vec<(usize, &Row<R>)> = self.live_rows(lane).collect();
        let entries = |row: &Row<R>| {
            let dofs = row.dofs.of(dof_lists);
            dofs.iter().copied().zip(self.rows.y[row.y..].iter().map(|y| y.lane(lane)))
        };
        let mut coupling = Coupling::default();
        let mut spread = vec![0.0; self.model.nv];
        for (index, row) in &live {
            spread.fill(0.0);
            for (k, y) in entries(row) {
                spread[k] = y * self.placed.metric.inv_d[k].lane(lane);
            }
            let products = live.iter().map(|(_, other)| entries(other).map(|(k, y)| y * spread[k]));
            coupling.a.extend(products.map(|parts| parts.sum::<f64>()));
            let block = &self.rows.blocks[*index];
            let set = match block.set {
                Set::Interval => 0.0,
                Set::Convex => 1.0,
                Set::CoulombRound => 2.0,
                Set::CoulombBox => 3.0,
            };
            coupling.rows.push([row.inv_s.lane(lane), block.mass, block.mu.lane(lane), set]);
        }
        coupling
    }

    /// How far each row of a block is from its law at the impulses it holds: s·|δ|, in
    /// the row's own unit of velocity (see `solve/residual.rs`).
    pub fn row_residuals(&self, block: &Block<R>, lane: usize) -> Vec<f64> {
        let mut residuals = Vec::new();
        self.rows.natural_map(&self.model.dof_lists, block, |_, delta, s| {
            residuals.push((s * delta.abs()).lane(lane));
        });
        residuals
    }
}

/// What the sweeps see of the rows: how they push each other, and each row's own part.
#[derive(Clone, Debug, Default)]
pub struct Coupling {
    /// J H⁻¹ Jᵀ, row by row (rows × rows).
    pub a: Vec<f64>,
    /// By row: one over the denominator of its update; the mass of the trees that it touches;
    /// the friction of its cone; and 0 for an interval, 1 for a row of a convex cone, 2 and 3
    /// for one of a Coulomb cone, round or box.
    pub rows: Vec<[f64; 4]>,
}

fn scaled<R: Real>(v: &V3<R>, k: f64, lane: usize) -> [f64; 3] {
    [v.x, v.y, v.z].map(|x| x.lane(lane) * k)
}
