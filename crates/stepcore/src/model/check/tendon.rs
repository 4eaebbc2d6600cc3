//! The rules for tendons: their numbers, and the order of stops on a path.

use super::Subject;
use crate::elements::Kind;
use crate::error::Result;
use crate::scene::{GeomType, JointType, Scene, Stop, Tendon, AUTOMATIC};

pub(super) fn tendons(scene: &Scene) -> Result<()> {
    for (i, t) in scene.tendons.iter().enumerate() {
        let e = Subject::new(Kind::Tendon, &t.name, i);
        numbers(&e, t)?;
        if matches!(t.path.first(), Some(Stop::Joint { .. })) {
            fixed(&e, t, scene)?;
        } else {
            spatial(&e, t, scene)?;
        }
    }
    Ok(())
}

fn numbers(e: &Subject, t: &Tendon) -> Result<()> {
    if let Some(range) = t.range {
        e.range("range", range)?;
    }
    e.finite("margin", &[t.margin])?;
    e.finite("springlength", &t.springlength)?;
    if t.springlength != AUTOMATIC && t.springlength[1] < t.springlength[0] {
        let limit = "a lower bound, then an upper one that is not smaller";
        return Err(e.refuse("springlength", format!("{:?}", t.springlength), limit));
    }
    e.finite("stiffness", &t.stiffness)?;
    e.finite("damping", &t.damping)?;
    e.not_negative("damping", t.damping[0])?;
    e.not_negative("armature", t.armature)?;
    e.not_negative("frictionloss", t.frictionloss)?;
    if let Some([lo, hi]) = t.actuatorfrcrange {
        e.range("actuatorfrcrange", [lo, hi])?;
        let limit = "a lower bound <= 0 and an upper one >= 0";
        if lo > 0.0 || hi < 0.0 {
            return Err(e.refuse("actuatorfrcrange", format!("{:?}", [lo, hi]), limit));
        }
    }
    e.softness("limit ", &t.limit)?;
    e.softness("friction ", &t.friction)
}

fn fixed(e: &Subject, t: &Tendon, scene: &Scene) -> Result<()> {
    let mut seen = vec![];
    for (i, stop) in t.path.iter().enumerate() {
        let field = format!("path[{i}]");
        let Stop::Joint { joint, coef } = *stop else {
            return Err(e.refuse(&field, "a site, geom or pulley", "a joint, as the first is"));
        };
        e.below(&format!("{field} joint"), joint, scene.joints.len(), "joint")?;
        e.finite(&format!("{field} coef"), &[coef])?;
        if !matches!(scene.joints[joint].kind, JointType::Hinge | JointType::Slide) {
            return Err(e.refuse(&format!("{field} joint"), joint, "a hinge or a slide"));
        }
        if seen.contains(&joint) {
            return Err(e.refuse(&format!("{field} joint"), joint, "another than those before it"));
        }
        seen.push(joint);
    }
    Ok(())
}

/// Every branch runs from site to site, with at most one geom between two.
fn spatial(e: &Subject, t: &Tendon, scene: &Scene) -> Result<()> {
    // The number of sites of the branch until here, and whether a geom waits for its next site.
    let (mut sites, mut geom) = (0, false);
    let branch = "in a branch of at least two sites, the first and last stops sites";
    for (i, stop) in t.path.iter().enumerate() {
        let field = format!("path[{i}]");
        match *stop {
            Stop::Joint { .. } => {
                return Err(e.refuse(&field, "a joint", "a site, geom or pulley, as the first is"))
            }
            Stop::Site { site } => {
                e.below(&format!("{field} site"), site, scene.sites.len(), "site")?;
                (sites, geom) = (sites + 1, false);
            }
            Stop::Geom { geom: index, side } => {
                e.below(&format!("{field} geom"), index, scene.geoms.len(), "geom")?;
                let kind = scene.geoms[index].kind;
                if !matches!(kind, GeomType::Sphere | GeomType::Cylinder) {
                    let limit = "a sphere or a cylinder";
                    return Err(e.refuse(&format!("{field} geom"), kind.word(), limit));
                }
                if let Some(side) = side {
                    e.below(&format!("{field} side"), side, scene.sites.len(), "site")?;
                }
                if t.armature > 0.0 {
                    let limit = "0 for a tendon that goes round a geom";
                    return Err(e.refuse("armature", t.armature, limit));
                }
                if sites == 0 || geom {
                    return Err(e.refuse(&field, "a geom", "after a site and before another"));
                }
                geom = true;
            }
            Stop::Pulley { divisor } => {
                let field = format!("{field} divisor");
                e.number(&field, divisor, divisor > 0.0, "finite and > 0")?;
                if i > 0 && (sites < 2 || geom) {
                    return Err(e.refuse(&format!("path[{}]", i - 1), "the last stop", branch));
                }
                (sites, geom) = (0, false);
            }
        }
    }
    if sites < 2 || geom {
        return Err(e.refuse("path", format!("{} stops", t.path.len()), branch));
    }
    Ok(())
}
