//! Derivatives of the bias forces by the velocities, ∂c/∂v, for `implicit`.
//!
//! With v_b, a_b the velocity of body b and its acceleration when no dof accelerates, its wrench is
//! I a + v ×* I v, and cᵢ = sᵢ·Σ of the wrenches of all bodies that hang on dof i. A dof j adds sⱼ to
//! the velocity of everything that hangs on it, and to the acceleration
//!
//! ```text
//! ∂a_b/∂vⱼ = fⱼ × sⱼ + sⱼ × (v_b − gⱼ) = mⱼ + sⱼ × v_b,   mⱼ = fⱼ × sⱼ − sⱼ × gⱼ
//! ```
//!
//! fⱼ is the velocity of the frame in which sⱼ is fixed, and gⱼ the velocity at the first axis that sⱼ
//! carries along: after the dof for a hinge, after all three for a ball. With the map
//! B_b s = I (s × v) + s ×* I v + v ×* I s, summed over everything that hangs on a body as inertia is,
//! ∂cᵢ/∂vⱼ = sᵢ·(I mⱼ + B sⱼ), with I and B of the body of the deeper dof. (Carpentier & Mansard 2018
//! differentiate the same recursion.)

use super::Placed;
use crate::model::{Model, Tree};
use crate::real::Real;
use crate::spatial::{Force, Motion, V3};

/// Working space.
pub(crate) struct BiasSlopes<R: Real> {
    /// B of each body and all that hangs on it: its columns.
    maps: Vec<[Force<R>; 6]>,
    /// mⱼ, by dof.
    carried: Vec<Motion<R>>,
}

room!(BiasSlopes<R>: maps, carried);

impl<R: Real> BiasSlopes<R> {
    pub fn new(model: &Model<R::Value>) -> Self {
        Self {
            maps: vec![[Force::zero(); 6]; model.bodies.len()],
            carried: vec![Motion::zero(); model.nv],
        }
    }

    /// Calls `add(at, [∂cⱼ/∂vₖ, ∂cₖ/∂vⱼ])` for every dof k of a tree and each dof j of its row,
    /// starting with k itself; `at`: their place in `Model::row_dofs`.
    pub fn of_tree(
        &mut self,
        placed: &Placed<R>,
        model: &Model<R::Value>,
        tree: &Tree<R::Value>,
        qvel: &[R],
        mut add: impl FnMut(usize, [R; 2]),
    ) {
        self.carry(placed, model, tree, qvel);
        for index in tree.bodies.range() {
            self.maps[index] = map(placed, index);
        }
        for index in tree.bodies.range().rev() {
            let parent = model.bodies[index].parent;
            if parent >= tree.bodies.start {
                let part = self.maps[index];
                self.maps[parent].iter_mut().zip(&part).for_each(|(sum, part)| sum.add(part));
            }
        }
        for k in tree.dofs.range() {
            let dof = &model.dofs[k];
            let (whole, map) = (&placed.composite[dof.body], &self.maps[dof.body]);
            let own = &placed.motion[k];
            let momentum = whole.mul(own);
            let mut wrench = whole.mul(&self.carried[k]);
            wrench.add(&times(map, own));
            let back = transposed(map, own);
            for at in dof.row.range() {
                let (motion, carried) = (&placed.motion[model.row_dofs[at]], &self.carried);
                let own = carried[model.row_dofs[at]].dot(&momentum) + motion.dot(&back);
                add(at, [motion.dot(&wrench), own]);
            }
        }
    }

    /// Computes mⱼ of every dof.
    fn carry(
        &mut self,
        placed: &Placed<R>,
        model: &Model<R::Value>,
        tree: &Tree<R::Value>,
        qvel: &[R],
    ) {
        for index in tree.bodies.range() {
            let body = &model.bodies[index];
            let inside = body.parent >= tree.bodies.start;
            let mut v = if inside { placed.velocity[body.parent] } else { Motion::zero() };
            for joint in body.joints.of(&model.joints) {
                // A free joint slides first, then it turns like a ball.
                let (first, count) = (joint.dof, joint.dofs());
                let slides = count.saturating_sub(3);
                for dofs in [first..first + slides, first + slides..first + count] {
                    let frame = v;
                    for k in dofs.clone() {
                        v.add_scaled(&placed.motion[k], qvel[k]);
                    }
                    for k in dofs {
                        let own = &placed.motion[k];
                        let mut carried = frame.cross(own);
                        carried.add_scaled(&own.cross(&v), -R::one());
                        self.carried[k] = carried;
                    }
                }
            }
        }
    }
}

/// B of one body, column by column.
fn map<R: Real>(placed: &Placed<R>, body: usize) -> [Force<R>; 6] {
    let (inertia, v) = (&placed.inertia[body], &placed.velocity[body]);
    let momentum = inertia.mul(v);
    crate::real::array::from_fn(|n| {
        let mut axis = V3::zeros();
        axis[n % 3] = R::one();
        let unit = match n < 3 {
            true => Motion { ang: axis, lin: V3::zeros() },
            false => Motion { ang: V3::zeros(), lin: axis },
        };
        let mut sum = inertia.mul(&unit.cross(v));
        sum.add(&unit.cross_force(&momentum));
        sum.add(&v.cross_force(&inertia.mul(&unit)));
        sum
    })
}

/// B s.
fn times<R: Real>(map: &[Force<R>; 6], s: &Motion<R>) -> Force<R> {
    let mut sum = Force::zero();
    let parts = s.ang.iter().chain(s.lin.iter());
    for (column, part) in map.iter().zip(parts) {
        sum.ang += column.ang * *part;
        sum.lin += column.lin * *part;
    }
    sum
}

/// Bᵀ s.
fn transposed<R: Real>(map: &[Force<R>; 6], s: &Motion<R>) -> Force<R> {
    let [a, b, c, d, e, f] = crate::real::array::from_fn(|n| s.dot(&map[n]));
    Force { ang: V3::new(a, b, c), lin: V3::new(d, e, f) }
}
