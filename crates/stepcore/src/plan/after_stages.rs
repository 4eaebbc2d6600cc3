//! The work of a step after its stages: positions, and implicit terms.

use crate::integrator::{Late, Scheme, Stages, Turning};
use crate::model::Model;
use crate::settings::Settings;

/// The operations of a step after its stages, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Commit {
    /// Damping, at the end of the step: `commit/damped.rs`.
    Damped,
    /// Only the gyroscopic forces of free bodies, there.
    Spinning,
    /// Damping, and the change of bias forces with all velocities: `commit/implicit.rs`.
    Turning,
    /// Positions, by the velocities after the step or before it.
    Positions {
        first: bool,
    },
    Activations,
    /// Past controls.
    History,
    Sleep,
}

impl Commit {
    pub fn list(model: &Model, settings: &Settings, late: &LateTrees) -> Vec<Self> {
        let scheme = settings.integrator.scheme();
        let once = scheme.stages == Stages::Start;
        let some = !(late.damped.is_empty() && late.spinning.is_empty());
        let late = match scheme.turning {
            Some(Turning::Trees) => Self::Turning,
            _ if scheme.stiffness => Self::Spinning,
            _ => Self::Damped,
        };
        let all = [
            (once && some, late),
            (once, Self::Positions { first: scheme.moves_first }),
            (once && model.na > 0, Self::Activations),
            // Adaptive steps sample controls once: `commit/within.rs`.
            (model.nhistory > 0 && settings.accuracy.0.is_none(), Self::History),
            (settings.sleep, Self::Sleep),
        ];
        all.into_iter().filter_map(|(does, commit)| does.then_some(commit)).collect()
    }
}

/// Trees whose velocities are solved for once more at the end of a step.
#[derive(Clone, Debug, Default)]
pub(crate) struct LateTrees {
    /// The elements whose damping is taken there.
    pub of: Option<Late>,
    /// The trees that are damped, or whose bias forces are taken.
    pub damped: Vec<usize>,
    /// Single free bodies whose gyroscopic force is taken.
    pub spinning: Vec<usize>,
    /// The trees of `damped` whose bias forces are taken.
    pub turning: Vec<usize>,
}

room!(LateTrees: of, damped, spinning, turning);

impl LateTrees {
    pub fn of(model: &Model, scheme: &Scheme) -> Self {
        let Some(late) = scheme.late(model.features.eulerdamp) else { return Self::default() };
        let trees = &model.trees;
        let damped = model.damped(late);
        let turns = |tree: usize| match scheme.turning {
            Some(Turning::Trees) => model.turns(&trees[tree]),
            _ => false,
        };
        let spins = |tree: usize| {
            scheme.turning == Some(Turning::FreeBodies) && model.gyroscopic(&trees[tree])
        };
        let of =
            |test: &dyn Fn(usize) -> bool| (0..trees.len()).filter(|tree| test(*tree)).collect();
        let taken =
            |tree: usize| !scheme.stiffness && (damped[tree] || turns(tree)) && !spins(tree);
        Self { of: Some(late), damped: of(&taken), spinning: of(&spins), turning: of(&turns) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Body, Geom, Joint, Scene};
    use crate::settings::Integrator;

    /// A step does after its stages only what the scene and the settings contain.
    #[test]
    fn what_is_absent_is_not_in_the_list() {
        let mut scene = Scene::default();
        scene.bodies.push(Body::default());
        scene.joints.push(Joint { body: 1, ..Joint::default() });
        scene.geoms.push(Geom { body: 1, size: [0.1, 0.0, 0.0], ..Geom::default() });
        let list = |scene: &Scene, integrator, sleep| {
            let model = Model::compile(scene).unwrap();
            let settings = Settings { integrator, sleep, ..Settings::default() };
            let late = LateTrees::of(&model, integrator.scheme());
            Commit::list(&model, &settings, &late)
        };
        let moves = Commit::Positions { first: false };
        assert_eq!(list(&scene, Integrator::Euler, false), [moves]);
        assert!(list(&scene, Integrator::Rk4, false).is_empty());
        assert_eq!(
            list(&scene, Integrator::Implicit, true),
            [Commit::Turning, moves, Commit::Sleep]
        );
        scene.joints[0].damping[0] = 1.0;
        assert_eq!(list(&scene, Integrator::Euler, false), [Commit::Damped, moves]);
        assert_eq!(list(&scene, Integrator::Discrete, false), [moves]);
        let first = Commit::Positions { first: true };
        assert_eq!(list(&scene, Integrator::Explicit, false), [first]);
        scene.features.eulerdamp = false;
        assert_eq!(list(&scene, Integrator::Euler, false), [moves]);
    }
}
