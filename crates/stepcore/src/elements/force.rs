//! The trait of forces, and the data that they read.

use super::activation::Activations;
use super::{Element, Kind};
use crate::model::transmission::Pulls;
use crate::model::Model;
use crate::plan::acting::{Acts, Why};
use crate::real::{Constant, Real};
use crate::spatial::{rotate, splat, Force, Motion, M3, V3};
use crate::state::Inputs;

/// The input of forces: a model at a state, with its inputs.
pub(crate) struct Moment<'a, R: Real> {
    pub model: &'a Model<R::Value>,
    pub frames: Frames<'a, R>,
    pub qpos: &'a [R],
    pub qvel: &'a [R],
    pub act: Activations<'a, R>,
    pub inputs: &'a Inputs<R>,
}

/// The part of `Placed` that exists before forces are added up, and that they read.
#[derive(Clone, Copy)]
pub(crate) struct Frames<'a, R: Real> {
    pub xpos: &'a [V3<R>],
    pub xmat: &'a [M3<R>],
    pub origin: &'a [V3<R>],
    pub motion: &'a [Motion<R>],
    /// `Placed::actuator`.
    pub tension: &'a [R],
    /// `Placed::shares`.
    pub shares: &'a [R],
    pub pulls: Pulls<'a, R>,
}

impl<R: Real> Frames<'_, R> {
    /// Centre of mass of a body in the world [m].
    #[inline(always)]
    pub fn centre(&self, model: &Model<R::Value>, body: usize) -> V3<R> {
        self.xpos[body] + rotate(&self.xmat[body], &splat(&model.bodies[body].ipos))
    }
}

/// The sums to which forces are added.
pub(crate) struct Sum<'a, R: Real> {
    /// By dof [N or N·m].
    pub force: &'a mut [R],
    /// By body: working space.
    pub wrench: &'a mut [Force<R>],
}

/// The source of a force.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Group {
    /// Springs and dampers, which act by themselves.
    Passive,
    /// Actuators and what the user applies.
    Driven,
    /// The weight, which the bias forces include already.
    Weight,
}

/// One kind of force.
pub(crate) trait Forces {
    const KIND: Kind;
    const GROUP: Group;
    /// One element that acts, as numbers that never change: its formulas read these and the state.
    type At<N: Constant>: std::fmt::Debug;
    /// Acts in joints themselves, each dof by itself: `euler` takes its damping too.
    const IN_JOINTS: bool = false;
    /// Acts only where the user applies forces.
    const APPLIED: bool = false;

    /// Returns the number of elements, which are in some list of the model.
    #[inline(always)]
    fn count(model: &Model) -> usize {
        model.count(Self::KIND)
    }

    fn element(index: usize) -> Element {
        Element::whole(Self::KIND, index)
    }

    /// Returns one of these as it acts, or why it never does.
    fn at(model: &Model, index: usize) -> Result<Self::At<f64>, Why>;

    /// Calls `add(dof, force)` for every dof that one element pushes on [N or N·m].
    fn force<R: Real>(now: &Moment<R>, at: &Self::At<R::Value>, add: &mut impl FnMut(usize, R));

    /// Adds the forces of all that act.
    #[inline(always)]
    fn push<R: Real>(now: &Moment<R>, list: &[Acts<Self::At<R::Value>>], sum: &mut Sum<R>) {
        for Acts { at, .. } in list {
            Self::force(now, at, &mut |dof, force| sum.force[dof] += force);
        }
    }

    /// Calls `add(i, j, [stiffness, damping])`: minus the derivatives of the force on dof i by the
    /// position and the velocity of dof j. An element that acts on each dof by itself has entries i = j
    /// alone. One that acts along a length has one for every pair of arms, both ways: aᵢ aⱼ times the
    /// stiffness and damping along the length (`Transmission::pairs`). None if both are zero.
    #[inline(always)]
    fn slopes<R: Real>(
        _: &Moment<R>,
        _at: &Self::At<R::Value>,
        _add: &mut dyn FnMut(usize, usize, [R; 2]),
    ) {
    }

    /// Calls `each(dof)` for every dof on which one element can have slopes, at any state.
    #[inline(always)]
    fn sloped<N: Constant>(_: &Model<N>, _at: &Self::At<N>, _each: &mut impl FnMut(usize)) {}

    /// Checks whether one element has damping, at some state.
    #[inline(always)]
    fn damps<N: Constant>(_: &Model<N>, _at: &Self::At<N>) -> bool {
        false
    }

    /// Calls `add(i, j, damping)` for the entries of one element's slopes, if it damps.
    #[inline(always)]
    fn damping<R: Real>(
        now: &Moment<R>,
        at: &Self::At<R::Value>,
        add: &mut impl FnMut(usize, usize, R),
    ) {
        if Self::damps(now.model, at) {
            Self::slopes(now, at, &mut |i, j, [_, damping]| add(i, j, damping));
        }
    }

    /// Calls `add` for the slopes of one element that hold back: a stiffness or a damping below zero is
    /// left out. `discrete` takes these, and its metric stays positive definite.
    #[inline(always)]
    fn holding<R: Real>(
        now: &Moment<R>,
        at: &Self::At<R::Value>,
        add: &mut dyn FnMut(usize, usize, [R; 2]),
    ) {
        let zero = R::zero();
        if Self::IN_JOINTS {
            Self::slopes(now, at, &mut |i, j, slopes| add(i, j, slopes.map(|x| x.max(zero))));
            return;
        }
        // The sum on the diagonal has the sign of a stiffness along a length.
        let mut sums = [zero; 2];
        Self::slopes(now, at, &mut |i, j, slopes| {
            if i == j {
                sums = [sums[0] + slopes[0], sums[1] + slopes[1]];
            }
        });
        let holds = sums.map(|sum| sum.gt(zero));
        Self::slopes(now, at, &mut |i, j, [stiffness, damping]| {
            let stiffness = R::select(holds[0], stiffness, zero);
            add(i, j, [stiffness, R::select(holds[1], damping, zero)]);
        });
    }

    /// Calls `add` for every part of the energy that one element stores at the present positions [J].
    #[inline(always)]
    fn stored<R: Real>(_: &Moment<R>, _at: &Self::At<R::Value>, _add: &mut impl FnMut(R)) {}

    /// Checks whether any of them can put power in.
    #[inline(always)]
    fn powers<R: Real>(_: &Moment<R>) -> bool {
        true
    }

    /// Calls `add` for every part of the power that one element puts in from outside while
    /// dofs move at `velocity` [W].
    #[inline(always)]
    fn power<R: Real>(
        _: &Moment<R>,
        _at: &Self::At<R::Value>,
        _velocity: &[R],
        _add: &mut impl FnMut(R),
    ) {
    }

    /// Returns how strongly one element acts in a lane: Q²/M, the rate at which a force Q speeds up the
    /// inertia M that it acts on [W/s], whatever its unit. `inertia`: by dof.
    fn strength<R: Real>(
        now: &Moment<R>,
        at: &Self::At<R::Value>,
        lane: usize,
        inertia: &dyn Fn(usize) -> f64,
    ) -> f64 {
        let mut sum = 0.0;
        Self::force(now, at, &mut |dof, force| {
            sum += force.lane(lane).powi(2) / inertia(dof);
        });
        sum
    }
}
