//! Sensors: named readings of a world.

/// A kind of sensor; its word is MJCF's.
macro_rules! sensor_types {
    ($($word:literal => $variant:ident),+ $(,)?) => {
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum SensorType {
            $($variant,)+
        }

        impl SensorType {
            pub const ALL: &'static [Self] = &[$(Self::$variant,)+];

            /// The word that data outside the engine uses for it.
            pub fn word(self) -> &'static str {
                match self {
                    $(Self::$variant => $word,)+
                }
            }
        }
    };
}
sensor_types! {
    "touch" => Touch,
    "accelerometer" => Accelerometer,
    "velocimeter" => Velocimeter,
    "gyro" => Gyro,
    "force" => Force,
    "torque" => Torque,
    "magnetometer" => Magnetometer,
    "rangefinder" => Rangefinder,
    "jointpos" => JointPos,
    "jointvel" => JointVel,
    "tendonpos" => TendonPos,
    "tendonvel" => TendonVel,
    "tendonactuatorfrc" => TendonActuatorFrc,
    "tendonlimitpos" => TendonLimitPos,
    "tendonlimitvel" => TendonLimitVel,
    "tendonlimitfrc" => TendonLimitFrc,
    "actuatorpos" => ActuatorPos,
    "actuatorvel" => ActuatorVel,
    "actuatorfrc" => ActuatorFrc,
    "jointactuatorfrc" => JointActuatorFrc,
    "ballquat" => BallQuat,
    "ballangvel" => BallAngVel,
    "jointlimitpos" => JointLimitPos,
    "jointlimitvel" => JointLimitVel,
    "jointlimitfrc" => JointLimitFrc,
    "framepos" => FramePos,
    "framequat" => FrameQuat,
    "framexaxis" => FrameXAxis,
    "frameyaxis" => FrameYAxis,
    "framezaxis" => FrameZAxis,
    "framelinvel" => FrameLinVel,
    "frameangvel" => FrameAngVel,
    "framelinacc" => FrameLinAcc,
    "frameangacc" => FrameAngAcc,
    "subtreecom" => SubtreeCom,
    "subtreelinvel" => SubtreeLinVel,
    "subtreeangmom" => SubtreeAngMom,
    "insidesite" => InsideSite,
    "distance" => Distance,
    "normal" => Normal,
    "fromto" => FromTo,
    "contact" => Contact,
    "e_potential" => PotentialEnergy,
    "e_kinetic" => KineticEnergy,
    "clock" => Clock,
    "user" => User,
}

/// The type of object that a sensor measures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObjectType {
    /// A body's centre of mass and principal axes; for contacts, the geoms of a body.
    Body,
    /// A body's frame; for contacts, a body and all that hangs on it.
    XBody,
    Geom,
    Site,
    Joint,
    Tendon,
    Actuator,
}

/// An object by its place in the list of its type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SensorObject {
    pub kind: ObjectType,
    pub index: usize,
}

/// A quantity of a contact or of a ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SensorField {
    Found,
    Force,
    Torque,
    Dist,
    Dir,
    Origin,
    Point,
    Pos,
    Normal,
    Tangent,
    Depth,
    LinVel,
    AngVel,
}

impl SensorField {
    pub fn size(self) -> usize {
        match self {
            Self::Found | Self::Dist | Self::Depth => 1,
            _ => 3,
        }
    }
}

/// Which of the matching contacts are reported.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Reduce {
    #[default]
    None,
    MinDist,
    MaxForce,
    NetForce,
}

/// A named reading of a world. It changes nothing.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensor {
    pub name: String,
    pub kind: SensorType,
    pub object: Option<SensorObject>,
    /// The frame that it is measured in, the second of two objects, or the volume.
    pub reference: Option<SensorObject>,
    /// Bound of the absolute value, if positive; for distances the search range.
    pub cutoff: f64,
    /// For a contact or a rangefinder, in the order of the data.
    pub data: Vec<SensorField>,
    pub reduce: Reduce,
    /// For a contact sensor: how many contacts; for a user's: how many numbers.
    pub num: usize,
}
