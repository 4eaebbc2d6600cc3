//! States at a corner of a law, at which derivatives are one-sided.
//!
//! The solve finds the corners of rows (`solve/derivative.rs`). Here are the others: a control, an
//! activation or a force at its bound, a muscle whose activation equals its control, a tendon at an
//! end of its slack, and a limit or a contact at the distance from which it has a row.

use crate::detect::almost;
use crate::elements::{actuator, Element, Kind};
use crate::integrator::Stages;
use crate::model::transmission::Limited;
use crate::real::{same, Constant, Dual, Real, ROUNDED};
use crate::sim::{At, Sim};

/// Contacts that are farther from having a row are not examined [m].
const SOON: f64 = 1e-9;

type Number = <Dual as Real>::Value;

fn at_bound(x: Dual, bounds: Option<&[Number; 2]>) -> bool {
    bounds.into_iter().flatten().any(|bound| same(x.value, bound.lane(0)))
}

impl Sim<Dual> {
    /// The elements at a corner of their law at the present state.
    pub(super) fn corners(&mut self) -> Vec<Element> {
        // Other integrators have placed further positions since.
        if self.plan.scheme.stages != Stages::Start {
            self.refresh();
        }
        let mut all = self.actuators_at_bounds();
        all.extend(self.sums_at_bounds());
        all.extend(self.slack_ends());
        if !self.settings.law.on_guess() {
            all.extend(self.limits_reached());
            all.extend(self.contacts_reached());
        }
        all
    }

    fn actuators_at_bounds(&self) -> Vec<Element> {
        let (now, model) = (self.moment(At::State), &self.model);
        let mut forces = vec![Dual::of(0.0); model.actuators.len()];
        let pulls = now.frames.pulls;
        actuator::tensions(model, now.qpos, now.qvel, now.act, now.inputs, pulls, &mut forces);
        let cornered = |index: &usize| {
            let (drive, own) = (&model.drives[*index], &model.actuators[*index]);
            let ctrl = now.act.ctrl(model, *index, now.inputs);
            let turns = model.activations[*index].range().next().is_some_and(|k| {
                let circle = model.circles[*index];
                own.turns(now.act.act[k], own.held(model, ctrl), circle, now.act.seconds)
            });
            at_bound(ctrl, drive.ctrlrange.as_ref())
                || at_bound(forces[*index], drive.bounds.as_ref())
                || turns
        };
        let acting = model.acting.actuator.iter().map(|acts| acts.index);
        acting.filter(cornered).map(|index| Element::whole(Kind::Actuator, index)).collect()
    }

    /// Joints and tendons that bound the sum of their actuators.
    fn sums_at_bounds(&self) -> Vec<Element> {
        let (now, model) = (self.moment(At::State), &self.model);
        if now.frames.shares.is_empty() {
            return vec![];
        }
        let mut sums = vec![Dual::of(0.0); model.nv];
        actuator::ask_of_joints(&now, &mut sums);
        let joints = model.clamps.iter().filter_map(|(joint, range)| {
            let sum = sums[model.joints[*joint].dof];
            at_bound(sum, Some(range)).then(|| Element::whole(Kind::Joint, *joint))
        });
        let tendons = model.tendons.iter().enumerate().filter_map(|(index, tendon)| {
            let sum = actuator::tension_of(model, index, now.frames.tension);
            at_bound(sum, tendon.actuatorfrcrange.as_ref())
                .then(|| Element::whole(Kind::Tendon, index))
        });
        joints.chain(tendons).collect()
    }

    fn slack_ends(&self) -> Vec<Element> {
        let lengths = self.placed.frames().pulls.length;
        let at_end = |index: &usize| {
            let ends = &self.model.tendons[*index].springlength;
            ends[0].lane(0) < ends[1].lane(0) && at_bound(lengths[*index], Some(ends))
        };
        let springs = self.model.acting.tendon_spring.iter().map(|acts| acts.at.tendon);
        springs.filter(at_end).map(|index| Element::whole(Kind::TendonSpring, index)).collect()
    }

    fn limits_reached(&self) -> Vec<Element> {
        let reached = |bound: &Limited<Number>, side: usize| {
            let pulls = self.placed.frames().pulls;
            let length = bound.along.length(&self.model, &self.state.qpos, pulls).value;
            let sign = if side == 0 { 1.0 } else { -1.0 };
            same(length - sign * bound.margin.lane(0), bound.range[side].lane(0))
        };
        let sides = |bound: &Limited<Number>| {
            let sides = bound.sides.clone().filter(|side| reached(bound, *side));
            sides.map(|side| Element::part(bound.kind, bound.index, side)).collect::<Vec<_>>()
        };
        self.model.limited.iter().flat_map(sides).collect()
    }

    /// Pairs of a pile are not examined.
    fn contacts_reached(&self) -> Vec<Element> {
        let (model, mut all) = (&self.model, vec![]);
        if !(model.features.contact && model.features.constraint) {
            return all;
        }
        almost(model, &self.placed.geom, SOON, |pair, touch| {
            let reach: Dual = model.material(pair).reach();
            let size = touch.pos.iter().fold(reach.value.abs(), |most, x| most.max(x.value.abs()));
            let far = (touch.dist.value - reach.value).abs();
            let element = Element::whole(Kind::Contact, pair.index);
            if far <= ROUNDED * f64::EPSILON * size && all.last() != Some(&element) {
                all.push(element);
            }
        });
        all
    }
}
