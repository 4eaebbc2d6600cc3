//! Measured meshes, kept for the next compilation of any scene that has them.
//!
//! Hulls take most of the time of compiling a robot, and measurements compile the same robot with
//! other numbers some hundred times. A mesh is known again by its content, so what is kept is to
//! the bit what would be measured anew.

use super::meshes::Measured;
use crate::scene::Mesh;
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The most vertices and faces that are kept of all meshes together: some 100 MB with their hulls.
const MOST: usize = 1 << 20;

/// The meshes last used, the last one at the back.
static KEPT: Mutex<Kept> = Mutex::new(Kept { entries: VecDeque::new(), size: 0 });

struct Kept {
    entries: VecDeque<(Mesh, Measured)>,
    /// Vertices and faces of all entries.
    size: usize,
}

/// What was measured of a mesh with this content, if it is still kept.
pub fn recalled(mesh: &Mesh) -> Option<Measured> {
    let mut kept = kept();
    let entry = kept.take(mesh)?;
    let measured = entry.1.clone();
    kept.put(entry);
    Some(measured)
}

/// Keeps what was measured of a mesh; those used longest ago make room.
pub fn keep(mesh: &Mesh, measured: &Measured) {
    let mut kept = kept();
    kept.take(mesh);
    kept.put((mesh.clone(), measured.clone()));
}

/// Nothing that is done under the lock can leave it half done.
fn kept() -> MutexGuard<'static, Kept> {
    KEPT.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Kept {
    fn take(&mut self, mesh: &Mesh) -> Option<(Mesh, Measured)> {
        let at = self.entries.iter().position(|(other, _)| same(other, mesh))?;
        let entry = self.entries.remove(at)?;
        self.size -= size(&entry.0);
        Some(entry)
    }

    fn put(&mut self, entry: (Mesh, Measured)) {
        self.size += size(&entry.0);
        self.entries.push_back(entry);
        while self.size > MOST {
            let Some((oldest, _)) = self.entries.pop_front() else { break };
            self.size -= size(&oldest);
        }
    }
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

    #[test]
    fn what_was_used_longest_ago_makes_room() {
        let mut kept = Kept { entries: VecDeque::new(), size: 0 };
        hull_of(cube(0.377));
        let measured = recalled(&cube(0.377)).unwrap();
        let large =
            |at: f64, count| Mesh { vertices: Arc::new(vec![[at; 3]; count]), ..Mesh::default() };
        for at in [0.0, 1.0] {
            kept.put((large(at, MOST / 2), measured.clone()));
        }
        let used = kept.take(&large(0.0, MOST / 2)).unwrap();
        kept.put(used);
        kept.put((large(2.0, 1), measured.clone()));
        assert!(kept.take(&large(1.0, MOST / 2)).is_none());
        assert!(kept.take(&large(0.0, MOST / 2)).is_some());
        assert_eq!((kept.entries.len(), kept.size), (1, 1));
        // What is too large for itself is not kept, nor anything beside it.
        kept.put((large(3.0, MOST + 1), measured));
        assert_eq!((kept.entries.len(), kept.size), (0, 0));
    }
}
