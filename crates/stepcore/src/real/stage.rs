//! The parts of a step whose work is counted separately.

/// In the order of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Joint positions to poses.
    Kinematics,
    /// Inertia of every body and of its subtree, and the mass matrix.
    Inertia,
    /// The factors of the mass matrix.
    Factor,
    /// Velocities of bodies, and the forces that maintain them.
    Bias,
    /// Springs, dampers, actuators, applied forces.
    Forces,
    /// The velocity without constraints.
    Guess,
    /// Pairs of shapes that touch.
    Detect,
    /// Rows from contacts, limits, friction losses and equalities.
    Rows,
    /// The impulses that satisfy all rows, and the resulting velocity.
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

    /// Returns the name: one of the four stages, and its part.
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
