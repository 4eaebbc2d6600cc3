//! What every kind of force offers, and what it reads.

use super::{Element, Kind};
use crate::model::Model;
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

    /// Whether any of them can put power in.
    #[inline(always)]
    fn powers<R: Real>(_: &Moment<R>) -> bool {
        true
    }

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
