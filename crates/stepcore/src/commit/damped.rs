//! `euler` and `implicitfast`: forces first, solved in M; then implicit damping, v⁺ = v + dt
//! (M + dt·D)⁻¹ (f + Jᵀλ/dt). MuJoCo documentation, "Numerical integration".
//!
//! D is joint damping; under `implicitfast` it covers every element, including the velocity
//! feedback of servos unless their force is at its bound. As in MuJoCo, D has the entries that M
//! has, a dof and its ancestors, and is made symmetric, (D + Dᵀ)/2; couplings of a length across
//! branches or trees stay explicit. `implicitfast` re-solves the 6×6 block of a free body
//! separately with its unsymmetric D, and with the derivative B of its bias force: with body axes,
//! R the rotation, m the mass, c the centre, I the inertia about the joint and w the angular
//! velocity,
//!
//! ```text
//! B[lin, ang] = −m R ([w×c]× + [w]×[c]×)      B[ang, ang] = [w]× I − [I w]×
//! ```

use crate::elements::force::Moment;
use crate::elements::forces::damping;
use crate::integrator::Late;
use crate::model::Model;
use crate::place::{Metric, Placed};
use crate::plan::LateTrees;
use crate::real::{Mask, Real};
use crate::spatial::{rotate, rotate_back, M3, V3};

/// Factors of M + dt·D, and the impulse of the step.
pub struct Damped<R: Real> {
    metric: Metric<R>,
    impulse: Vec<R>,
    change: Vec<R>,
    /// Per tree: whether damping applies, and its index in `blocks`.
    damped: Vec<bool>,
    block: Vec<Option<usize>>,
    /// M + dt·D of each single free body whose bias has a derivative.
    blocks: Vec<[[R; 6]; 6]>,
}

room!(Damped<R>: metric, impulse, change, damped, block, blocks);

impl<R: Real> Damped<R> {
    pub fn new(model: &Model<R::Value>, late: &LateTrees) -> Self {
        let place = |tree: &usize| late.spinning.binary_search(tree).ok();
        let trees = 0..model.trees.len();
        Self {
            metric: Metric::new(model),
            impulse: vec![R::zero(); model.nv],
            change: vec![R::zero(); model.nv],
            damped: trees.clone().map(|tree| late.damped.contains(&tree)).collect(),
            block: trees.map(|tree| place(&tree)).collect(),
            blocks: vec![[[R::zero(); 6]; 6]; late.spinning.len()],
        }
    }
}

/// The input of damping.
pub(super) struct Solved<'a, R: Real> {
    pub now: Moment<'a, R>,
    pub placed: &'a Placed<R>,
    /// u⁺.
    pub u: &'a [R],
    pub dt: R,
}

impl<R: Real> Solved<'_, R> {
    /// out ← the impulse H (v⁺ − v) = LᵀD (u⁺ − u), with H the matrix in which rows were solved.
    pub fn impulse(&self, out: &mut [R]) {
        let metric = &self.placed.metric;
        for k in 0..out.len() {
            out[k] = (self.u[k] - self.placed.u[k]) / metric.inv_d[k];
        }
        metric.lower(out);
    }
}

impl<R: Real> Damped<R> {
    /// Rewrite the solved velocities in `out` with damping (and under `implicitfast` servos and the
    /// gyroscopic forces of free bodies) treated implicitly.
    pub fn damp(&mut self, solved: &Solved<R>, late: &LateTrees, out: &mut [R]) {
        let &Solved { ref now, placed, dt, .. } = solved;
        let &Moment { model, qvel, .. } = now;
        solved.impulse(&mut self.impulse);
        self.change.copy_from_slice(&self.impulse);
        for &tree in &late.damped {
            self.metric.refill(model.trees[tree].dofs.range(), &placed.mass);
        }
        let mass = |i, j| model.entry(i, j).map_or(R::zero(), |at| placed.mass[at]);
        for (block, &tree) in self.blocks.iter_mut().zip(&late.spinning) {
            *block = free_block(model.trees[tree].dofs.start, mass);
        }
        let Self { metric, blocks, damped, block, .. } = self;
        damping(now, late.of.unwrap_or(Late::Joints), |i, j, damping| {
            let tree = model.dofs[i].tree;
            if damped[tree] {
                metric.add(i, j, dt * damping);
            } else if let Some(at) = block[tree].filter(|_| model.dofs[j].tree == tree) {
                let first = model.trees[tree].dofs.start;
                blocks[at][i - first][j - first] += dt * damping;
            }
        });
        for &tree in &late.damped {
            let dofs = model.trees[tree].dofs.range();
            self.metric.factor(dofs.clone());
            self.metric.solve_dofs(dofs.clone(), &mut self.change);
            for k in dofs {
                out[k] = qvel[k] + self.change[k];
            }
        }
        for (block, &tree) in self.blocks.iter().zip(&late.spinning) {
            self.spin(solved, tree, *block, R::Mask::of(true), out);
        }
    }

    /// The same for the gyroscopic forces alone, after rows were solved in M̂: for free bodies on
    /// which no tendon and no actuator has slopes, as in MuJoCo.
    pub fn spin_all(&mut self, solved: &Solved<R>, late: &LateTrees, out: &mut [R]) {
        let Some(effective) = &solved.placed.effective else { return };
        solved.impulse(&mut self.impulse);
        for &tree in &late.spinning {
            let first = solved.now.model.trees[tree].dofs.start;
            let entry = |i, j| effective.entry(&solved.placed.metric, i, j);
            let block = free_block(first, entry);
            self.spin(solved, tree, block, effective.tied[tree].not(), out);
        }
    }

    /// v⁺ = v + (A + dt·B)⁻¹ P for one free body, in some lanes.
    fn spin(
        &self,
        solved: &Solved<R>,
        tree: usize,
        mut matrix: [[R; 6]; 6],
        lanes: R::Mask,
        out: &mut [R],
    ) {
        let &Solved { ref now, placed, dt, .. } = solved;
        let first = now.model.trees[tree].dofs.start;
        placed.add_gyroscopic(now.model, tree, now.qvel, dt, &mut matrix);
        let mut x = [R::zero(); 6];
        x.copy_from_slice(&self.impulse[first..first + 6]);
        solve_six(&mut matrix, &mut x);
        for k in 0..6 {
            let spun = now.qvel[first + k] + x[k];
            out[first + k] = R::select(lanes, spun, out[first + k]);
        }
    }
}

impl<R: Real> Placed<R> {
    /// Adds dt·B of a single free body.
    fn add_gyroscopic(
        &self,
        model: &Model<R::Value>,
        tree: usize,
        qvel: &[R],
        dt: R,
        matrix: &mut [[R; 6]; 6],
    ) {
        let (first, root) = (model.trees[tree].dofs.start, model.trees[tree].bodies.start);
        let turn = &self.xmat[root];
        let whole = &self.composite[root];
        let w = V3::new(qvel[first + 3], qvel[first + 4], qvel[first + 5]);
        // First and second moment of mass in body axes, about the joint.
        let h = rotate_back(turn, &whole.h);
        let [xx, yy, zz, xy, xz, yz] = whole.i;
        let world = M3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        let inertia = turn.transpose() * world * turn;
        let linear = cross_matrix(&w.cross(&h)) + cross_matrix(&w) * cross_matrix(&h);
        let linear = turn * linear;
        let angular = cross_matrix(&w) * inertia - cross_matrix(&rotate(&inertia, &w));
        for i in 0..3 {
            for j in 0..3 {
                matrix[i][3 + j] -= dt * linear[(i, j)];
                matrix[3 + i][3 + j] += dt * angular[(i, j)];
            }
        }
    }
}

/// Returns the block of a free body in a symmetric matrix, given by its entries (i, j ≤ i).
fn free_block<R: Real>(first: usize, entry: impl Fn(usize, usize) -> R) -> [[R; 6]; 6] {
    let mut block = [[R::zero(); 6]; 6];
    for i in 0..6 {
        for j in 0..=i {
            let entry = entry(first + i, first + j);
            block[i][j] = entry;
            block[j][i] = entry;
        }
    }
    block
}

/// Returns the matrix of v × ·.
fn cross_matrix<R: Real>(v: &V3<R>) -> M3<R> {
    let zero = R::zero();
    M3::new(zero, -v.z, v.y, v.z, zero, -v.x, -v.y, v.x, zero)
}

/// Gaussian elimination without pivoting: M dominates, dt·B is relatively small.
fn solve_six<R: Real>(a: &mut [[R; 6]; 6], x: &mut [R; 6]) {
    for k in 0..6 {
        let inv = R::one() / a[k][k];
        for i in k + 1..6 {
            let factor = a[i][k] * inv;
            for j in k..6 {
                let part = factor * a[k][j];
                a[i][j] -= part;
            }
            let part = factor * x[k];
            x[i] -= part;
        }
    }
    for k in (0..6).rev() {
        for j in k + 1..6 {
            let part = a[k][j] * x[j];
            x[k] -= part;
        }
        x[k] /= a[k][k];
    }
}
