//! The parts of a step whose work is counted apart.

/// In the order in which a step comes to them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Joint positions to poses.
    Kinematics,
    /// Inertia of every body and of all that hangs on it, and the mass matrix.
    Inertia,
    /// Its factors.
    Factor,
    /// Velocities of bodies, and the forces that keep them.
    Bias,
    /// Springs, dampers, actuators, applied forces.
    Forces,
    /// The velocity if nothing were in the way.
    Guess,
    /// Pairs of shapes that touch.
    Detect,
    /// Rows out of contacts, limits, friction losses and equalities.
    Rows,
    /// The impulses on which the rows agree, and the velocity that they make.
    Impulses,
    /// The integrator.
    Commit,
}

impl Stage {
    pub const ALL: [Self; 10] = [
        Self::Kinematics,
        Self::Inertia,
        Self::Factor,
        Self::Bias,
        Self::Forces,
        Self::Guess,
        Self::Detect,
        Self::Rows,
        Self::Impulses,
        Self::Commit,
    ];

    /// One of the four stages, and its part.
    pub fn name(self) -> &'static str {
        match self {
            Self::Kinematics => "place/kinematics",
            Self::Inertia => "place/inertia",
            Self::Factor => "place/factor",
            Self::Bias => "place/bias",
            Self::Forces => "place/forces",
            Self::Guess => "place/guess",
            Self::Detect => "detect",
            Self::Rows => "solve/rows",
            Self::Impulses => "solve/impulses",
            Self::Commit => "commit",
        }
    }
}
