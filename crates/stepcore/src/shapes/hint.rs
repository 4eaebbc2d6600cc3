//! What a pair of convex shapes may try first, from the step before.

use crate::spatial::V3;

/// Whatever stands here, contacts are the same to the bit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hint {
    /// The direction along which the two were furthest apart or proven to be apart, in the world's axes
    /// and of any length; 0: none.
    pub axis: V3<f64>,
    /// A face fixed it.
    pub face: bool,
    /// Of polytopes that overlapped what proved the shortest way out.
    pub shell: Option<Box<Shell>>,
}

/// A polytope inside the difference of two shapes, around the origin: its surface, of corners by the
/// pieces of the two that they are of, so that it can be laid anew where these have moved.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shell {
    pub corners: Vec<[u32; 2]>,
    /// Of each face its corners, and the faces across its edges.
    pub faces: Vec<[[u16; 3]; 2]>,
}

/// Where the shell of a search may be kept.
pub type Kept<'a> = Option<&'a mut Option<Box<Shell>>>;

room!(Hint: axis, face, shell);
room!(Shell: corners, faces);

impl Shell {
    pub fn is_empty(&self) -> bool {
        self.faces.is_empty()
    }

    pub fn clear(&mut self) {
        self.corners.clear();
        self.faces.clear();
    }
}
