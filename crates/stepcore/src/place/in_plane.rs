//! The mass matrix and the bias force of a tree that moves in a plane: the methods of `inertia.rs`
//! and `bias.rs` in two dimensions, at a fifth of the operations.
//!
//! A motion is a rate ω about the plane's normal and the velocity v of the body point at the tree's
//! origin; a force is a moment about the origin and two components. ⊥ turns a vector by 90°, from the
//! plane's first axis to its second: n × v in space.

use super::kinematics_in_plane::{turned, Turn};
use super::Placed;
use crate::model::{Model, Plane, Tree};
use crate::real::{Real, Value};
use crate::spatial::{Motion, V3};

pub(super) type V2<R> = [R; 2];

/// The state of one body in the plane.
#[derive(Clone, Copy)]
pub(super) struct InPlane<R: Real> {
    /// From qpos0 on, by half the angle and by the whole.
    pub turn: (Turn<R>, Turn<R>),
    own: Moments<R>,
    composite: Moments<R>,
    velocity: (R, V2<R>),
    /// Acceleration of the body point at the origin when no dof accelerates, against gravity; the
    /// body's rotation has none.
    acceleration: V2<R>,
    wrench: (R, V2<R>),
}

/// Mass, and its first and second moment about the origin.
#[derive(Clone, Copy)]
struct Moments<R: Real> {
    mass: R,
    h: V2<R>,
    i: R,
}

impl<R: Real> InPlane<R> {
    /// Returns the state of a body that never moves.
    pub fn still() -> Self {
        let (zero, none) = (R::zero(), [R::zero(); 2]);
        let turn = [R::one(), zero];
        let moments = Moments { mass: zero, h: none, i: zero };
        Self {
            turn: (turn, turn),
            own: moments,
            composite: moments,
            velocity: (zero, none),
            acceleration: none,
            wrench: (zero, none),
        }
    }
}

impl<R: Real> Moments<R> {
    #[inline(always)]
    fn add(&mut self, o: &Self) {
        self.mass += o.mass;
        self.h[0] += o.h[0];
        self.h[1] += o.h[1];
        self.i += o.i;
    }

    /// Returns the momentum of a motion.
    #[inline(always)]
    fn mul(&self, (w, v): (R, V2<R>)) -> (R, V2<R>) {
        let Self { mass, h, i } = *self;
        (i * w + cross(h, v), [mass * v[0] - h[1] * w, mass * v[1] + h[0] * w])
    }
}

#[inline(always)]
fn cross<R: Real>(a: V2<R>, b: V2<R>) -> R {
    a[0] * b[1] - a[1] * b[0]
}

/// from + k·⊥v.
#[inline(always)]
pub(super) fn plus_turned<R: Real>(from: V2<R>, k: R, v: V2<R>) -> V2<R> {
    [from[0] - k * v[1], from[1] + k * v[0]]
}

#[inline(always)]
fn power<R: Real>((w, v): (R, V2<R>), (moment, force): (R, V2<R>)) -> R {
    w * moment + (v[0] * force[0] + v[1] * force[1])
}

impl<N> Plane<N> {
    #[inline(always)]
    fn of<R: Real>(&self, v: &V3<R>) -> V2<R> {
        let [x, y] = self.axes();
        [v[x], v[y]]
    }

    #[inline(always)]
    fn motion<R: Real>(&self, motion: &Motion<R>) -> (R, V2<R>) {
        (motion.ang[self.normal], self.of(&motion.lin))
    }
}

impl<R: Real> Placed<R> {
    /// See `weigh`.
    pub(super) fn weigh_in_plane(
        &mut self,
        model: &Model<R::Value>,
        tree: &Tree<R::Value>,
        plane: &Plane<R::Value>,
    ) {
        let origin = self.origin[model.bodies[tree.bodies.start].tree];
        for (index, flat) in tree.bodies.range().zip(&plane.bodies) {
            let body = &model.bodies[index];
            let at = plane.of(&(self.xpos[index] - origin));
            let arm = turned(self.in_plane[index].turn.1, &flat.centre);
            let centre = [at[0] + arm[0], at[1] + arm[1]];
            let mass = body.mass.get();
            let h = centre.map(|x| mass * x);
            let i = flat.moment.get() + (h[0] * centre[0] + h[1] * centre[1]);
            let own = Moments { mass, h, i };
            (self.in_plane[index].own, self.in_plane[index].composite) = (own, own);
        }
        for index in tree.bodies.range().rev() {
            let parent = model.bodies[index].parent;
            if parent >= tree.bodies.start {
                let part = self.in_plane[index].composite;
                self.in_plane[parent].composite.add(&part);
            }
        }
        for k in tree.dofs.range() {
            let dof = &model.dofs[k];
            let whole = &self.in_plane[dof.body].composite;
            let momentum = whole.mul(plane.motion(&self.motion[k]));
            for at in dof.row.range() {
                let motion = plane.motion(&self.motion[model.row_dofs[at]]);
                self.mass[at] = power(motion, momentum);
            }
            self.mass[dof.row.start] += dof.armature.get();
        }
        self.weigh_tendons(model, tree);
    }

    /// See `bias_of_tree`.
    pub(super) fn bias_in_plane(
        &mut self,
        model: &Model<R::Value>,
        qvel: &[R],
        tree: &Tree<R::Value>,
        plane: &Plane<R::Value>,
    ) {
        let none = (R::zero(), [R::zero(); 2]);
        let up = match model.features.gravity {
            true => plane.axes().map(|k| -model.gravity[k].get()),
            false => [-R::zero(); 2],
        };
        for index in tree.bodies.range() {
            let body = &model.bodies[index];
            let (mut velocity, mut a) = if body.parent >= tree.bodies.start {
                let parent = &self.in_plane[body.parent];
                (parent.velocity, parent.acceleration)
            } else {
                (none, up)
            };
            if model.features.coriolis {
                for k in body.dofs.range() {
                    let (motion, rate) = (plane.motion(&self.motion[k]), qvel[k]);
                    let ((turn, along), (w, v)) = (motion, velocity);
                    // The motion's rate of change, carried along by the frame it is fixed in:
                    // ω·⊥along − turn·⊥v.
                    a = plus_turned(a, rate * w, along);
                    a = plus_turned(a, -(rate * turn), v);
                    let v = [v[0] + rate * along[0], v[1] + rate * along[1]];
                    velocity = (w + rate * turn, v);
                }
            }
            let body = &mut self.in_plane[index];
            let Moments { mass, h, .. } = body.own;
            let mut wrench = (cross(h, a), [mass * a[0], mass * a[1]]);
            if model.features.coriolis {
                let (_, p) = body.own.mul(velocity);
                let (w, v) = velocity;
                wrench = (wrench.0 + cross(v, p), plus_turned(wrench.1, w, p));
            }
            (body.velocity, body.acceleration, body.wrench) = (velocity, a, wrench);
        }
        for index in tree.bodies.range().rev() {
            let body = &model.bodies[index];
            let wrench = self.in_plane[index].wrench;
            for k in body.dofs.range() {
                self.bias[k] = power(plane.motion(&self.motion[k]), wrench);
            }
            if body.parent >= tree.bodies.start {
                let (moment, force) = &mut self.in_plane[body.parent].wrench;
                *moment += wrench.0;
                force[0] += wrench.1[0];
                force[1] += wrench.1[1];
            }
        }
    }
}
