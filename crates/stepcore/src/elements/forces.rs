//! The list of forces, and the functions that evaluate all of them. `place` adds them up, the implicit
//! integrators take their slopes, and the watchers read their energies, their power and the force of
//! each element: a new kind of force is one file and one line here.

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
use crate::plan::acting::{Acting, Acts, Why};
use crate::real::{Constant, Real};

macro_rules! forces {
    ($($list:ident: $kind:ident),+ $(,)?) => {
        impl Acting {
            pub fn of(model: &Model) -> Self {
                let mut acting = Self::default();
                $(for index in 0..$kind::count(model) {
                    match $kind::at(model, index) {
                        Ok(at) => acting.$list.push(Acts { index, at }),
                        Err(Why::Unsaid) => {}
                        Err(why) => acting.left_out.push(($kind::element(index), why)),
                    }
                }
                let acts = !$kind::APPLIED && !acting.$list.is_empty();
                acting.passive |= acts && $kind::GROUP == Group::Passive;
                acting.driven |= acts && $kind::GROUP == Group::Driven;)+
                acting
            }

            /// Lists all elements that act.
            pub fn elements(&self) -> Vec<Element> {
                let mut all = vec![];
                $(all.extend(self.$list.iter().map(|acts| $kind::element(acts.index)));)+
                all
            }
        }

        /// Adds up the forces of a group.
        #[inline(always)]
        pub(crate) fn push<R: Real>(now: &Moment<R>, group: Group, sum: &mut Sum<R>) {
            $(if $kind::GROUP == group {
                $kind::push(now, &now.model.acting.$list, sum);
            })+
        }

        /// Calls `add(element, i, j, [stiffness, damping])` for the elements of a group: see
        /// `Forces::slopes`. Not inlined, like everything that evaluates every element for pairs of
        /// dofs, so that this machine code exists once, and not at every call.
        #[inline(never)]
        pub(crate) fn slopes<R: Real>(
            now: &Moment<R>,
            group: Group,
            add: &mut dyn FnMut(Element, usize, usize, [R; 2]),
        ) {
            $(if $kind::GROUP == group {
                for Acts { index, at } in &now.model.acting.$list {
                    let element = $kind::element(*index);
                    $kind::slopes(now, at, &mut |i, j, slopes| add(element, i, j, slopes));
                }
            })+
        }

        /// Calls `add(element, i, j, [stiffness, damping])` for the slopes that `discrete` takes: see
        /// `Forces::holding`.
        #[inline(never)]
        pub(crate) fn holding<R: Real>(
            now: &Moment<R>,
            add: &mut dyn FnMut(Element, usize, usize, [R; 2]),
        ) {
            $(for Acts { index, at } in &now.model.acting.$list {
                let element = $kind::element(*index);
                $kind::holding(now, at, &mut |i, j, slopes| add(element, i, j, slopes));
            })+
        }

        /// Calls `each(dofs)` for every element that can have slopes, with the dofs of the slopes.
        pub(crate) fn sloped<N: Constant>(model: &Model<N>, each: &mut dyn FnMut(&[usize])) {
            let mut dofs = Vec::new();
            $(for Acts { at, .. } in &model.acting.$list {
                dofs.clear();
                $kind::sloped(model, at, &mut |dof| dofs.push(dof));
                // A joint's dofs are separate.
                dofs.chunks(if $kind::IN_JOINTS { 1 } else { dofs.len().max(1) }).for_each(&mut *each);
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
                for Acts { at, .. } in &now.model.acting.$list {
                    $kind::damping(now, at, &mut add);
                }
            })+
        }

        /// Calls `add(element, i, j, damping)` for the same.
        #[inline(never)]
        pub(crate) fn damping_by_element<R: Real>(
            now: &Moment<R>,
            late: Late,
            add: &mut dyn FnMut(Element, usize, usize, R),
        ) {
            $(if late == Late::All || $kind::IN_JOINTS {
                for Acts { index, at } in &now.model.acting.$list {
                    let element = $kind::element(*index);
                    $kind::damping(now, at, &mut |i, j, damping| add(element, i, j, damping));
                }
            })+
        }

            /// Returns, by tree, whether it has a damping that an integrator takes late.
        fn damped<N: Constant>(model: &Model<N>, late: Late) -> Vec<bool> {
            let mut found = vec![false; model.trees.len()];
            $(if late == Late::All || $kind::IN_JOINTS {
                let all = model.acting.$list.iter();
                for Acts { at, .. } in all.filter(|acts| $kind::damps(model, &acts.at)) {
                    $kind::sloped(model, at, &mut |dof| found[model.dofs[dof].tree] = true);
                }
            })+
            found
        }

        /// Calls `add(element, energy)` for every part of the energy of a group's elements.
        #[inline(never)]
        pub(crate) fn stored<R: Real>(
            now: &Moment<R>,
            group: Group,
            add: &mut dyn FnMut(Element, R),
        ) {
            $(if $kind::GROUP == group {
                for Acts { index, at } in &now.model.acting.$list {
                    let element = $kind::element(*index);
                    $kind::stored(now, at, &mut |energy| add(element, energy));
                }
            })+
        }

        /// Returns the power that comes from outside while dofs move at `velocity` [W].
        pub(crate) fn power<R: Real>(now: &Moment<R>, velocity: &[R]) -> R {
            let mut power = R::zero();
            $(if $kind::powers(now) {
                for Acts { at, .. } in &now.model.acting.$list {
                    $kind::power(now, at, velocity, &mut |part| power += part);
                }
            })+
            power
        }

        /// Calls `each(element, dof, force)` for every push of every element, the weight's too.
        #[inline(never)]
        pub(crate) fn each<R: Real>(now: &Moment<R>, each: &mut dyn FnMut(Element, usize, R)) {
            $(for Acts { index, at } in &now.model.acting.$list {
                let element = $kind::element(*index);
                $kind::force(now, at, &mut |dof, force| each(element, dof, force));
            })+
        }

        /// Computes how strongly every element but the weight acts in a lane.
        pub(crate) fn strengths<R: Real>(
            now: &Moment<R>,
            lane: usize,
            inertia: &dyn Fn(usize) -> f64,
        ) -> Vec<(Element, f64)> {
            let mut all = Vec::new();
            $(if $kind::GROUP != Group::Weight {
                all.extend(now.model.acting.$list.iter().map(|Acts { index, at }| {
                    ($kind::element(*index), $kind::strength(now, at, lane, inertia))
                }));
            })+
            all
        }
    };
}

// In the order in which they are added up.
forces!(
    damper: Damper,
    spring: Spring,
    tendon_spring: TendonSpring,
    tendon_damper: TendonDamper,
    compensation: Compensation,
    fluid: Fluid,
    actuator: Actuator,
    driven_compensation: DrivenCompensation,
    joint_force: JointForce,
    body_force: BodyForce,
    gravity: Gravity,
    held: Held,
);

impl<N: Constant> Model<N> {
    /// Checks whether an element's work is put in from outside: a motor's, or an applied force's.
    pub fn drives(&self, element: Element) -> bool {
        match element.kind {
            Kind::Actuator => !self.actuators[element.index as usize].feeds_back(),
            Kind::JointForce | Kind::BodyForce => true,
            _ => false,
        }
    }

    /// Checks for an element other than the weight of a fixed body, whose energy never changes.
    pub(crate) fn moves(&self, element: Element) -> bool {
        element.kind != Kind::Gravity || self.bodies[element.part as usize].tree != NONE
    }

    /// Returns, by tree, whether it has a damping that an integrator takes late.
    pub(crate) fn damped(&self, late: Late) -> Vec<bool> {
        damped(self, late)
    }
}
