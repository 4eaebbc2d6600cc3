//! Sites: named frames on bodies.

use super::GeomType;

/// A named frame on a body [m], w x y z, and a volume about it, for sensors.
#[derive(Clone, Debug, PartialEq)]
pub struct Site {
    pub name: String,
    pub body: usize,
    pub pos: [f64; 3],
    pub quat: [f64; 4],
    /// A primitive with a volume, and its size as for a geom.
    pub kind: GeomType,
    pub size: [f64; 3],
}
