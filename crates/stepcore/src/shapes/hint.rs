//! Results of the step before, which a pair of convex shapes tries first.

use crate::spatial::V3;

/// Contacts are the same to the bit whatever this contains.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hint {
    /// The direction along which the two were furthest apart or proven to be apart, in the world's axes
    /// and of any length; 0: none.
    pub axis: V3<f64>,
    /// A face determined the direction.
    pub face: bool,
    /// For polytopes that overlapped, the proof of the shortest way out.
    pub shell: Option<Box<Shell>>,
}

/// A polytope inside the difference of two shapes, around the origin: its surface. Its corners are
/// given by pieces of the two shapes, so that it can be placed again after these have moved.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shell {
    pub corners: Vec<[u32; 2]>,
    /// By face: its corners, and the faces across its edges.
    pub faces: Vec<[[u16; 3]; 2]>,
}

/// The place for the shell of a search, if it is kept.
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
