//! A pair that ranges keep apart meets in no configuration inside of them, and a pair that is
//! reported to meet is not left out.

use super::{ball, geom, joint, Build};
use crate::detect;
use crate::model::Model;
use crate::place::Placed;
use crate::scene::{Geom, GeomType, Joint, JointType};

/// Numbers in [0, 1) (splitmix64).
struct Dice(u64);

impl Dice {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }
    fn vector(&mut self, size: f64) -> [f64; 3] {
        [(); 3].map(|()| self.within(-size, size))
    }
}

/// A ball on the floor's end of an arm of two links of 1 m, and one at its tip.
fn arm(elbow: Option<[f64; 2]>) -> Model {
    let hinge = |range| Joint { range, ..joint(JointType::Hinge, [0.0, 1.0, 0.0]) };
    let mut build = Build::new()
        .body(0, &[hinge(None)], &[ball()])
        .body(1, &[hinge(elbow)], &[Geom { contype: 0, conaffinity: 0, ..ball() }])
        .body(2, &[hinge(Some([-0.1, 0.1]))], &[ball()]);
    build.0.bodies[2].pos = [1.0, 0.0, 0.0];
    build.0.bodies[3].pos = [1.0, 0.0, 0.0];
    build.model()
}

#[test]
fn an_elbow_that_cannot_fold_keeps_the_hand_from_the_shoulder() {
    // |e^{iθ} + 1| = 2 cos(θ/2) > 0.2 as long as θ < 2.94.
    let apart = |elbow| arm(elbow).pairs.iter().map(|p| p.apart).collect::<Vec<_>>();
    assert_eq!(apart(Some([-1.0, 1.0])), [true]);
    assert_eq!(apart(Some([0.0, 2.6])), [true]); // Widened by a tenth: 2.86.
    assert_eq!(apart(Some([0.0, 2.9])), [false]);
    assert_eq!(apart(None), [false]);
}

#[test]
fn pairs_that_are_apart_meet_in_no_configuration() {
    let mut dice = Dice(1);
    let (mut claimed, mut met) = (0, 0);
    for _ in 0..60 {
        let model = drawn(&mut dice);
        claimed += model.pairs.iter().filter(|p| p.apart).count();
        let mut placed = Placed::<f64>::new(&model);
        for _ in 0..400 {
            let qpos = inside(&model, &mut dice);
            placed.positions(&model, &qpos);
            for pair in &model.pairs {
                let distance = detect::distance(&model, &placed, pair);
                let material = model.material(pair);
                let meets = distance < material.listed();
                met += usize::from(meets);
                assert!(!(pair.apart && meets), "{pair:?} at {qpos:?}");
            }
        }
    }
    // The scenes are neither empty nor jammed.
    assert!(claimed > 50 && met > 1000, "{claimed} pairs apart, {met} contacts");
}

/// A tree of five bodies with hinges and slides, some limited, and round and boxy shapes.
fn drawn(dice: &mut Dice) -> Model {
    let mut build = Build::new();
    build.0.features.filterparent = false;
    for body in 1..6 {
        // The body before, or one that carries it.
        let mut parent = body - 1;
        while parent > 0 && dice.unit() < 0.3 {
            parent = build.0.bodies[parent].parent;
        }
        let kind = if dice.unit() < 0.7 { JointType::Hinge } else { JointType::Slide };
        let middle = dice.within(-1.0, 1.0);
        let width = dice.within(0.05, if kind == JointType::Hinge { 1.5 } else { 0.4 });
        let free = kind == JointType::Hinge && dice.unit() < 0.2;
        let one = Joint {
            pos: dice.vector(0.1),
            range: (!free).then_some([middle - width, middle + width]),
            reference: dice.within(-0.5, 0.5),
            ..joint(kind, dice.vector(1.0))
        };
        let size = [dice.within(0.02, 0.1), dice.within(0.05, 0.2), 0.1];
        let kind = if dice.unit() < 0.5 { GeomType::Sphere } else { GeomType::Capsule };
        let shape = Geom {
            pos: dice.vector(0.2),
            quat: [dice.unit(), dice.unit(), dice.unit(), 0.3],
            mass: Some(1.0),
            margin: if dice.unit() < 0.3 { 0.02 } else { 0.0 },
            gap: 0.01,
            ..geom(kind, size)
        };
        build = build.body(parent, &[one], &[shape]);
        build.0.bodies[body].pos = dice.vector(0.5);
        build.0.bodies[body].quat = [0.5, dice.unit(), dice.unit(), dice.unit()];
    }
    build.model()
}

/// Joints anywhere within their guards, often at an end of them; others anywhere.
fn inside(model: &Model, dice: &mut Dice) -> Vec<f64> {
    let mut qpos: Vec<f64> = model.qpos0.iter().map(|_| dice.within(-4.0, 4.0)).collect();
    for guard in &model.guards {
        let at = dice.within(-0.3, 1.3).clamp(0.0, 1.0);
        qpos[guard.at] = guard.low + at * (guard.high - guard.low);
    }
    qpos
}
