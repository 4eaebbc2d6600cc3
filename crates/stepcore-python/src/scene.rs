//! Reads the engine's scene from the dict that `stepcore.Scene.to_dict` makes.

use pyo3::prelude::*;
use stepcore::scene::{
    Actuator, Body, ContactOverride, Controller, Dynamics, Equality, EqualityType, ExplicitPair,
    Features, FluidShape, Frame, Geom, GeomType, HField, Inertial, Input, Interp, Joint, JointType,
    Key, MassRules, Mesh, MeshInertia, Motor, Muscle, ObjectType, Orientation, Reduce, Scene,
    Sensor, SensorField, SensorObject, SensorType, Site, SleepPolicy, Softness, Stop, Target,
    Tendon,
};

use crate::extract::{record, refuse, At, Read, Record};

/// An enum by its name.
macro_rules! named {
    ($type:ty { $($text:literal => $variant:ident),+ $(,)? }) => {
        impl Read for $type {
            fn read(value: &Bound<'_, PyAny>, at: &At) -> PyResult<Self> {
                match String::read(value, at)?.as_str() {
                    $($text => Ok(Self::$variant),)+
                    _ => Err(refuse(value, at, concat!("one of", $(" ", $text),+))),
                }
            }
        }
    };
}
named!(JointType { "free" => Free, "ball" => Ball, "slide" => Slide, "hinge" => Hinge });
named!(SleepPolicy { "auto" => Auto, "never" => Never, "allowed" => Allowed, "init" => Init });
named!(GeomType {
    "plane" => Plane, "hfield" => HField, "sphere" => Sphere, "capsule" => Capsule,
    "ellipsoid" => Ellipsoid, "cylinder" => Cylinder, "box" => Box, "mesh" => Mesh,
});
named!(EqualityType { "connect" => Connect, "weld" => Weld, "joint" => Joint, "tendon" => Tendon });
named!(FluidShape { "none" => None, "ellipsoid" => Ellipsoid });
named!(MeshInertia {
    "convex" => Convex, "exact" => Exact, "legacy" => Legacy, "shell" => Shell,
});
named!(Dynamics {
    "none" => None, "integrator" => Integrator, "filter" => Filter, "filterexact" => FilterExact,
    "muscle" => Muscle,
});

/// Distinguished by the field that is present.
impl Read for Stop {
    fn read(value: &Bound<'_, PyAny>, at: &At) -> PyResult<Self> {
        let has = |field: &str| value.contains(field).unwrap_or(false);
        let of = |fields: &[&str]| Record::new(value, at, fields);
        if has("joint") {
            let record = of(&["joint", "coef"])?;
            return Ok(Self::Joint { joint: record.field("joint")?, coef: record.field("coef")? });
        }
        if has("geom") {
            let record = of(&["geom", "side"])?;
            return Ok(Self::Geom { geom: record.field("geom")?, side: record.field("side")? });
        }
        if has("divisor") {
            return Ok(Self::Pulley { divisor: of(&["divisor"])?.field("divisor")? });
        }
        Ok(Self::Site { site: of(&["site"])?.field("site")? })
    }
}

named!(ObjectType {
    "body" => Body, "xbody" => XBody, "geom" => Geom, "site" => Site, "joint" => Joint,
    "tendon" => Tendon, "actuator" => Actuator,
});
named!(SensorField {
    "found" => Found, "force" => Force, "torque" => Torque, "dist" => Dist, "dir" => Dir,
    "origin" => Origin, "point" => Point, "pos" => Pos, "normal" => Normal,
    "tangent" => Tangent, "depth" => Depth, "linvel" => LinVel, "angvel" => AngVel,
});
named!(Input {
    "pos" => Pos, "vel" => Vel, "ff" => Ff, "voltage" => Voltage,
    "x" => X, "y" => Y, "z" => Z, "w" => W,
});
named!(Interp { "zoh" => Hold, "linear" => Linear, "cubic" => Cubic });
named!(Reduce {
    "none" => None, "mindist" => MinDist, "maxforce" => MaxForce, "netforce" => NetForce,
});

impl Read for SensorType {
    fn read(value: &Bound<'_, PyAny>, at: &At) -> PyResult<Self> {
        let word = String::read(value, at)?;
        let known = Self::ALL.iter().copied();
        let mut named = known.clone().filter(|kind| kind.word() == word);
        named.next().ok_or_else(|| {
            let words: Vec<_> = known.map(Self::word).collect();
            refuse(value, at, &format!("one of {}", words.join(" ")))
        })
    }
}

/// Distinguished by the field that is present.
impl Read for Target {
    fn read(value: &Bound<'_, PyAny>, at: &At) -> PyResult<Self> {
        let has = |field: &str| value.contains(field).unwrap_or(false);
        let of = |fields: &[&str]| Record::new(value, at, fields);
        if has("jointinparent") {
            return Ok(Self::InParent(of(&["jointinparent"])?.field("jointinparent")?));
        }
        if has("tendon") {
            return Ok(Self::Tendon(of(&["tendon"])?.field("tendon")?));
        }
        if has("site") {
            let record = of(&["site", "refsite"])?;
            let (site, reference) = (record.field("site")?, record.field("refsite")?);
            return Ok(Self::Site { site, reference });
        }
        if has("body") {
            return Ok(Self::Body(of(&["body"])?.field("body")?));
        }
        if has("cranksite") {
            let record = of(&["cranksite", "slidersite", "cranklength"])?;
            let (crank, slider) = (record.field("cranksite")?, record.field("slidersite")?);
            return Ok(Self::Crank { crank, slider, rod: record.field("cranklength")? });
        }
        Ok(Self::Joint(of(&["joint"])?.field("joint")?))
    }
}

record!(Softness { solref, solimp });
record!(Inertial { mass, pos, inertia, axes });
record!(Body { name, parent, pos, quat, inertial, gravcomp, mocap, sleep });
record!(Joint {
    name,
    body,
    kind,
    pos,
    axis,
    range,
    margin,
    reference,
    springref,
    stiffness,
    damping,
    springdamper,
    actuatorgravcomp,
    armature,
    actuatorfrcrange,
    frictionloss,
    limit,
    friction,
});
record!(Geom {
    name,
    body,
    kind,
    size,
    pos,
    quat,
    mesh,
    fitscale,
    hfield,
    mass,
    density,
    shell_inertia,
    group,
    hidden,
    contype,
    conaffinity,
    condim,
    priority,
    friction,
    margin,
    gap,
    surfacevel,
    adhesion,
    solmix,
    soft,
    fluidshape,
    fluidcoef,
});
record!(Mesh { name, vertices, faces, inertia, maxhullvert });
record!(HField { name, nrow, ncol, size, data });
record!(Tendon {
    name,
    path,
    range,
    margin,
    springlength,
    stiffness,
    damping,
    armature,
    frictionloss,
    actuatorfrcrange,
    limit,
    friction,
});
record!(Site { name, body, pos, quat, kind, size });
record!(SensorObject { kind, index });
record!(Sensor { name, kind, object, reference, cutoff, data, reduce, num });
record!(Muscle { range, force, scale, lmin, lmax, vmax, fpmax, fvmax });
record!(Motor { constant, resistance, inductance, vmax, current_rate, thermal, cogging, lugre });
record!(Controller { ki, imax, slewmax, motor });
record!(Orientation { axis, quat });
record!(Actuator {
    name,
    target,
    gear,
    gain,
    bias,
    muscle_gain,
    muscle_bias,
    dampratio,
    controller,
    orientation,
    input,
    feeds,
    dynamics,
    dynprm,
    ctrlrange,
    actrange,
    forcerange,
    actearly,
    lengthrange,
    damping,
    armature,
    delay,
    nsample,
    interp,
    enabled,
});
record!(Frame { pos, quat });
record!(Equality {
    name,
    kind,
    first,
    second,
    frame1,
    frame2,
    torquescale,
    polycoef,
    active,
    soft,
});
record!(ExplicitPair {
    name,
    geom1,
    geom2,
    condim,
    friction,
    margin,
    gap,
    soft,
    solreffriction,
    adhesion
});
record!(ContactOverride { margin, friction, soft });
record!(Key { name, time, qpos, qvel, act, ctrl, mpos, mquat });
record!(MassRules {
    from_geoms,
    group_range,
    bound_mass,
    bound_inertia,
    balance_inertia,
    total_mass,
    fit_aabb,
});
record!(Features {
    constraint,
    equality,
    frictionloss,
    limit,
    contact,
    spring,
    damper,
    gravity,
    clampctrl,
    actuation,
    filterparent,
    eulerdamp,
    sensor,
    coriolis,
});
record!(Scene {
    name,
    gravity,
    density,
    viscosity,
    wind,
    magnetic,
    bodies,
    joints,
    geoms,
    meshes,
    hfields,
    sites,
    tendons,
    sensors,
    actuators,
    equalities,
    keys,
    excludes,
    pairs,
    contact_override,
    mass_rules,
    features,
});
