//! The solver, the integrator, and the terms that these take implicitly.

use super::{split, Of, Plan, Print};
use crate::integrator::{Late, Turning};
use crate::model::Model;
use crate::scene::JointType;
use crate::settings::{Law, Settings};

impl Print {
    pub(super) fn commit(&mut self, plan: &Plan, model: &Model, settings: &Settings) {
        let trees = || (0..model.trees.len()).collect::<Vec<_>>();
        let solver = settings.solver.name();
        if model.dynamic_pairs.is_some() {
            let name =
                format!("impulses: {solver} (by island of what touches, one world at a time)");
            self.does("solve", name, Of::Tree, trees());
        } else {
            let mut islands = model.islands();
            islands.sort_unstable();
            islands.dedup();
            self.does("solve", format!("impulses: {solver} (by island)"), Of::Island, islands);
        }
        if settings.law == Law::SolRef {
            let rubs = |pair: usize| model.material(&model.pairs[pair]).condim > 1;
            let [rubbing, _] = split(model.pairs.len(), rubs);
            let meet: usize =
                model.dynamic_pairs.as_ref().map_or(0, |_| model.tally().meet.values().sum());
            let count = rubbing.len().max(meet);
            let sweeps = plan.noslip;
            if sweeps > 0 {
                let plural = if sweeps > 1 { "s" } else { "" };
                let name = format!("noslip: {sweeps} sweep{plural} over friction");
                // Friction losses are swept, too.
                let swept = count + model.rubbing.len();
                self.does("solve", name, Of::Pair, rubbing.clone()).counting(swept);
            }
            if settings.stiction {
                let name = "stiction: friction held by a spring";
                self.does("solve", name, Of::Pair, rubbing).counting(count);
            }
        }
        if plan.sleeps {
            self.does("solve", "sleep: islands at rest make no rows", Of::Tree, trees());
        }
        let joints = (0..model.joints.len()).collect();
        let name = format!("integrator: {} (by joint)", settings.integrator.name());
        self.does("commit", name, Of::Joint, joints);
        if !plan.warm_start {
            self.omits("solve", "warm start", Of::Tree, vec![], "switched off").counting(1);
        }
        self.implicit(plan, model, settings.integrator.name());
        let turns =
            |joint: usize| matches!(model.joints[joint].kind, JointType::Ball | JointType::Free);
        let [have, lack] = split(model.joints.len(), turns);
        self.does("commit", "quaternions", Of::Joint, have);
        self.omits("commit", "quaternions", Of::Joint, lack, "slides and hinges have none");
        let sensors = (0..model.sensors.len()).collect();
        let why = "computed when they are read, never in a step";
        self.omits("commit", "sensors", Of::Sensor, sensors, why);
    }

    fn implicit(&mut self, Plan { scheme, late, .. }: &Plan, model: &Model, integrator: &str) {
        let on = &model.features;
        let by_tree = |flags: Vec<bool>| split(flags.len(), |tree| flags[tree]);
        let name = "implicit damping (by tree)";
        if scheme.stiffness {
            let [have, lack] = by_tree(model.sloped());
            let name = "implicit stiffness and damping (by tree)";
            self.does("place", name, Of::Tree, have);
            self.omits("place", name, Of::Tree, lack, "nothing is stiff or damped");
        } else if let Some(of) = late.of {
            let [have, lack] = by_tree(model.damped(of));
            self.does("commit", name, Of::Tree, have);
            self.omits("commit", name, Of::Tree, lack, "nothing is damped");
        } else {
            let [have, _] = by_tree(model.damped(Late::Joints));
            let why = match scheme.damping {
                None => format!("{integrator} treats damping explicitly"),
                Some(_) => "switched off (eulerdamp)".into(),
            };
            self.omits("commit", name, Of::Tree, have, why);
        }
        let trees = &model.trees;
        if scheme.turning == Some(Turning::Trees) {
            let [have, lack] = split(trees.len(), |tree| model.turns(&trees[tree]));
            let name = "derivative of the bias forces (by tree)";
            self.does("commit", name, Of::Tree, have);
            let why = if on.coriolis { "constant" } else { "switched off" };
            self.omits("commit", name, Of::Tree, lack, why);
        }
        if scheme.turning == Some(Turning::FreeBodies) {
            let [free, _] = split(trees.len(), |tree| model.free_alone(&trees[tree]));
            let (turns, lack): (Vec<usize>, Vec<usize>) =
                free.into_iter().partition(|tree| model.gyroscopic(&trees[*tree]));
            let name = "gyroscopic derivative (by free body)";
            self.does("commit", name, Of::Tree, turns);
            let why = if on.coriolis { "isotropic" } else { "switched off" };
            self.omits("commit", name, Of::Tree, lack, why);
        }
    }
}
