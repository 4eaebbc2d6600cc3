//! From a `Scene` to a `Model`: check, lay out, weigh, pair.

use super::slots::Slots;
use super::{apart, check, inertia, invweight, meshes, pairs, pose, tree, Model};
use crate::error::Result;
use crate::scene::Scene;

impl Model {
    /// Compiles a scene, or says which element cannot be compiled and why.
    pub fn compile(scene: &Scene) -> Result<Self> {
        check::scene(scene)?;
        let (geoms, assets) = meshes::placed(scene)?;
        let scene = &Scene { geoms, ..scene.clone() };
        let mut model = tree::lay_out(scene, &assets);
        pairs::planes_stand_still(&model)?;
        let aligned = inertia::weigh(scene, &assets, &mut model)?;
        let poses = pose::at_qpos0(&model.bodies);
        invweight::fill(&mut model, &poses, &aligned)?;
        let mut unions = tree::Unions::default();
        pairs::fill(scene, &mut model, &poses, &mut unions)?;
        pairs::fill_equalities(scene, &mut model, &poses, &mut unions)?;
        let tied: Vec<usize> = model.equalities.iter().flat_map(|e| [e.body1, e.body2]).collect();
        for tree in 0..model.trees.len() {
            let met = model
                .geoms
                .iter()
                .filter(|g| g.collides)
                .map(|g| g.body)
                .chain(tied.iter().copied());
            let seen = met.into_iter().any(|b| model.bodies[b].tree == tree);
            model.trees[tree].seen = seen || !model.trees[tree].slides_only;
            let ball = model.free_ball(&model.trees[tree]);
            let loose = !tied.iter().any(|b| model.bodies[*b].tree == tree);
            model.trees[tree].constant = model.trees[tree].slides_only || ball && loose;
        }
        model.slots = Slots::of(&model);
        apart::fill(&mut model);
        Ok(model)
    }
}
