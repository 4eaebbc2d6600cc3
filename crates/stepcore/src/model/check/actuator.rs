//! The rules for actuators: their numbers, and their targets.

use super::Subject;
use crate::error::Result;
use crate::scene::{Actuator, JointType, Muscle, Scene, Stop, Target};

/// The most past controls of an actuator.
const MOST_SAMPLES: usize = 1_000_000;

pub(super) fn check(e: &Subject, a: &Actuator, scene: &Scene) -> Result<()> {
    let (joints, sites) = (scene.joints.len(), scene.sites.len());
    match a.target {
        Target::Joint(joint) | Target::InParent(joint) => {
            e.below("joint", joint, joints, "joint")?
        }
        Target::Tendon(tendon) => e.below("tendon", tendon, scene.tendons.len(), "tendon")?,
        Target::Site { site, reference } => {
            e.below("site", site, sites, "site")?;
            e.below("refsite", reference.unwrap_or(site), sites, "site")?;
        }
        Target::Body(body) => {
            e.below("body", body, scene.bodies.len(), "body")?;
            if a.feeds_back() {
                return Err(e.refuse("bias", format!("{:?}", a.bias), "constant at contacts"));
            }
        }
        Target::Crank { crank, slider, rod } => {
            e.below("cranksite", crank, sites, "site")?;
            e.below("slidersite", slider, sites, "site")?;
            e.not_negative("cranklength", rod)?;
        }
    }
    e.finite("gear", &a.gear)?;
    e.finite("gain", &a.gain)?;
    e.finite("bias", &a.bias)?;
    e.not_negative("dampratio", a.dampratio)?;
    if a.dampratio != 0.0 && a.bias[1] > 0.0 {
        return Err(e.refuse("bias[1]", a.bias[1], "<= 0 with a dampratio"));
    }
    e.finite("damping", &a.damping)?;
    e.not_negative("armature", a.armature)?;
    if let (true, Target::Tendon(tendon)) = (a.armature > 0.0, a.target) {
        if scene.tendons[tendon].path.iter().any(|stop| matches!(stop, Stop::Geom { .. })) {
            let limit = "0 for an actuator on a tendon that goes round a geom";
            return Err(e.refuse("armature", a.armature, limit));
        }
    }
    for muscle in [&a.muscle_gain, &a.muscle_bias].into_iter().flatten() {
        let Muscle { force, scale, lmin, lmax, vmax, fpmax, fvmax, range } = *muscle;
        e.finite("muscle", &[force, scale, lmin, lmax, vmax, fpmax, fvmax])?;
        e.range("range", range)?;
        e.range("lengthrange", a.lengthrange)?;
    }
    e.finite("dynprm", &a.dynprm)?;
    controller(e, a, scene)?;
    e.not_negative("delay", a.delay)?;
    if a.delay > 0.0 && !(1..=MOST_SAMPLES).contains(&a.nsample) {
        let limit = format!("1 to {MOST_SAMPLES} with a delay");
        return Err(e.refuse("nsample", a.nsample, &limit));
    }
    let ranges =
        [("ctrlrange", a.ctrlrange), ("actrange", a.actrange), ("forcerange", a.forcerange)];
    for (field, range) in ranges {
        range.map_or(Ok(()), |range| e.range(field, range))?;
    }
    Ok(())
}

/// Checks a controller's numbers, and the actuators that feed it.
fn controller(e: &Subject, a: &Actuator, scene: &Scene) -> Result<()> {
    if let Some(owner) = a.feeds {
        e.below("feeds", owner, scene.actuators.len(), "actuator")?;
        let first = &scene.actuators[owner];
        let turns = first.orientation.is_some() && first.feeds.is_none();
        let known = a.controller.is_none() && (first.controller.is_some() || turns);
        if !known {
            return Err(e.refuse("feeds", owner, "an actuator with a controller, by one without"));
        }
    }
    if let Some(own) = a.orientation {
        let ball = |joint: usize| scene.joints[joint].kind == JointType::Ball;
        if !matches!(a.target, Target::Joint(joint) if ball(joint)) {
            return Err(e.refuse("orientation", format!("{:?}", a.target), "of a ball joint"));
        }
        e.below("orientation axis", own.axis, 3, "axis")?;
    }
    let Some(own) = &a.controller else { return Ok(()) };
    e.not_negative("ki", own.ki)?;
    e.not_negative("imax", own.imax)?;
    e.not_negative("slewmax", own.slewmax)?;
    let Some(motor) = &own.motor else { return Ok(()) };
    e.not_negative("motorconst", motor.constant)?;
    e.number("resistance", motor.resistance, motor.resistance > 0.0, "> 0")?;
    e.not_negative("inductance", motor.inductance)?;
    e.not_negative("vmax", motor.vmax)?;
    e.not_negative("current_rate", motor.current_rate)?;
    e.finite("cogging", &motor.cogging)?;
    if let Some(thermal) = &motor.thermal {
        e.finite("thermal", thermal)?;
        e.number("thermal[0]", thermal[0], thermal[0] > 0.0, "> 0")?;
        e.number("thermal[1]", thermal[1], thermal[1] > 0.0, "> 0")?;
    }
    motor.lugre.iter().flatten().try_for_each(|value| e.not_negative("lugre", *value))
}
