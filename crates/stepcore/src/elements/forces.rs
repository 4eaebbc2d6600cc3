//! The list of forces, and what is asked of all of them. `place` adds them up, the implicit
//! integrators take their slopes, and the watchers read their energies, their power and each
//! element's own force: a new kind of force is one file and one line here.

use super::actuator::Actuator;
use super::applied::{BodyForce, JointForce};
use super::damper::Damper;
use super::fluid::Fluid;
use super::force::{Forces, Group, Moment, Sum};
use super::gravcomp::{Compensation, DrivenCompensation, Held};
use super::gravity::Gravity;
use super::spring::Spring;
use super::tendon_spring::{TendonDamper, TendonSpring};
use super::{Element, Kind};
use crate::integrator::Late;
use crate::model::{Model, NONE};
use crate::real::Real;

macro_rules! forces {
    ($($kind:ident),+ $(,)?) => {
        /// Adds up the forces of a group.
        #[inline(always)]
        pub(crate) fn push<R: Real>(now: &Moment<R>, group: Group, sum: &mut Sum<R>) {
            $(if $kind::GROUP == group {
                $kind::push(now, sum);
            })+
        }

        /// Calls `add(element, i, j, [stiffness, damping])` for the elements of a group: see
        /// `Forces::slopes`. Not inlined, as all that asks every element for numbers of two dofs:
        /// so there is this machine code once, and not for everyone who asks.
        #[inline(never)]
        pub(crate) fn slopes<R: Real>(
            now: &Moment<R>,
            group: Group,
            add: &mut dyn FnMut(Element, usize, usize, [R; 2]),
        ) {
            $(if $kind::GROUP == group {
                for index in 0..$kind::count(now.model) {
                    let element = $kind::element(index);
                    $kind::slopes(now, index, &mut |i, j, slopes| add(element, i, j, slopes));
                }
            })+
        }

        /// Calls `add(element, i, j, [stiffness, damping])` for what `discrete` takes: see
        /// `Forces::holding`.
        #[inline(never)]
        pub(crate) fn holding<R: Real>(
            now: &Moment<R>,
            add: &mut dyn FnMut(Element, usize, usize, [R; 2]),
        ) {
            $(for index in 0..$kind::count(now.model) {
                let element = $kind::element(index);
                $kind::holding(now, index, &mut |i, j, slopes| add(element, i, j, slopes));
            })+
        }

        /// Calls `each(dofs)` for every element that can have slopes, with the dofs of these.
        pub(crate) fn sloped(model: &Model, mut each: impl FnMut(&[usize])) {
            let mut dofs = Vec::new();
            $(for index in 0..$kind::count(model) {
                dofs.clear();
                $kind::sloped(model, index, &mut |dof| dofs.push(dof));
                // A joint's dofs are each by themselves.
                dofs.chunks(if $kind::IN_JOINTS { 1 } else { dofs.len().max(1) }).for_each(&mut each);
            })+
        }

        /// Calls `add(i, j, damping)` for the damping that an integrator takes late.
        #[inline(always)]
        pub(crate) fn damping<R: Real>(
            now: &Moment<R>,
            late: Late,
            mut add: impl FnMut(usize, usize, R),
        ) {
            $(if late == Late::All || $kind::IN_JOINTS {
                for index in 0..$kind::count(now.model) {
                    $kind::damping(now, index, &mut add);
                }
            })+
        }

        /// Calls `add(element, i, j, damping)` for the same.
        pub(crate) fn damping_by_element<R: Real>(
            now: &Moment<R>,
            late: Late,
            mut add: impl FnMut(Element, usize, usize, R),
        ) {
            $(if late == Late::All || $kind::IN_JOINTS {
                for index in 0..$kind::count(now.model) {
                    let element = $kind::element(index);
                    $kind::damping(now, index, &mut |i, j, damping| add(element, i, j, damping));
                }
            })+
        }

            /// By tree: it has a damping that an integrator takes late.
        fn damped(model: &Model, late: Late) -> Vec<bool> {
            let mut found = vec![false; model.trees.len()];
            $(if late == Late::All || $kind::IN_JOINTS {
                for index in (0..$kind::count(model)).filter(|index| $kind::damps(model, *index)) {
                    $kind::sloped(model, index, &mut |dof| found[model.dofs[dof].tree] = true);
                }
            })+
            found
        }

        /// Calls `add(element, energy)` for every part of what the elements of a group store.
        #[inline(always)]
        pub(crate) fn stored<R: Real>(
            now: &Moment<R>,
            group: Group,
            mut add: impl FnMut(Element, R),
        ) {
            $(if $kind::GROUP == group {
                for index in 0..$kind::count(now.model) {
                    let element = $kind::element(index);
                    $kind::stored(now, index, &mut |energy| add(element, energy));
                }
            })+
        }

        /// Power that comes from outside while dofs move at `velocity` [W].
        pub(crate) fn power<R: Real>(now: &Moment<R>, velocity: impl Fn(usize) -> R) -> R {
            let mut power = R::zero();
            $(if $kind::powers(now) {
                for index in 0..$kind::count(now.model) {
                    $kind::power(now, index, &velocity, &mut |part| power += part);
                }
            })+
            power
        }

        /// Calls `each(element, dof, force)` for every push of every element, the weight's too.
        pub(crate) fn each<R: Real>(now: &Moment<R>, mut each: impl FnMut(Element, usize, R)) {
            $(for index in 0..$kind::count(now.model) {
                let element = $kind::element(index);
                $kind::force(now, index, &mut |dof, force| each(element, dof, force));
            })+
        }

        /// How strongly every element but the weight acts in a lane.
        pub(crate) fn strengths<R: Real>(
            now: &Moment<R>,
            lane: usize,
            inertia: &dyn Fn(usize) -> f64,
        ) -> Vec<(Element, f64)> {
            let mut all = Vec::new();
            $(if $kind::GROUP != Group::Weight {
                all.extend((0..$kind::count(now.model)).map(|index| {
                    ($kind::element(index), $kind::strength(now, index, lane, inertia))
                }));
            })+
            all
        }
    };
}

// In the order in which they are added up.
forces!(
    Damper,
    Spring,
    TendonSpring,
    TendonDamper,
    Compensation,
    Fluid,
    Actuator,
    DrivenCompensation,
    JointForce,
    BodyForce,
    Gravity,
    Held,
);

impl Model {
    /// Its work is put in from outside: a motor's, or an applied force's.
    pub fn drives(&self, element: Element) -> bool {
        match element.kind {
            Kind::Actuator => !self.actuators[element.index as usize].feeds_back(),
            Kind::JointForce | Kind::BodyForce => true,
            _ => false,
        }
    }

    /// Not the weight of a body that stands still, whose energy never changes.
    pub(crate) fn moves(&self, element: Element) -> bool {
        element.kind != Kind::Gravity || self.bodies[element.part as usize].tree != NONE
    }

    /// By tree: a joint of it is damped.
    pub fn damped(&self) -> Vec<bool> {
        damped(self, Late::Joints)
    }

    /// By tree: any element damps it.
    pub fn damped_by_any(&self) -> Vec<bool> {
        damped(self, Late::All)
    }
}
