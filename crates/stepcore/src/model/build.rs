//! From a `Scene` to a `Model`: check, lay out, weigh, pair.

use super::slots::Slots;
use super::{
    at_qpos0, auto_spring, body_pairs, check, coupling, dynamic_pairs, equalities, fluid, inertia,
    invweight, linkages, memory, meshes, pairs, plane, pose, range_separation, tendons, tree,
    Model, NONE,
};
use crate::elements::actuator::drive;
use crate::elements::constraints::makers;
use crate::elements::friction_loss::rubbing;
use crate::elements::limit::limited;
use crate::error::Result;
use crate::plan::acting::Acting;
use crate::scene::Scene;

impl Model {
    /// Compiles a scene, or says which element cannot be compiled and why.
    pub fn compile(scene: &Scene) -> Result<Self> {
        Self::compiled(scene, dynamic_pairs::most_fixed)
    }

    /// The same, where up to so many pairs are listed: see `dynamic_pairs.rs`.
    pub fn compile_with(scene: &Scene, most_fixed: usize) -> Result<Self> {
        Self::compiled(scene, |_| most_fixed)
    }

    fn compiled(scene: &Scene, most_fixed: impl Fn(&Self) -> usize) -> Result<Self> {
        check::scene(scene)?;
        crate::sensors::check::sensors(scene)?;
        memory::check_scene(scene)?;
        let (geoms, assets) = meshes::placed(scene)?;
        let scene = &Scene { geoms, ..scene.clone() };
        let mut model = tree::lay_out(scene, &assets);
        pairs::planes_stand_still(&model)?;
        let (aligned, axes) = inertia::weigh(scene, &assets, &mut model)?;
        let poses = pose::at_qpos0(&model.bodies);
        tendons::fill(scene, &mut model);
        at_qpos0::measure_tendons(&mut model);
        linkages::fill(scene, &mut model);
        linkages::reflect(&mut model);
        invweight::fill(scene, &mut model, &aligned)?;
        auto_spring::fill(scene, &mut model);
        fluid::fill(scene, &axes, &mut model);
        let mut unions = tree::Unions::default();
        let most = most_fixed(&model);
        if !pairs::fill(scene, &mut model, &poses, &mut unions, most)? {
            dynamic_pairs::fill(scene, &mut model, &poses)?;
        }
        equalities::fill(scene, &mut model, &poses, &mut unions);
        let tied: Vec<usize> = model.equalities.iter().flat_map(|e| e.placed()).collect();
        let met = model.geoms.iter().filter(|g| g.collides).map(|g| g.body);
        let (met, passed) = (trees_of(&model, met), model.passed_by_tendons());
        let linked = model.passed_by_linkages();
        let tied = trees_of(&model, tied.into_iter());
        let weighted = model.weighted_by_tendons();
        for tree in 0..model.trees.len() {
            let turns = !model.trees[tree].slides_only;
            model.trees[tree].seen =
                met[tree] || tied[tree] || passed[tree] || linked[tree] || turns;
            let ball = model.free_ball(&model.trees[tree]);
            let still = !turns || ball && !tied[tree];
            model.trees[tree].constant = still && !weighted[tree];
        }
        model.drives = model.actuators.iter().map(|own| drive(&model, own)).collect();
        model.acting = Acting::of(&model);
        plane::fill(&mut model, &poses);
        coupling::fill(&mut model);
        model.slots = Slots::of(&model);
        range_separation::fill(&mut model);
        body_pairs::fill(&mut model);
        model.places = model.find_places();
        model.limited = limited(&model);
        model.rubbing = rubbing(&model);
        model.makers = makers(&model);
        Ok(model)
    }
}

/// By tree: whether some of these bodies is in it.
fn trees_of(model: &Model, bodies: impl Iterator<Item = usize>) -> Vec<bool> {
    let mut found = vec![false; model.trees.len()];
    for tree in bodies.map(|body| model.bodies[body].tree).filter(|tree| *tree != NONE) {
        found[tree] = true;
    }
    found
}
