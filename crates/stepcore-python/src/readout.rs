//! Quantities that Python reads of worlds by name: from the present state, or the last solve.

use pyo3::exceptions::PyAttributeError;
use pyo3::PyErr;
use stepcore::model::Model;

use crate::world::{BodyForce, Placed, Solved};

/// The source of an array.
#[derive(Clone, Copy)]
pub enum Readout {
    /// The present state.
    Placed(Placed),
    /// The last solve, which a batch repeats for it.
    Solved(Solved),
    BodyForce(BodyForce),
}

impl Readout {
    /// Finds it by its name in Python.
    pub fn named(name: &str) -> Result<Self, PyErr> {
        Ok(match name {
            "xpos" => Self::Placed(Placed::BodyPos),
            "xquat" => Self::Placed(Placed::BodyQuat),
            "xmat" => Self::Placed(Placed::BodyMat),
            "geom_xpos" => Self::Placed(Placed::GeomPos),
            "geom_xmat" => Self::Placed(Placed::GeomMat),
            "site_xpos" => Self::Placed(Placed::SitePos),
            "site_xmat" => Self::Placed(Placed::SiteMat),
            "actuator_length" => Self::Placed(Placed::ActuatorLength),
            "actuator_velocity" => Self::Placed(Placed::ActuatorVelocity),
            "ten_length" => Self::Placed(Placed::TendonLength),
            "ten_velocity" => Self::Placed(Placed::TendonVelocity),
            "ten_J" => Self::Placed(Placed::TendonJacobian),
            "ten_force" => Self::Placed(Placed::TendonForce),
            "subtree_com" => Self::Placed(Placed::SubtreeCom),
            "cinert" => Self::Placed(Placed::Inertias),
            "cvel" => Self::Placed(Placed::Velocities),
            "mass_matrix" => Self::Placed(Placed::MassMatrix),
            "bias" => Self::Placed(Placed::Bias),
            "passive" => Self::Placed(Placed::Passive),
            "energy" => Self::Placed(Placed::Energy),
            "momentum" => Self::Placed(Placed::Momentum),
            "overlap" => Self::Placed(Placed::Overlap),
            "qacc" => Self::Solved(Solved::Acceleration),
            "constraint_force" => Self::Solved(Solved::ConstraintForce),
            "actuator_force" => Self::Solved(Solved::ActuatorForce),
            "cfrc_ext" => Self::BodyForce(BodyForce::External),
            "cfrc_int" => Self::BodyForce(BodyForce::Internal),
            "cacc" => Self::BodyForce(BodyForce::Acceleration),
            _ => return Err(PyAttributeError::new_err(format!("no readout is called {name}"))),
        })
    }

    /// The shape for one world.
    pub fn shape(self, model: &Model) -> Vec<usize> {
        match self {
            Self::Placed(what) => what.shape(model),
            Self::Solved(Solved::Acceleration | Solved::ConstraintForce) => vec![model.nv],
            Self::Solved(Solved::ActuatorForce) => vec![model.actuators.len()],
            Self::BodyForce(_) => vec![model.bodies.len(), 6],
        }
    }
}

impl Placed {
    pub fn shape(self, model: &Model) -> Vec<usize> {
        let (bodies, geoms, sites) = (model.bodies.len(), model.geoms.len(), model.sites.len());
        match self {
            Self::BodyPos | Self::SubtreeCom => vec![bodies, 3],
            Self::BodyQuat => vec![bodies, 4],
            Self::BodyMat => vec![bodies, 3, 3],
            Self::Inertias => vec![bodies, 10],
            Self::Velocities => vec![bodies, 6],
            Self::GeomPos => vec![geoms, 3],
            Self::GeomMat => vec![geoms, 3, 3],
            Self::SitePos => vec![sites, 3],
            Self::SiteMat => vec![sites, 3, 3],
            Self::ActuatorLength | Self::ActuatorVelocity => vec![model.actuators.len()],
            Self::TendonLength | Self::TendonVelocity | Self::TendonForce => {
                vec![model.tendons.len()]
            }
            Self::TendonJacobian => vec![model.tendons.len(), model.nv],
            Self::MassMatrix => vec![model.nv, model.nv],
            Self::Bias | Self::Passive => vec![model.nv],
            Self::Energy => vec![2],
            Self::Momentum => vec![2, 3],
            Self::Overlap => Vec::new(),
            Self::Jacobian(_) | Self::SiteJacobian(_) | Self::PointJacobian(..) => {
                vec![6, model.nv]
            }
        }
    }
}
