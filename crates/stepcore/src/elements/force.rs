//! What every kind of force offers, and the list of them.
//!
//! `place` adds them up, the implicit integrators take their slopes, and the watchers read
//! their energies, their power and each element's own force: all by the list at the end of
//! this file, and none repeats a formula. A new kind of force is one file and one line there.

use super::actuator::{tensions, Actuator};
use super::applied::{BodyForce, JointForce};
use super::damper::Damper;
use super::gravity::Gravity;
use super::spring::Spring;
use super::{Element, Kind};
use crate::model::{Model, Tree};
use crate::place::Frames;
use crate::real::Real;
use crate::spatial::Force;
use crate::state::Inputs;

/// What forces depend on: a model at a state, with its inputs.
pub(crate) struct Moment<'a, R: Real> {
    pub model: &'a Model,
    pub frames: Frames<'a, R>,
    pub qpos: &'a [R],
    pub qvel: &'a [R],
    pub inputs: &'a Inputs<R>,
}

/// Where forces are added up.
pub(crate) struct Sum<'a, R: Real> {
    /// By dof [N or N·m].
    pub force: &'a mut [R],
    /// By body: working space.
    pub wrench: &'a mut [Force<R>],
}

/// Who makes a force, and which integrators take its damping at the end of the step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Group {
    /// Joints themselves: `euler` and `implicitfast`.
    Passive,
    /// Actuators and what the user applies: `implicitfast`.
    Driven,
    /// The weight, which the bias forces hold already.
    Weight,
}

/// One kind of force.
pub(crate) trait Forces {
    const KIND: Kind;
    const GROUP: Group;

    /// How many there are: its elements stand in some list of the model.
    #[inline(always)]
    fn count(model: &Model) -> usize {
        model.count(Self::KIND)
    }

    fn element(index: usize) -> Element {
        Element::whole(Self::KIND, index)
    }

    /// Calls `add(dof, force)` for every dof that one element pushes on [N or N·m].
    fn force<R: Real>(now: &Moment<R>, index: usize, add: &mut impl FnMut(usize, R));

    /// Adds the forces of all its elements.
    #[inline(always)]
    fn push<R: Real>(now: &Moment<R>, sum: &mut Sum<R>) {
        for index in 0..Self::count(now.model) {
            Self::force(now, index, &mut |dof, force| sum.force[dof] += force);
        }
    }

    /// Calls `add(dof, [stiffness, damping])`: minus the derivatives of the force on a dof by
    /// its own position and velocity. Nothing where both are zero.
    #[inline(always)]
    fn slopes<R: Real>(_: &Moment<R>, _index: usize, _add: &mut impl FnMut(usize, [R; 2])) {}

    /// The first of the dofs of a tree that one element damps, if it damps at all.
    fn damps(_: &Model, _index: usize) -> Option<usize> {
        None
    }

    /// Calls `add(dof, damping)` for the dofs that one element damps.
    #[inline(always)]
    fn damping<R: Real>(now: &Moment<R>, index: usize, add: &mut impl FnMut(usize, R)) {
        if Self::damps(now.model, index).is_some() {
            Self::slopes(now, index, &mut |dof, [_, damping]| add(dof, damping));
        }
    }

    /// Calls `add` for every part of what one element stores at the positions at hand [J].
    #[inline(always)]
    fn stored<R: Real>(_: &Moment<R>, _index: usize, _add: &mut impl FnMut(R)) {}

    /// Calls `add` for every part of the power that one element puts in from outside while
    /// dofs move at `velocity` [W].
    #[inline(always)]
    fn power<R: Real>(
        _: &Moment<R>,
        _index: usize,
        _velocity: &impl Fn(usize) -> R,
        _add: &mut impl FnMut(R),
    ) {
    }

    /// How strongly one element acts in a lane: Q²/M, the rate at which a force Q speeds up the
    /// inertia M that it acts on [W/s], whatever its unit. `inertia`: by dof.
    fn strength<R: Real>(
        now: &Moment<R>,
        index: usize,
        lane: usize,
        inertia: &dyn Fn(usize) -> f64,
    ) -> f64 {
        let mut sum = 0.0;
        Self::force(now, index, &mut |dof, force| {
            sum += force.lane(lane).powi(2) / inertia(dof);
        });
        sum
    }
}

macro_rules! forces {
    ($($kind:ident),+ $(,)?) => {
        /// Adds up the forces of a group.
        #[inline(always)]
        pub(crate) fn push<R: Real>(now: &Moment<R>, group: Group, sum: &mut Sum<R>) {
            $(if $kind::GROUP == group {
                $kind::push(now, sum);
            })+
        }

        /// Calls `add(element, dof, [stiffness, damping])` for the elements of a group.
        #[inline(always)]
        pub(crate) fn slopes<R: Real>(
            now: &Moment<R>,
            group: Group,
            mut add: impl FnMut(Element, usize, [R; 2]),
        ) {
            $(if $kind::GROUP == group {
                for index in 0..$kind::count(now.model) {
                    let element = $kind::element(index);
                    $kind::slopes(now, index, &mut |dof, slopes| add(element, dof, slopes));
                }
            })+
        }

        /// Calls `add(dof, damping)` for the elements of a group.
        #[inline(always)]
        pub(crate) fn damping<R: Real>(
            now: &Moment<R>,
            group: Group,
            mut add: impl FnMut(usize, R),
        ) {
            $(if $kind::GROUP == group {
                for index in 0..$kind::count(now.model) {
                    $kind::damping(now, index, &mut add);
                }
            })+
        }

        /// Some element of the group damps a dof of the tree.
        fn damped(model: &Model, group: Group, tree: &Tree) -> bool {
            let inside = |dof: usize| tree.dofs.range().contains(&dof);
            $($kind::GROUP == group
                && (0..$kind::count(model))
                    .any(|index| $kind::damps(model, index).is_some_and(inside)))||+
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
            $(for index in 0..$kind::count(now.model) {
                $kind::power(now, index, &velocity, &mut |part| power += part);
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
forces!(Damper, Spring, Actuator, JointForce, BodyForce, Gravity);

/// The force of all elements of one kind on the dofs at many states [N or N·m], for kinds that
/// depend on their own joint alone: springs, dampers and actuators. None for others.
/// ctrl, qpos and qvel one state after the other.
pub fn joint_forces(
    model: &Model,
    kind: Kind,
    ctrl: &[f64],
    qpos: &[f64],
    qvel: &[f64],
) -> Option<Vec<f64>> {
    if !matches!(kind, Kind::Spring | Kind::Damper | Kind::Actuator) {
        return None;
    }
    let (mut inputs, mut tension) = (Inputs::<f64>::new(model), vec![0.0; model.actuators.len()]);
    let mut all = Vec::with_capacity(qvel.len());
    for (n, (qpos, qvel)) in qpos.chunks(model.nq).zip(qvel.chunks(model.nv)).enumerate() {
        let nu = tension.len();
        inputs.ctrl.copy_from_slice(&ctrl[n * nu..(n + 1) * nu]);
        tensions(model, qpos, qvel, &inputs, &mut tension);
        let frames = Frames { xpos: &[], xmat: &[], origin: &[], motion: &[], tension: &tension };
        let now = Moment { model, frames, qpos, qvel, inputs: &inputs };
        let start = all.len();
        all.resize(start + model.nv, 0.0);
        let mut add = |dof: usize, force: f64| all[start + dof] += force;
        for index in 0..model.count(kind) {
            match kind {
                Kind::Spring => Spring::force(&now, index, &mut add),
                Kind::Damper => Damper::force(&now, index, &mut add),
                _ => Actuator::force(&now, index, &mut add),
            }
        }
    }
    Some(all)
}

impl Model {
    /// A joint of the tree is damped.
    pub fn damped(&self, tree: &Tree) -> bool {
        damped(self, Group::Passive, tree)
    }

    /// A servo damps the tree.
    pub fn served(&self, tree: &Tree) -> bool {
        damped(self, Group::Driven, tree)
    }
}
