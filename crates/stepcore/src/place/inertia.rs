//! The mass matrix by the composite rigid body method (Featherstone 2008, 6.2).

use super::Placed;
use crate::model::{Model, Tree};
use crate::real::{value, Real, Value};
use crate::spatial::{rotate, splat, Inertia, M3, V3};

impl<R: Real> Placed<R> {
    /// Computes all positions, and the mass matrix there with its factors.
    pub(crate) fn masses(&mut self, model: &Model<R::Value>, qpos: &[R]) {
        self.positions(model, qpos);
        for tree in &model.trees {
            self.weigh(model, tree);
            self.factor_mass(tree);
        }
    }

    /// Computes the mass matrix of the tree.
    pub(super) fn weigh(&mut self, model: &Model<R::Value>, tree: &Tree<R::Value>) {
        self.inertias(model, tree);
        for k in tree.dofs.range() {
            let dof = &model.dofs[k];
            let momentum = self.composite[dof.body].mul(&self.motion[k]);
            for at in dof.row.range() {
                self.mass[at] = self.motion[model.row_dofs[at]].dot(&momentum);
            }
            self.mass[dof.row.start] += dof.armature.get();
        }
        self.weigh_tendons(model, tree);
    }

    /// Computes the inertia of each body, and of everything that hangs on it.
    pub(super) fn inertias(&mut self, model: &Model<R::Value>, tree: &Tree<R::Value>) {
        let origin = &self.origin[model.bodies[tree.bodies.start].tree];
        for index in tree.bodies.range() {
            let body = &model.bodies[index];
            let m = &self.xmat[index];
            let centre = self.xpos[index] - origin + rotate(m, &splat(&body.ipos));
            let inertia = value::matrix(&body.inertia);
            let turned = turn(m, &inertia);
            self.inertia[index] = Inertia::about_origin(body.mass.get(), &centre, &turned);
            self.composite[index] = self.inertia[index];
        }
        for index in tree.bodies.range().rev() {
            let parent = model.bodies[index].parent;
            if parent >= tree.bodies.start {
                let part = self.composite[index];
                self.composite[parent].add(&part);
            }
        }
    }
}

/// Returns m · i · mᵀ for a symmetric i.
#[inline(always)]
fn turn<R: Real>(m: &M3<R>, i: &M3<R>) -> M3<R> {
    let column = |k: usize| {
        let row = V3::new(m[(k, 0)], m[(k, 1)], m[(k, 2)]);
        rotate(i, &row)
    };
    let (a, b, c) = (column(0), column(1), column(2));
    let dot = |k: usize, v: &V3<R>| m[(k, 0)] * v.x + m[(k, 1)] * v.y + m[(k, 2)] * v.z;
    let (xy, xz, yz) = (dot(0, &b), dot(0, &c), dot(1, &c));
    M3::new(dot(0, &a), xy, xz, xy, dot(1, &b), yz, xz, yz, dot(2, &c))
}
