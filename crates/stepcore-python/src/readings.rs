//! Quantities of a state, of bodies and of rays, as plain numbers in MuJoCo's order: angular before
//! linear.

use stepcore::error::Result;
use stepcore::real::Real;
use stepcore::sim::Sim;
use stepcore::spatial::{M3, V3};
use stepcore::watch::{first_hit, tendon_path, Bodies, BodyForces, RayFilter, Way};

use crate::world::{BodyForce, Placed};

/// For each ray: distance in lengths of its direction and index of the geom, −1 if it meets none;
/// the surface's outward normal, else zero.
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

/// The numbers of the first lane.
pub fn numbers<R: Real>(values: &[R]) -> Vec<f64> {
    values.iter().map(|x| x.lane(0)).collect()
}

fn six(ang: &V3<f64>, lin: &V3<f64>) -> [f64; 6] {
    [ang.x, ang.y, ang.z, lin.x, lin.y, lin.z]
}

/// A quantity of the present state, which `sim` has placed.
pub fn placed<R: Real>(sim: &mut Sim<R>, what: Placed) -> Result<Vec<f64>> {
    let model = sim.model().clone();
    let matrix = |m: &M3<R>| m.transpose().iter().map(|x| x.lane(0)).collect::<Vec<_>>();
    Ok(match what {
        Placed::BodyPos => sim.placed.xpos.iter().flat_map(flat).collect(),
        Placed::BodyQuat => sim
            .placed
            .xquat
            .iter()
            .flat_map(|q| [q.w, q.v.x, q.v.y, q.v.z].map(|x| x.lane(0)))
            .collect(),
        Placed::BodyMat => sim.placed.xmat.iter().flat_map(matrix).collect(),
        Placed::GeomPos => model
            .geoms
            .iter()
            .flat_map(|g| flat(&sim.attached(g.body, &g.pos, &g.quat).0))
            .collect(),
        Placed::GeomMat => model
            .geoms
            .iter()
            .flat_map(|g| matrix(&sim.attached(g.body, &g.pos, &g.quat).1))
            .collect(),
        Placed::SitePos => model
            .sites
            .iter()
            .flat_map(|s| flat(&sim.attached(s.body, &s.pos, &s.quat).0))
            .collect(),
        Placed::ActuatorLength => sim.actuator_length(0),
        Placed::ActuatorVelocity => {
            (0..model.actuators.len()).map(|index| sim.actuator_velocity(index, 0)).collect()
        }
        Placed::TendonLength => numbers(&sim.placed.tendon_length[..model.tendons.len()]),
        Placed::TendonVelocity => numbers(&sim.tendon_velocity()),
        Placed::TendonJacobian => sim.tendon_jacobian(0)?,
        Placed::TendonForce => numbers(&sim.tendon_force()),
        Placed::SiteMat => model
            .sites
            .iter()
            .flat_map(|s| matrix(&sim.attached(s.body, &s.pos, &s.quat).1))
            .collect(),
        Placed::SubtreeCom | Placed::Inertias | Placed::Velocities => bodies(&sim.bodies(0), what),
        Placed::MassMatrix => sim.mass_matrix(0)?,
        Placed::Bias => numbers(&sim.placed.bias),
        Placed::Passive => {
            sim.add_forces_through_contacts();
            numbers(&sim.placed.passive)
        }
        Placed::Energy => {
            let energy = sim.energy();
            vec![energy.kinetic.lane(0), energy.potential.lane(0)]
        }
        Placed::Momentum => {
            let momentum = sim.momentum();
            [flat(&momentum.lin), flat(&momentum.ang)].concat()
        }
        Placed::Overlap => vec![sim.overlap().lane(0)],
        Placed::Jacobian(body) => sim.jacobian(body, 0),
        Placed::SiteJacobian(site) => {
            let site = &model.sites[site];
            let (point, _) = sim.attached(site.body, &site.pos, &site.quat);
            sim.jacobian_at(site.body, &point, 0)
        }
        Placed::PointJacobian(body, point) => sim.jacobian_at(body, &V3::from(point.map(R::of)), 0),
    })
}

/// The requested one of the quantities about centres of mass.
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

/// For each stretch, the points of a tendon's path one after the other.
pub type TendonPath = Vec<Vec<f64>>;

pub fn tendon_paths<R: Real>(sim: &mut Sim<R>) -> Vec<TendonPath> {
    let (model, bodies) = (sim.model().clone(), sim.bodies(0));
    let flat = |way: &Way| way.iter().flat_map(|v| [v.x, v.y, v.z]).collect();
    let path = |tendon| tendon_path(&model, &bodies, tendon).iter().map(flat).collect();
    model.tendons.iter().map(path).collect()
}

/// Each ray is 6 numbers: its origin and its direction.
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
