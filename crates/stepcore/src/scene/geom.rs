//! Geoms: shapes on bodies.

use super::Softness;
use crate::real::{Real, Value};

/// Shapes, in MuJoCo's order: it decides which of a pair is geom 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum GeomType {
    Plane,
    HField,
    Sphere,
    Capsule,
    Ellipsoid,
    Cylinder,
    Box,
    Mesh,
}

impl GeomType {
    /// The word that a scene uses for it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Plane => "plane",
            Self::HField => "hfield",
            Self::Sphere => "sphere",
            Self::Capsule => "capsule",
            Self::Ellipsoid => "ellipsoid",
            Self::Cylinder => "cylinder",
            Self::Box => "box",
            Self::Mesh => "mesh",
        }
    }

    /// The distance of the surface of this size from the core that it rounds off [m]: a sphere's
    /// centre, a capsule's axis.
    pub fn roundness<R: Real, N: Value<R>>(self, size: &[N; 3]) -> R {
        if matches!(self, Self::Sphere | Self::Capsule) {
            size[0].get()
        } else {
            R::zero()
        }
    }
}

/// The shape of a geom for the fluid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FluidShape {
    /// A part of its body, which is resisted as a box of the same inertia.
    None,
    /// An ellipsoid: then that box no longer counts.
    Ellipsoid,
}

/// A shape on a body: it collides, and gives mass if the body has no `Inertial`.
#[derive(Clone, Debug, PartialEq)]
pub struct Geom {
    pub name: String,
    pub body: usize,
    pub kind: GeomType,
    /// MuJoCo's sizes: sphere r; capsule and cylinder r, half length; box and
    /// ellipsoid half sizes; plane half sizes (0: infinite), spacing.
    pub size: [f64; 3],
    /// Frame in the body's [m], w x y z.
    pub pos: [f64; 3],
    pub quat: [f64; 4],
    /// Into `Scene::meshes`: its mesh, or the one a primitive is fitted to (`size` is computed).
    pub mesh: Option<usize>,
    /// For a primitive fitted to a mesh: its size relative to the fit.
    pub fitscale: f64,
    /// Into `Scene::hfields`.
    pub hfield: Option<usize>,
    /// [kg]; None: density × volume.
    pub mass: Option<f64>,
    /// [kg/m³], or [kg/m²] of a shell.
    pub density: f64,
    /// Whether the mass is on the surface.
    pub shell_inertia: bool,
    /// Whether rays pass through it.
    pub hidden: bool,
    /// Only groups in `MassRules::group_range` give mass.
    pub group: i32,
    /// Two geoms collide if one's contype shares a bit with the other's conaffinity.
    pub contype: u32,
    pub conaffinity: u32,
    /// Dimensions of a contact's force: 1 normal, 3 with sliding friction,
    /// 4 with torsion as well, 6 with rolling as well.
    pub condim: u32,
    /// The geom of higher priority decides a contact's condim, friction and softness.
    pub priority: i32,
    /// Sliding [1], torsional [m], rolling [m].
    pub friction: [f64; 3],
    /// A contact has rows below the sum of both margins [m] and is listed up to the sum of
    /// both gaps above that.
    pub margin: f64,
    pub gap: f64,
    /// The motion of its surface in contacts, in the geom's frame: a velocity [m/s], and an angular
    /// velocity about the frame's origin [rad/s].
    pub surfacevel: [f64; 6],
    /// The largest pulling force of each of its contacts [N].
    pub adhesion: f64,
    /// Weight of this geom's softness in the mixture of two.
    pub solmix: f64,
    pub soft: Softness,
    /// The resistance model of a fluid.
    pub fluidshape: FluidShape,
    /// For an ellipsoid: blunt, slender and angular drag, Kutta and Magnus lift.
    pub fluidcoef: [f64; 5],
}

impl Default for Geom {
    fn default() -> Self {
        Self {
            name: String::new(),
            body: 0,
            kind: GeomType::Sphere,
            size: [0.0; 3],
            pos: [0.0; 3],
            quat: [1.0, 0.0, 0.0, 0.0],
            mesh: None,
            fitscale: 1.0,
            hfield: None,
            mass: None,
            density: 1000.0,
            shell_inertia: false,
            hidden: false,
            group: 0,
            contype: 1,
            conaffinity: 1,
            condim: 3,
            priority: 0,
            friction: [1.0, 0.005, 0.0001],
            margin: 0.0,
            gap: 0.0,
            surfacevel: [0.0; 6],
            adhesion: 0.0,
            solmix: 1.0,
            soft: Softness::default(),
            fluidshape: FluidShape::None,
            fluidcoef: [0.5, 0.25, 1.5, 1.0, 1.0],
        }
    }
}
