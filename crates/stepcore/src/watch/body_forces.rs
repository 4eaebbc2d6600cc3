//! Accelerations of bodies and the forces between them in the last solve: MuJoCo's `cacc`,
//! `cfrc_ext` and `cfrc_int`, written about the same points as `cvel`.

use super::bodies::{lane_of, seen_from, Bodies};
use crate::elements::weld::axes;
use crate::elements::Kind;
use crate::model::{Tie, NONE};
use crate::real::{Mask, Real};
use crate::sim::Sim;
use crate::spatial::{splat, Force, Motion, Quat, V3};

/// Lists are by body.
pub struct BodyForces {
    /// Acceleration of the body's point there, gravity counted as an upward acceleration.
    pub cacc: Vec<Motion<f64>>,
    /// Applied forces, contacts, connections and spatial tendons. The world's are not counted.
    pub external: Vec<Force<f64>>,
    /// The force of the parent on the body, including everything that hangs on it.
    pub internal: Vec<Force<f64>>,
}

impl<R: Real> Sim<R> {
    /// The forces of the last solve; the bodies must be at its state.
    pub fn body_forces(&self, bodies: &Bodies, lane: usize) -> BodyForces {
        let cacc = self.accelerations(bodies, lane);
        let external = self.external_forces(bodies, lane);
        let mut internal: Vec<Force<f64>> = vec![Force::zero(); external.len()];
        for index in (1..internal.len()).rev() {
            let (inertia, velocity) = (&bodies.cinert[index], &bodies.cvel[index]);
            let mut own = inertia.mul(&cacc[index]);
            own.add(&velocity.cross_force(&inertia.mul(velocity)));
            own.add(&negative(&external[index]));
            internal[index].add(&own);
            let passed = internal[index];
            internal[self.model.bodies[index].parent].add(&passed);
        }
        BodyForces { cacc, external, internal }
    }

    fn accelerations(&self, bodies: &Bodies, lane: usize) -> Vec<Motion<f64>> {
        let (model, placed) = (&**self.model_of(lane), &self.placed);
        let up =
            if model.features.gravity { -splat::<f64, _>(&model.gravity) } else { V3::zeros() };
        let one = |m: &Motion<R>| Motion { ang: lane_of(&m.ang, lane), lin: lane_of(&m.lin, lane) };
        let of = |index: usize| {
            let body = &model.bodies[index];
            if body.tree == NONE {
                return Motion { ang: V3::zeros(), lin: up };
            }
            let mut all = one(&placed.free_acceleration(&self.model, index));
            for k in body.chain.of(&model.dof_lists) {
                all.add_scaled(&one(&placed.motion[*k]), self.qacc[*k].lane(lane));
            }
            let origin = lane_of(&placed.origin[body.tree], lane);
            let mut there = seen_from(&all, &(bodies.about(index) - origin));
            there.lin += up;
            there
        };
        (0..model.bodies.len()).map(of).collect()
    }

    fn external_forces(&self, bodies: &Bodies, lane: usize) -> Vec<Force<f64>> {
        let model = &**self.model_of(lane);
        let mut forces = vec![Force::zero(); model.bodies.len()];
        let mut push = |body: usize, at: &V3<f64>, force: &V3<f64>, moment: &V3<f64>| {
            if body != 0 {
                let arm = at - bodies.about(body);
                forces[body].add(&Force { ang: moment + arm.cross(force), lin: *force });
            }
        };
        for (index, six) in self.inputs.xfrc_applied().chunks(6).enumerate() {
            let vector = |from: usize| V3::from_fn(|k, _| six[from + k].lane(lane));
            push(index, &bodies.centre[index], &vector(0), &vector(3));
        }
        for (_, contact) in self.live_contacts(lane) {
            let wrench = self.contact_wrench(contact, lane);
            let (force, torque) =
                (V3::from_row_slice(&wrench[..3]), V3::from_row_slice(&wrench[3..]));
            let at = lane_of(&contact.pos, lane);
            let [one, two] = [contact.pair.geom1, contact.pair.geom2].map(|g| model.geoms[g].body);
            push(one, &at, &-force, &-torque);
            push(two, &at, &force, &torque);
        }
        for block in self.rows.blocks.iter().filter(|block| block.mask.lane(lane)) {
            let (ends, scale) = match (block.element.kind, block.element.index as usize) {
                (Kind::Connect | Kind::Weld, index) => match &model.equalities[index].tie {
                    Tie::Connect(ends) => (ends, 0.0),
                    Tie::Weld { ends, torquescale } => (ends, *torquescale),
                    Tie::Lengths(_) => continue,
                },
                _ => continue,
            };
            let rows = &self.rows.rows[block.rows.range()];
            let force = |at: usize| rows[at].total().lane(lane) / self.clock.seconds;
            let moment: V3<f64> = if scale == 0.0 {
                V3::zeros()
            } else {
                let [a, b] =
                    [0, 1].map(|k| bodies.xquat[ends.bodies[k]].mul(&Quat::splat(&ends.quat[k])));
                let along = axes(&b.conjugate().mul(&a), &b.matrix(), scale);
                (0..3).map(|k| along[k] * force(3 + k)).sum()
            };
            let force = V3::from_fn(|k, _| force(k));
            for (k, sign) in [(0, 1.0), (1, -1.0)] {
                let body = ends.bodies[k];
                let point = bodies.xpos[body] + bodies.xmat[body] * ends.pos[k];
                push(body, &point, &(force * sign), &(moment * sign));
            }
        }
        for (tendon, force) in self.tension_of_tendons(lane).into_iter().enumerate() {
            if force != 0.0 {
                self.placed.tendon_pulls(&self.model, tendon, |body, at, along| {
                    let pull = lane_of(&along, lane) * force;
                    push(body, &lane_of(&at, lane), &pull, &V3::zeros());
                });
            }
        }
        forces
    }
}

fn negative(force: &Force<f64>) -> Force<f64> {
    Force { ang: -force.ang, lin: -force.lin }
}
