//! Lengths and arms of linkages: the sites and contacts at which actuators pull.
//!
//! MuJoCo documentation, "Transmission". At a site the arms are the ones of a force and a moment in its
//! axes, and there is no length; with a reference the length is gear · (offset, rotation vector) in the
//! axes of the reference, and motion of both is left out.
//!
//! A crank pin and a slider are joined by a rod r. With v from the slider to the pin and a the slider's
//! axis the slider is at l = a·v − √d, d = (a·v)² + r² − v·v, whose slopes are
//! ∂l/∂v = (1 − a·v/√d) a + v/√d and ∂l/∂a = (1 − a·v/√d) v. If the rod cannot reach (d ≤ 0), l = a·v.
//!
//! The contacts of a body are pulled along their normals, each with the same force.

use super::Placed;
use crate::detect::Contact;
use crate::elements::activation::Activations;
use crate::elements::actuator::{ask_of_joints, let_through};
use crate::elements::force::Moment;
use crate::model::transmission::Transmission;
use crate::model::{Linkage, Model};
use crate::real::{value, Mask, Real};
use crate::scene::Target;
use crate::spatial::{rotate, rotate_back, splat, Force, Quat, M3, V3};
use crate::state::Inputs;

/// The load on an end of a linkage: a force and a moment at a point.
struct Grip<R: Real> {
    point: V3<R>,
    force: V3<R>,
    moment: V3<R>,
}

/// The pose of a site.
struct Frame<R: Real> {
    pos: V3<R>,
    quat: Quat<R>,
    rot: M3<R>,
}

impl<R: Real> Placed<R> {
    /// Computes lengths and arms of linkages; bodies must have been placed.
    pub(super) fn place_linkages(&mut self, model: &Model<R::Value>) {
        for linkage in &model.linkages {
            let (length, grips) = match linkage.course {
                Target::Site { site, reference: None } => {
                    (R::zero(), self.thrust(model, site, &linkage.gear))
                }
                Target::Site { site, reference: Some(reference) } => {
                    self.offset_of(model, [site, reference], &linkage.gear)
                }
                Target::Crank { crank, slider, rod } => {
                    self.crank(model, [crank, slider], rod, linkage.gear[0])
                }
                Target::Body(_) => {
                    self.tendon_arms[linkage.arms.range()].fill(R::zero());
                    continue;
                }
                Target::Joint(_) | Target::InParent(_) | Target::Tendon(_) => continue,
            };
            self.tendon_length[linkage.length] = length;
            self.pull(model, linkage, &grips);
        }
    }

    fn pull(&mut self, model: &Model<R::Value>, linkage: &Linkage, grips: &[Grip<R>; 2]) {
        self.tendon_arms[linkage.arms.range()].fill(R::zero());
        for moved in &linkage.movers {
            let (motion, tree) = (&self.motion[moved.dof], model.dofs[moved.dof].tree);
            let origin = &self.origin[tree];
            let mut arm = R::zero();
            for (grip, _) in grips.iter().zip(moved.ends).filter(|(_, moves)| *moves) {
                let ang = (grip.point - origin).cross(&grip.force) + grip.moment;
                arm += motion.dot(&Force { ang, lin: grip.force });
            }
            self.tendon_arms[linkage.arms.start + moved.at] = arm;
        }
    }

    /// Computes the arms at contacts, each in some lanes: an equal share of each, along its normal and
    /// pulling its bodies together; and adds their part of the smooth force, within the bounds that
    /// joints have for all of their actuators together. `guess` is overwritten.
    pub(crate) fn place_adhesion(
        &mut self,
        model: &Model<R::Value>,
        (qpos, qvel): (&[R], &[R]),
        act: Activations<R>,
        inputs: &Inputs<R>,
        contacts: &[Contact<R>],
    ) {
        if !model.clamps.is_empty() {
            self.ask_of_joints(model, (qpos, qvel), act, inputs);
            self.driven_by_bounded_joints(model, -R::one());
        }
        for (index, along) in model.along.iter().enumerate() {
            let Transmission::Linkage(linkage) = *along else { continue };
            let linkage = &model.linkages[linkage];
            let Target::Body(body) = linkage.course else { continue };
            self.grip_contacts(model, linkage, body, contacts);
            let tension = self.actuator[index];
            for (dof, arm) in self.tendon_arms[linkage.arms.range()].iter().enumerate() {
                let bounded = model.clamps.iter().any(|(joint, _)| model.joints[*joint].dof == dof);
                let sum = if bounded { &mut self.guess } else { &mut self.force };
                sum[dof] += *arm * tension;
            }
        }
        for (joint, range) in &model.clamps {
            let dof = model.joints[*joint].dof;
            let within = model.nv + model.tendons.len() + dof;
            [self.shares[dof], self.shares[within]] =
                let_through(self.guess[dof], value::get(range));
        }
        self.driven_by_bounded_joints(model, R::one());
    }

    /// Sums the actuators' requests of each dof, into `guess`.
    fn ask_of_joints(
        &mut self,
        model: &Model<R::Value>,
        (qpos, qvel): (&[R], &[R]),
        act: Activations<R>,
        inputs: &Inputs<R>,
    ) {
        let mut sums = std::mem::take(&mut self.guess);
        let now = Moment { model, frames: self.frames(), qpos, qvel, act, inputs };
        ask_of_joints(&now, &mut sums);
        self.guess = sums;
    }

    /// Adds the parts of the requests that bounded joints let through, this many times.
    fn driven_by_bounded_joints(&mut self, model: &Model<R::Value>, times: R) {
        for (joint, _) in &model.clamps {
            let dof = model.joints[*joint].dof;
            self.force[dof] += times * self.shares[dof] * self.guess[dof];
        }
    }

    fn grip_contacts(
        &mut self,
        model: &Model<R::Value>,
        linkage: &Linkage,
        body: usize,
        contacts: &[Contact<R>],
    ) {
        let near = |contact: &Contact<R>| {
            let material = model.material(&contact.pair);
            contact.mask.and(contact.dist.lt(material.listed()))
        };
        let bodies = |contact: &Contact<R>| {
            [contact.pair.geom1, contact.pair.geom2].map(|geom| model.geoms[geom].body)
        };
        let own = || contacts.iter().filter(|contact| bodies(contact).contains(&body));
        let (zero, one) = (R::zero(), R::one());
        let count = own().fold(zero, |n, c| n + R::select(near(c), one, zero));
        let share = count.recip_or_zero();
        for contact in own() {
            let pull = contact.normal * R::select(near(contact), share, zero);
            for (body, force) in bodies(contact).into_iter().zip([pull, -pull]) {
                for dof in model.bodies[body].chain.of(&model.dof_lists) {
                    let origin = &self.origin[model.dofs[*dof].tree];
                    let ang = (contact.pos - origin).cross(&force);
                    let arm = self.motion[*dof].dot(&Force { ang, lin: force });
                    self.tendon_arms[linkage.arms.start + *dof] += arm;
                }
            }
        }
    }

    fn frame(&self, model: &Model<R::Value>, site: usize) -> Frame<R> {
        let site = &model.sites[site];
        let pos = self.xpos[site.body] + rotate(&self.xmat[site.body], &splat(&site.pos));
        let quat = self.xquat[site.body].mul(&Quat::splat(&site.quat));
        Frame { pos, rot: quat.matrix(), quat }
    }

    fn thrust(&self, model: &Model<R::Value>, site: usize, gear: &[f64; 6]) -> [Grip<R>; 2] {
        let at = self.frame(model, site);
        let [along, about] = halves(gear);
        let grip =
            Grip { point: at.pos, force: rotate(&at.rot, &along), moment: rotate(&at.rot, &about) };
        [grip, Grip { point: at.pos, force: V3::zeros(), moment: V3::zeros() }]
    }

    fn offset_of(
        &self,
        model: &Model<R::Value>,
        sites: [usize; 2],
        gear: &[f64; 6],
    ) -> (R, [Grip<R>; 2]) {
        let [at, from] = sites.map(|site| self.frame(model, site));
        let [along, about] = halves(gear);
        let mut length = R::zero();
        if gear[..3] != [0.0; 3] {
            length += rotate_back(&from.rot, &(at.pos - from.pos)).dot(&along);
        }
        if gear[3..] != [0.0; 3] {
            length += from.quat.conjugate().mul(&at.quat).log().dot(&about);
        }
        let (force, moment) = (rotate(&from.rot, &along), rotate(&from.rot, &about));
        let own = Grip { point: at.pos, force, moment };
        (length, [own, Grip { point: from.pos, force: -force, moment: -moment }])
    }

    fn crank(
        &self,
        model: &Model<R::Value>,
        sites: [usize; 2],
        rod: f64,
        gear: f64,
    ) -> (R, [Grip<R>; 2]) {
        let [pin, slider] = sites.map(|site| self.frame(model, site));
        let axis = V3::new(slider.rot[(0, 2)], slider.rot[(1, 2)], slider.rot[(2, 2)]);
        let (v, zero, one) = (pin.pos - slider.pos, R::zero(), R::one());
        let reach = axis.dot(&v);
        let square = reach * reach + R::of(rod * rod) - v.dot(&v);
        let reaches = square.gt(zero);
        let root = R::select(reaches, square, one).sqrt();
        let (scale, share) = (one - reach / root, one / root);
        let pick = |yes: R, no: R| R::select(reaches, yes, no);
        let by_v = V3::from_fn(|k, _| pick(axis[k] * scale + v[k] * share, axis[k]));
        let by_axis = V3::from_fn(|k, _| pick(v[k] * scale, v[k]));
        let gear = R::of(gear);
        let length = gear * (reach - pick(root, zero));
        let moment = axis.cross(&by_axis) * gear;
        let (force, none) = (by_v * gear, V3::zeros());
        let own = Grip { point: pin.pos, force, moment: none };
        (length, [own, Grip { point: slider.pos, force: -force, moment }])
    }
}

/// Returns the direction and the axis of a gear of six.
fn halves<R: Real>(gear: &[f64; 6]) -> [V3<R>; 2] {
    [0, 3].map(|k| V3::from_fn(|i, _| R::of(gear[k + i])))
}
