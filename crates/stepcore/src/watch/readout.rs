//! Quantities of a simulation that a user reads besides its state, one lane (world) at a time.
//!
//! Poses and matrices belong to the last `refresh` or solve; rows, contacts and constraint forces
//! to the last solve.

use super::zeros;
use crate::detect::Contact;
use crate::elements::friction::{Axis, Ways, MOST_WAYS};
use crate::elements::{Element, Kind};
use crate::error::Result;
use crate::model::NONE;
use crate::real::{Constant, Mask, Real};
use crate::settings::Law;
use crate::sim::Sim;
use crate::solve::{Block, Push, Row, Set};
use crate::spatial::{rotate, splat, Quat, M3, V3};
use nalgebra::Vector3;

impl<R: Real> Sim<R> {
    /// The mass matrix, armature included, row by row (nv × nv). Refuses one that does not fit in
    /// memory.
    pub fn mass_matrix(&self, lane: usize) -> Result<Vec<f64>> {
        let model = &*self.model;
        let mut full = zeros("mass_matrix", model.nv, model.nv)?;
        for (k, dof) in model.dofs.iter().enumerate() {
            for at in dof.row.range() {
                let j = model.row_dofs[at];
                let value = self.placed.mass[at].lane(lane);
                full[k * model.nv + j] = value;
                full[j * model.nv + k] = value;
            }
        }
        Ok(full)
    }

    /// The motion of a body's frame with every dof: linear velocity of its origin in 3 rows of nv
    /// numbers, then its angular velocity in 3.
    pub fn jacobian(&self, body: usize, lane: usize) -> Vec<f64> {
        self.jacobian_at(body, &self.placed.xpos[body], lane)
    }

    /// The same for the point of the body that is at `point`.
    pub fn jacobian_at(&self, body: usize, point: &V3<R>, lane: usize) -> Vec<f64> {
        let model = &*self.model;
        let mut rows = vec![0.0; 6 * model.nv];
        let tree = model.bodies[body].tree;
        if tree == NONE {
            return rows;
        }
        let arm = point - self.placed.origin[tree];
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

    /// The pose of something fixed to a body.
    pub fn attached(&self, body: usize, pos: &Vector3<f64>, quat: &[f64; 4]) -> (V3<R>, M3<R>) {
        let placed = &self.placed;
        let turn = placed.xquat[body].mul(&Quat::splat(quat)).matrix();
        (placed.xpos[body] + rotate(&placed.xmat[body], &splat(pos)), turn)
    }

    /// Generalised force of every row and penalty contact together, Jᵀλ/dt = Lᵀ Σ yλ / dt.
    pub fn constraint_force(&self, lane: usize) -> Vec<f64> {
        let model = &*self.model;
        let mut force = vec![R::zero(); model.nv];
        // Adhesion beyond the rows is a passive force, as MuJoCo counts it.
        let penalty = self.settings.law == Law::Penalty;
        let pushes = self.rows.pushes.iter().filter(|_| penalty);
        let pushes = pushes.map(|push| (push.dofs, push.y, push.impulse));
        let rows = self.live_rows(lane).map(|(_, row)| (row.dofs, row.y, row.total()));
        for (dofs, y, impulse) in rows.chain(pushes) {
            let dofs = dofs.of(self.detected.dof_lists(model));
            for (k, y) in dofs.iter().zip(&self.rows.y[y..]) {
                force[*k] += *y * impulse;
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

    /// Force [N] and torque [N·m] of a contact on geom 2 where they touch, in world axes. The
    /// torque is due to torsion and rolling.
    pub fn contact_wrench(&self, contact: &Contact<R>, lane: usize) -> [f64; 6] {
        let pair = &contact.pair;
        let element = contact.element();
        let law = self.settings.law;
        let ways = Ways::under(law, pair.still, self.model.material(pair));
        let mut parts = [0.0; 1 + MOST_WAYS];
        // Blocks are in the order of their slots.
        let (slot, blocks) = (self.model.slot(element), &self.rows.blocks);
        if let Ok(at) = blocks.binary_search_by_key(&slot, |block| block.slot) {
            self.parts_of_block(&blocks[at], &ways, lane, &mut parts);
            if self.model.sticks && law == Law::SolRef {
                parts[0] += self.pull_of(contact, lane);
                let margin = self.model.material(pair).margin.lane(lane);
                if contact.dist.lane(lane) >= margin {
                    // Beyond it only the normal pulls, with the first row.
                    parts[1..].fill(0.0);
                }
            }
        } else {
            for ((part, push), row) in parts.iter_mut().zip(self.pushes_of(element)).zip(0..) {
                *part = push.impulse.lane(lane) * ways.scale_of_row(row).lane(lane);
            }
        }
        let tangents = contact.tangents(&self.placed);
        let [normal, along @ ..] = parts.map(|part| part / self.clock.seconds);
        let mut wrench = [0.0; 6];
        let mut push = |axis: &V3<R>, size: f64, first: usize| {
            for (to, part) in wrench[first..].iter_mut().zip(scaled(axis, size, lane)) {
                *to += part;
            }
        };
        push(&contact.normal, normal, 0);
        for (way, size) in ways.list().iter().zip(along) {
            let axis = match way.axis {
                Axis::Normal => &contact.normal,
                Axis::Tangent(at) => &tangents[at],
            };
            push(axis, size, if way.turns { 3 } else { 0 });
        }
        wrench
    }

    /// The pull of a contact's adhesion beyond its rows, along the normal. Without passive forces
    /// MuJoCo still counts it.
    fn pull_of(&self, contact: &Contact<R>, lane: usize) -> f64 {
        let material = self.model.material(&contact.pair);
        if !self.model.features.passive() && contact.dist.lane(lane) < material.listed_in(lane) {
            return -material.adhesion.lane(lane) * self.clock.seconds;
        }
        let pushes = self.pushes_of(contact.element()).iter();
        pushes.map(|push| push.impulse.lane(lane)).sum()
    }

    /// The pushes of a contact, which are in the order of slots as blocks are.
    fn pushes_of(&self, element: Element) -> &[Push<R>] {
        let (slot, pushes) = (self.model.slot(element), &self.rows.pushes);
        let first = pushes.partition_point(|push| self.model.slot(push.element) < slot);
        let own = pushes[first..].iter().take_while(|push| push.element == element);
        &pushes[first..first + own.count()]
    }

    /// Impulse along the normal, then in each way, in its unit.
    fn parts_of_block(
        &self,
        block: &Block<R>,
        ways: &Ways<R>,
        lane: usize,
        parts: &mut [f64; 1 + MOST_WAYS],
    ) {
        let rows = &self.rows.rows[block.rows.range()];
        let impulse = |at: usize| rows[at].total().lane(lane);
        if block.set != Set::Interval {
            for (at, part) in parts.iter_mut().enumerate().take(rows.len()) {
                *part = impulse(at) * ways.scale_of_row(at).lane(lane);
            }
            return;
        }
        // A pyramid's rows are its edges J_n ± μ_j J_j and, if need be, their fold; a pair of edges
        // whose normal nothing moves is a way without bounds, and its load.
        let bounded = |at: usize| rows[at].lo.lane(lane) >= 0.0;
        parts[0] = (0..rows.len()).filter(|at| bounded(*at)).map(impulse).sum();
        if rows.len() > 1 {
            for (k, way) in ways.list().iter().enumerate() {
                let across = if bounded(2 * k) { impulse(2 * k + 1) } else { 0.0 };
                let mu = block.mu.lane(lane) * way.scale.lane(lane);
                parts[k + 1] = mu * (impulse(2 * k) - across);
            }
        }
    }

    /// The physical impulse of one unit of a row's impulse: torsion and rolling in a cone are in
    /// the measure of sliding (`elements/friction.rs`). For velocities of the row divide instead.
    pub fn scale_of_row(&self, block: &Block<R>, row: usize, lane: usize) -> f64 {
        if block.set == Set::Interval || block.element.kind != Kind::Contact {
            return 1.0;
        }
        let Some(pair) = self.model.pair(block.element.index as usize) else { return 1.0 };
        let material = self.model.material(&pair);
        Ways::<R>::under(self.settings.law, pair.still, material).scale_of_row(row).lane(lane)
    }

    /// The coupling of the rows that exist in a lane, at the last solve.
    pub fn coupling(&self, lane: usize) -> Coupling {
        let dof_lists = self.detected.dof_lists(&self.model);
        let live: Vec<(usize, &Row<R>)> = self.live_rows(lane).collect();
        let entries = |row: &Row<R>| {
            let dofs = row.dofs.of(dof_lists);
            dofs.iter().copied().zip(self.rows.y[row.y..].iter().map(|y| y.lane(lane)))
        };
        let mut coupling = Coupling::default();
        let mut spread = vec![0.0; self.model.nv];
        let (mut within, mut last) = (0, None);
        for (index, row) in &live {
            within = if last.replace(*index) == Some(*index) { within + 1 } else { 0 };
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
            let scale = self.scale_of_row(block, within, lane);
            let (s, mu) = (row.inv_s.lane(lane), block.mu.lane(lane));
            coupling.rows.push([s, block.mass.lane(lane), mu, set, scale]);
        }
        coupling
    }

    /// The distance of each row of a block from its law at its present impulses: s·|δ|, in the
    /// row's unit of velocity (see `solve/residual.rs`).
    pub fn row_residuals(&self, block: &Block<R>, lane: usize) -> Vec<f64> {
        let mut residuals = Vec::new();
        self.rows.natural_map(self.detected.dof_lists(&self.model), block, |_, delta, s| {
            residuals.push((s * delta.abs()).lane(lane));
        });
        residuals
    }
}

/// The rows as the sweeps see them: their coupling, and the constants of each row.
#[derive(Clone, Debug, Default)]
pub struct Coupling {
    /// J H⁻¹ Jᵀ, row by row (rows × rows).
    pub a: Vec<f64>,
    /// For each row: one over the denominator of its update; the mass of the trees that it touches;
    /// the friction of its cone; and 0 for an interval, 1 for a row of a convex cone, 2 and 3 for
    /// one of a Coulomb cone, round or box; and the physical impulse of one unit of its impulse,
    /// because torsion and rolling in a cone are solved in the measure of sliding, as `a` has them.
    pub rows: Vec<[f64; 5]>,
}

fn scaled<R: Real>(v: &V3<R>, k: f64, lane: usize) -> [f64; 3] {
    [v.x, v.y, v.z].map(|x| x.lane(lane) * k)
}
