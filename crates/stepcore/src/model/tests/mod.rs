//! The builder against closed forms and MuJoCo's rules; here the code that tests share.

mod coupling;
mod pairs;
mod range_separation;
mod refused;
mod weights;

use super::Model;
use crate::error::Error;
use crate::scene::{Body, Geom, GeomType, Joint, JointType, Scene};

/// A scene to which bodies are added, each with its joints and geoms.
#[derive(Clone)]
pub struct Build(pub Scene);

impl Build {
    pub fn new() -> Self {
        Self(Scene::default())
    }
    pub fn body(mut self, parent: usize, joints: &[Joint], geoms: &[Geom]) -> Self {
        let body = self.0.bodies.len();
        self.0.bodies.push(Body { parent, ..Body::default() });
        self.0.joints.extend(joints.iter().map(|j| Joint { body, ..j.clone() }));
        self.0.geoms.extend(geoms.iter().map(|g| Geom { body, ..g.clone() }));
        self
    }
    pub fn floor(mut self) -> Self {
        self.0.geoms.push(Geom { name: "floor".into(), kind: GeomType::Plane, ..Geom::default() });
        self
    }
    pub fn model(&self) -> Model {
        Model::compile(&self.0).unwrap()
    }
    pub fn error(&self) -> Error {
        Model::compile(&self.0).unwrap_err()
    }
}

pub fn joint(kind: JointType, axis: [f64; 3]) -> Joint {
    Joint { kind, axis, ..Joint::default() }
}

pub fn free() -> Joint {
    joint(JointType::Free, [0.0, 0.0, 1.0])
}

pub fn geom(kind: GeomType, size: [f64; 3]) -> Geom {
    Geom { kind, size, ..Geom::default() }
}

pub fn ball() -> Geom {
    Geom { mass: Some(1.0), ..geom(GeomType::Sphere, [0.1, 0.0, 0.0]) }
}

pub fn near(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-14 * b.abs().max(1e-300)
}
