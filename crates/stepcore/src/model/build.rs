//! From a `Scene` to a `Model`: check, lay out, weigh, pair.

use super::parts::Slots;
use super::{
    at_qpos0, body_pairs, check, coupling, dynamic_pairs, equalities, fluid, inertia, invweight,
    linkages, memory, meshes, pairs, plane, range_separation, tendons, tree, Model,
};
use crate::elements::actuator::drive;
use crate::elements::constraints::makers;
use crate::elements::friction_loss::rubbing;
use crate::elements::limit::limited;
use crate::error::Result;
use crate::plan::acting::Acting;
use crate::scene::Scene;

impl Model {
    /// Compiles a scene, or returns an error that names the element and the reason.
    pub fn compile(scene: &Scene) -> Result<Self> {
        Self::compiled(scene, dynamic_pairs::most_fixed)
    }

    /// The same, with at most `most_fixed` pairs listed: see `dynamic_pairs.rs`.
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
        // Each call needs the results of the calls above it; the comments name most of them.
        let (aligned, axes) = inertia::weigh(scene, &assets, &mut model)?;
        let poses = at_qpos0::poses(&model.bodies);
        tendons::compile(scene, &mut model); // masses
        at_qpos0::measure_tendons(&mut model);
        linkages::compile(scene, &mut model); // tendons, whose arms stand first
        linkages::reflect(&mut model);
        invweight::weigh(scene, &mut model, &aligned)?; // armatures of actuators; arms at qpos0
        invweight::spring_dampers(scene, &mut model); // inverse weights; dampings of actuators
        model.fluid = fluid::of_bodies(scene, &axes, &model.bodies, &model.geoms);
        let mut unions = tree::Unions::default();
        let most = most_fixed(&model);
        if !pairs::list(scene, &mut model, &poses, &mut unions, most)? {
            model.dynamic_pairs = Some(dynamic_pairs::of_geoms(scene, &mut model, &poses)?);
        }
        equalities::compile(scene, &mut model, &poses, &mut unions); // lengths and weights at qpos0
        tree::mark(&mut model); // pairs, tendons that equalities use
        model.drives = model.actuators.iter().map(|own| drive(&model, own)).collect();
        model.acting = Acting::of(&model); // drives
        plane::find(&mut model, &poses); // trees that are constant
        coupling::close(&mut model); // what acts; lists of pairs, tendons and equalities
        model.slots = Slots::of(&model);
        range_separation::prove(&mut model); // pairs
        (model.spheres, model.body_pairs) = body_pairs::of_pairs(&model); // who is apart
        model.places = model.find_places(); // trees that are seen, planes
        model.limited = limited(&model); // closed lists
        model.rubbing = rubbing(&model);
        model.makers = makers(&model);
        Ok(model)
    }
}
