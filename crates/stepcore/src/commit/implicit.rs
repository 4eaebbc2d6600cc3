//! `implicit`: forces first, solved in M; then all velocity dependence of the smooth forces,
//! implicitly, v⁺ = v + dt (M + dt·D)⁻¹ (f + Jᵀλ/dt) with D = −∂f/∂v of dampers, servos and the
//! bias forces. MuJoCo documentation, "Numerical integration".
//!
//! D has the entries of M, a dof and its ancestors, and is not symmetric. Elimination from the last
//! dof to the first gives A = U L without fill-in, like LᵀDL of a symmetric matrix.

use super::damped::Solved;
use crate::elements::force::Moment;
use crate::elements::forces::damping;
use crate::integrator::Late;
use crate::model::Model;
use crate::place::bias_slopes::BiasSlopes;
use crate::plan::LateTrees;
use crate::real::Real;
use std::ops::Range;

/// M + dt·D, and working space.
pub(super) struct Implicit<R: Real> {
    matrix: Unsymmetric<R>,
    change: Vec<R>,
    bias: BiasSlopes<R>,
    /// Per tree: whether it has damping or velocity-dependent bias forces; whether it has the latter.
    late: Vec<bool>,
    turns: Vec<bool>,
}

room!(Implicit<R>: matrix, change, bias, late, turns);

impl<R: Real> Implicit<R> {
    pub fn new(model: &Model<R::Value>, late: &LateTrees) -> Self {
        let has =
            |list: &[usize]| (0..model.trees.len()).map(|tree| list.contains(&tree)).collect();
        Self {
            matrix: Unsymmetric::new(model),
            change: vec![R::zero(); model.nv],
            bias: BiasSlopes::new(model),
            late: has(&late.damped),
            turns: has(&late.turning),
        }
    }

    /// Rewrite the solved velocities in `out`.
    pub fn damp(&mut self, solved: &Solved<R>, trees: &[usize], out: &mut [R]) {
        let Self { matrix, change, bias, late, turns } = self;
        let &Solved { ref now, placed, dt, .. } = solved;
        let &Moment { model, qvel, .. } = now;
        solved.impulse(change);
        for &tree in trees {
            matrix.fill(model, model.trees[tree].dofs.range(), &placed.mass);
        }
        damping(now, Late::All, |i, j, damping| {
            if late[model.dofs[i].tree] {
                matrix.add(model, i, j, dt * damping);
            }
        });
        for &tree in trees {
            let own = &model.trees[tree];
            if turns[tree] {
                bias.of_tree(placed, model, own, qvel, |at, [up, low]| {
                    matrix.upper[at] += dt * up;
                    matrix.lower[at] += dt * low;
                });
            }
            matrix.factor(model, own.dofs.range());
            matrix.solve(model, own.dofs.range(), change);
            for k in own.dofs.range() {
                out[k] = qvel[k] + change[k];
            }
        }
    }
}

/// A matrix whose rows and columns have the pattern of M, both in the layout of `Model::row_dofs`.
struct Unsymmetric<R: Real> {
    /// Row k, left of its diagonal and with it; and column k, above its diagonal: once factored,
    /// over the diagonal. The diagonal itself is in `lower`.
    lower: Vec<R>,
    upper: Vec<R>,
    /// 1 / diagonal, once factored.
    inv_d: Vec<R>,
}

room!(Unsymmetric<R>: lower, upper, inv_d);

impl<R: Real> Unsymmetric<R> {
    fn new(model: &Model<R::Value>) -> Self {
        let zeros = |n| vec![R::zero(); n];
        let n = model.row_dofs.len();
        Self { lower: zeros(n), upper: zeros(n), inv_d: zeros(model.nv) }
    }

    /// Copies a symmetric matrix.
    fn fill(&mut self, model: &Model<R::Value>, dofs: Range<usize>, symmetric: &[R]) {
        for k in dofs {
            let row = model.dofs[k].row.range();
            self.lower[row.clone()].copy_from_slice(&symmetric[row.clone()]);
            self.upper[row.clone()].copy_from_slice(&symmetric[row]);
        }
    }

    /// Adds to the entry in row i and column j, if the pattern has it.
    #[inline(always)]
    fn add(&mut self, model: &Model<R::Value>, i: usize, j: usize, x: R) {
        if let Some(at) = model.entry(i, j) {
            let half = if i >= j { &mut self.lower } else { &mut self.upper };
            half[at] += x;
        }
    }

    fn factor(&mut self, model: &Model<R::Value>, dofs: Range<usize>) {
        for k in dofs.rev() {
            let row = model.dofs[k].row;
            let inv = R::one() / self.lower[row.start];
            self.inv_d[k] = inv;
            for at in row.range().skip(1) {
                self.upper[at] *= inv;
            }
            // A_ij −= A_ik A_kj / A_kk for all ancestors i, j: row j of the pattern is the rest of row k.
            for nth in 1..row.len {
                let at = row.start + nth;
                let above = model.dofs[model.row_dofs[at]].row.start;
                let (up, low) = (self.upper[at], self.lower[at]);
                for rest in 0..row.len - nth {
                    let (up_rest, low_rest) = (self.upper[at + rest], self.lower[at + rest]);
                    self.lower[above + rest] -= up * low_rest;
                    if rest > 0 {
                        self.upper[above + rest] -= up_rest * low;
                    }
                }
            }
        }
    }

    /// x ← A⁻¹ x.
    fn solve(&self, model: &Model<R::Value>, dofs: Range<usize>, x: &mut [R]) {
        for k in dofs.clone().rev() {
            let own = x[k];
            for at in model.dofs[k].row.range().skip(1) {
                x[model.row_dofs[at]] -= self.upper[at] * own;
            }
        }
        for k in dofs {
            let mut sum = x[k];
            for at in model.dofs[k].row.range().skip(1) {
                sum -= self.lower[at] * x[model.row_dofs[at]];
            }
            x[k] = sum * self.inv_d[k];
        }
    }
}
