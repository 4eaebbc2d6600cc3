//! Sites: named frames on bodies.

/// A named frame on a body [m], w x y z.
#[derive(Clone, Debug, PartialEq)]
pub struct Site {
    pub name: String,
    pub body: usize,
    pub pos: [f64; 3],
    pub quat: [f64; 4],
}
