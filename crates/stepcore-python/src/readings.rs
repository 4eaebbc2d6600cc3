//! What is read of bodies and rays, as plain numbers in MuJoCo's order: angular before linear.

use stepcore::real::Real;
use stepcore::sim::Sim;
use stepcore::spatial::V3;
use stepcore::watch::{first_hit, tendon_path, Bodies, BodyForces, RayFilter, Way};

use crate::world::{BodyForce, Placed};

/// By ray: distance in lengths of its direction and index of the geom, −1 where it meets none; the
/// surface's outward normal, then zero.
#[derive(Default)]
pub struct Rays {
    pub dist: Vec<f64>,
    pub geom: Vec<i64>,
    pub normal: Vec<f64>,
}

/// A vector of the first lane.
pub fn flat<R: Real>(v: &V3<R>) -> [f64; 3] {
    [v.x.lane(0), v.y.lane(0), v.z.lane(0)]
}

fn six(ang: &V3<f64>, lin: &V3<f64>) -> [f64; 6] {
    [ang.x, ang.y, ang.z, lin.x, lin.y, lin.z]
}

/// Of the quantities about centres of mass, the one that is asked for.
pub fn bodies(bodies: &Bodies, what: Placed) -> Vec<f64> {
    match what {
        Placed::SubtreeCom => bodies.subtree_com.iter().flat_map(|v| [v.x, v.y, v.z]).collect(),
        Placed::Velocities => bodies.cvel.iter().flat_map(|v| six(&v.ang, &v.lin)).collect(),
        _ => {
            let ten = bodies.cinert.iter().map(|c| (c.i, c.h, c.mass));
            ten.flat_map(|(i, h, mass)| [i.as_slice(), &[h.x, h.y, h.z, mass]].concat()).collect()
        }
    }
}

pub fn body_force(forces: &BodyForces, what: BodyForce) -> Vec<f64> {
    match what {
        BodyForce::Acceleration => forces.cacc.iter().flat_map(|a| six(&a.ang, &a.lin)).collect(),
        BodyForce::External => forces.external.iter().flat_map(|f| six(&f.ang, &f.lin)).collect(),
        BodyForce::Internal => forces.internal.iter().flat_map(|f| six(&f.ang, &f.lin)).collect(),
    }
}

/// By stretch, the points of a tendon's way one after the other.
pub type TendonPath = Vec<Vec<f64>>;

pub fn tendon_paths<R: Real>(sim: &mut Sim<R>) -> Vec<TendonPath> {
    let (model, bodies) = (sim.model().clone(), sim.bodies(0));
    let flat = |way: &Way| way.iter().flat_map(|v| [v.x, v.y, v.z]).collect();
    let path = |tendon| tendon_path(&model, &bodies, tendon).iter().map(flat).collect();
    model.tendons.iter().map(path).collect()
}

/// Each ray is 6 numbers: where it starts, and its direction.
pub fn rays<R: Real>(sim: &mut Sim<R>, rays: &[f64], filter: &RayFilter) -> Rays {
    let model = sim.model().clone();
    let bodies = sim.bodies(0);
    let mut found = Rays::default();
    for ray in rays.chunks(6) {
        let (from, along) = (V3::from_column_slice(&ray[..3]), V3::from_column_slice(&ray[3..]));
        match first_hit(&model, &bodies, &from, &along, filter) {
            Some((geom, hit)) => {
                found.dist.push(hit.at);
                found.geom.push(geom as i64);
                found.normal.extend([hit.normal.x, hit.normal.y, hit.normal.z]);
            }
            None => {
                found.dist.push(-1.0);
                found.geom.push(-1);
                found.normal.extend([0.0; 3]);
            }
        }
    }
    found
}
