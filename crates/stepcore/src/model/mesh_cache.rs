//! Measured meshes, kept for the next compilation of any scene that has them.
//!
//! Hulls take most of the time of compiling a robot, and measurements compile the same robot with
//! other numbers some hundred times. A mesh is known again by its content, so what is kept is to
//! the bit what would be measured anew.

use super::lru::Lru;
use super::meshes::Measured;
use crate::pool::lock;
use crate::scene::Mesh;
use std::sync::Mutex;

/// The most vertices and faces that are kept of all meshes together: some 100 MB with their hulls.
const MOST: usize = 1 << 20;

static KEPT: Mutex<Lru<Mesh, Measured>> = Mutex::new(Lru::new(MOST, size));

/// What was measured of a mesh with this content, if it is still kept.
pub fn recalled(mesh: &Mesh) -> Option<Measured> {
    lock(&KEPT).recalled(|other| same(other, mesh))
}

/// Keeps what was measured of a mesh.
pub fn keep(mesh: &Mesh, measured: &Measured) {
    lock(&KEPT).keep(mesh.clone(), measured.clone(), same);
}

fn size(mesh: &Mesh) -> usize {
    mesh.vertices.len() + mesh.faces.len()
}

/// All that is measured depends on, to the bit (0 is not −0); the name is not.
fn same(a: &Mesh, b: &Mesh) -> bool {
    let bits = |v: &[f64; 3]| v.map(f64::to_bits);
    a.inertia == b.inertia
        && a.maxhullvert == b.maxhullvert
        && a.vertices.len() == b.vertices.len()
        && a.faces == b.faces
        && a.vertices.iter().map(bits).eq(b.vertices.iter().map(bits))
}

#[cfg(test)]
mod tests {
    use super::super::meshes::placed;
    use super::*;
    use crate::scene::{Geom, GeomType, MeshInertia, Scene};
    use std::sync::Arc;

    fn cube(half: f64) -> Mesh {
        let corner = |i: usize| std::array::from_fn(|k| if i >> k & 1 == 1 { half } else { -half });
        Mesh { vertices: Arc::new((0..8).map(corner).collect()), ..Mesh::default() }
    }

    fn hull_of(mesh: Mesh) -> Arc<crate::shapes::hull::Hull> {
        let geom = Geom { kind: GeomType::Mesh, mesh: Some(0), contype: 1, ..Geom::default() };
        let scene = Scene { meshes: vec![mesh], geoms: vec![geom], ..Scene::default() };
        placed(&scene).unwrap().1[0].hull.clone().unwrap()
    }

    #[test]
    fn the_same_content_is_the_same_hull_and_any_other_bit_is_another() {
        let first = hull_of(cube(0.731));
        let renamed = Mesh { name: "other".into(), ..cube(0.731) };
        assert!(Arc::ptr_eq(&first, &hull_of(renamed)));
        let next = f64::from_bits(0.731_f64.to_bits() + 1);
        assert!(!Arc::ptr_eq(&first, &hull_of(cube(next))));
        let shell = Mesh { inertia: MeshInertia::Shell, ..cube(0.731) };
        assert!(!Arc::ptr_eq(&first, &hull_of(shell)));
        let fewer = hull_of(Mesh { maxhullvert: Some(4), ..cube(0.731) });
        assert_eq!((first.vertices.len(), fewer.vertices.len()), (8, 4));
    }
}
