//! Meshes and height fields of a scene, as the user gave them.

use std::sync::Arc;

/// The method for the volume and the inertia of a mesh: MuJoCo's `mesh/inertia`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MeshInertia {
    /// From its convex hull.
    Convex,
    /// From the signed pyramids under its triangles: exact if the surface is closed.
    Exact,
    /// From the same pyramids, all counted as positive.
    #[default]
    Legacy,
    /// From its surface, as a thin shell.
    Shell,
}

/// Triangles, or the convex hull of points without triangles. Coordinates are the ones of its file
/// after scale, refpos and refquat.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    pub name: String,
    /// [m]
    pub vertices: Arc<Vec<[f64; 3]>>,
    /// Indices of vertices, counter-clockwise from outside; if empty, the hull's.
    pub faces: Arc<Vec<[usize; 3]>>,
    pub inertia: MeshInertia,
    /// The most vertices of the hull.
    pub maxhullvert: Option<usize>,
}

/// A grid of heights.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HField {
    pub name: String,
    pub nrow: usize,
    pub ncol: usize,
    /// Half sizes along x and y, height of the highest point, depth of the base [m].
    pub size: [f64; 4],
    /// Row by row from −y to y, each from −x to x, of any scale: the lowest becomes 0 and the
    /// highest `size[2]`. Constant heights become 0.
    pub data: Arc<Vec<f64>>,
}
