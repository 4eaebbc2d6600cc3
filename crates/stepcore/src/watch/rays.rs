//! Rays through a world: the geom that each meets first.

use super::bodies::Bodies;
use crate::model::{Geom, Model};
use crate::shapes::ray::{height_field, primitive, Hit, Ray};
use crate::spatial::V3;

/// The geoms that rays can meet: MuJoCo's arguments of `mj_ray`.
#[derive(Clone, Copy, Debug, Default)]
pub struct RayFilter {
    /// Geoms of this body are not seen.
    pub excluded: Option<usize>,
    /// For each group, those below 0 counting as 0 and those above 5 as 5; None sees all.
    pub groups: Option<[bool; 6]>,
    /// Geoms of bodies that are fixed to the world are not seen.
    pub moving: bool,
}

impl RayFilter {
    fn sees(&self, model: &Model, geom: &Geom) -> bool {
        let group = geom.group.clamp(0, 5) as usize;
        !geom.hidden
            && self.excluded != Some(geom.body)
            && !(self.moving && model.bodies[geom.body].weld == 0)
            && self.groups.is_none_or(|groups| groups[group])
    }
}

/// The first geom that a ray from `from` along `along` meets, with its distance in lengths of
/// `along` and the surface's outward normal in the world.
pub fn first_hit(
    model: &Model,
    bodies: &Bodies,
    from: &V3<f64>,
    along: &V3<f64>,
    filter: &RayFilter,
) -> Option<(usize, Hit)> {
    let mut first: Option<(usize, Hit)> = None;
    let geoms = model.geoms.iter().enumerate().filter(|(_, geom)| filter.sees(model, geom));
    for (index, geom) in geoms {
        let pose = bodies.pose(geom.body, &geom.pos, &geom.quat);
        let ray = Ray { from: pose.to_local(&(from - pose.pos)), along: pose.to_local(along) };
        let hit = match (&geom.surface, &geom.field) {
            (Some(surface), _) => surface.hit(&ray),
            (_, Some(field)) => height_field(field, &ray),
            _ => primitive(geom.kind, &geom.size, &ray),
        };
        if let Some(hit) = hit.filter(|hit| first.is_none_or(|(_, first)| hit.at < first.at)) {
            first = Some((index, Hit { normal: pose.to_world(&hit.normal), ..hit }));
        }
    }
    first
}
