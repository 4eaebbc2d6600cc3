//! The rules for an equality.

use super::Subject;
use crate::error::Result;
use crate::scene::{Equality, EqualityType, JointType, Scene};

pub(super) fn check(e: &Subject, q: &Equality, scene: &Scene) -> Result<()> {
    let (count, word) = match q.kind {
        EqualityType::Connect | EqualityType::Weld => (scene.bodies.len(), "body"),
        EqualityType::Joint => (scene.joints.len(), "joint"),
        EqualityType::Tendon => (scene.tendons.len(), "tendon"),
    };
    e.below("first", q.first, count, word)?;
    if let Some(second) = q.second {
        e.below("second", second, count, word)?;
        if q.first == second {
            return Err(e.refuse("second", second, &format!("another {word} than the first")));
        }
    }
    if word == "joint" {
        for joint in std::iter::once(q.first).chain(q.second) {
            let kind = scene.joints[joint].kind;
            if !matches!(kind, JointType::Hinge | JointType::Slide) {
                return Err(e.refuse("joint", joint, "a hinge or a slide"));
            }
        }
    } else if word == "body" && (q.second.is_none() || (q.frame1.is_none() && q.frame2.is_none())) {
        return Err(e.refuse("second", "none", "a body, and one of the two frames given"));
    }
    for (field, frame) in [("frame1", &q.frame1), ("frame2", &q.frame2)] {
        if let Some(frame) = frame {
            e.finite(&format!("{field} pos"), &frame.pos)?;
            e.direction(&format!("{field} quat"), &frame.quat)?;
        }
    }
    e.finite("torquescale", &[q.torquescale])?;
    e.finite("polycoef", &q.polycoef)?;
    e.softness("", &q.soft)
}
