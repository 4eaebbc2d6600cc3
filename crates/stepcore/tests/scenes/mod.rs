//! Scenes built by hand, one for each family of rows, for the tests of this folder.
#![allow(dead_code)]

use stepcore::model::Model;
use stepcore::real::Real;
use stepcore::scene::{
    Actuator, Body, Equality, EqualityType, Frame, Geom, GeomType, Inertial, Joint, JointType,
    Scene, Site, Stop, Target, Tendon,
};
use stepcore::sim::Sim;

/// One more body; its index.
pub fn body(scene: &mut Scene, parent: usize, pos: [f64; 3]) -> usize {
    scene.bodies.push(Body { parent, pos, ..Body::default() });
    scene.bodies.len() - 1
}

pub fn joint(scene: &mut Scene, body: usize, kind: JointType, axis: [f64; 3]) -> &mut Joint {
    let name = format!("joint{}", scene.joints.len());
    scene.joints.push(Joint { name, body, kind, axis, ..Joint::default() });
    scene.joints.last_mut().unwrap()
}

pub fn geom(scene: &mut Scene, body: usize, kind: GeomType, size: [f64; 3]) -> &mut Geom {
    let name = format!("geom{}", scene.geoms.len());
    scene.geoms.push(Geom { name, body, kind, size, ..Geom::default() });
    scene.geoms.last_mut().unwrap()
}

/// The world, with a floor.
pub fn floor() -> Scene {
    let mut scene = Scene::default();
    geom(&mut scene, 0, GeomType::Plane, [0.0; 3]).friction[0] = 0.6;
    scene
}

/// A mass on a spring along x, without gravity.
pub fn spring() -> Scene {
    let mut scene = Scene { gravity: [0.0; 3], ..Scene::default() };
    let mass = body(&mut scene, 0, [0.0; 3]);
    joint(&mut scene, mass, JointType::Slide, [1.0, 0.0, 0.0]).stiffness[0] = 100.0;
    let inertia = [1.0, 1.0, 1.0, 0.0, 0.0, 0.0];
    scene.bodies[mass].inertial = Some(Inertial { mass: 1.0, pos: [0.0; 3], inertia, axes: None });
    scene
}

/// The quaternion that turns z into the direction of `to`.
pub fn along(to: [f64; 3]) -> [f64; 4] {
    let length = to.iter().map(|x| x * x).sum::<f64>().sqrt();
    let [x, y, z] = to.map(|c| c / length);
    if z < -0.999_999 {
        return [0.0, 1.0, 0.0, 0.0];
    }
    [1.0 + z, -y, x, 0.0]
}

/// A capsule from one point of a body to another.
pub fn limb(
    scene: &mut Scene,
    body: usize,
    from: [f64; 3],
    to: [f64; 3],
    radius: f64,
) -> &mut Geom {
    let way: [f64; 3] = std::array::from_fn(|k| to[k] - from[k]);
    let half = 0.5 * way.iter().map(|x| x * x).sum::<f64>().sqrt();
    let g = geom(scene, body, GeomType::Capsule, [radius, half, 0.0]);
    g.pos = std::array::from_fn(|k| 0.5 * (from[k] + to[k]));
    g.quat = along(way);
    g
}

/// Balls on vertical slides, one on top of the other.
pub fn tower(count: usize) -> Scene {
    let mut scene = floor();
    for i in 0..count {
        let ball = body(&mut scene, 0, [0.0, 0.0, 0.1 * (2 * i + 1) as f64]);
        joint(&mut scene, ball, JointType::Slide, [0.0, 0.0, 1.0]);
        let g = geom(&mut scene, ball, GeomType::Sphere, [0.1, 0.0, 0.0]);
        g.condim = 1;
        g.mass = Some(1.0 + i as f64);
    }
    scene
}

/// A planar robot: a torso on two slides and a hinge, two legs of two limbs, limits,
/// springs, dampers, armature and motors.
pub fn runner() -> Scene {
    let mut scene = floor();
    let torso = body(&mut scene, 0, [0.0, 0.0, 0.55]);
    joint(&mut scene, torso, JointType::Slide, [1.0, 0.0, 0.0]);
    joint(&mut scene, torso, JointType::Slide, [0.0, 0.0, 1.0]);
    joint(&mut scene, torso, JointType::Hinge, [0.0, 1.0, 0.0]);
    limb(&mut scene, torso, [-0.4, 0.0, 0.0], [0.4, 0.0, 0.0], 0.05).condim = 3;
    for (x, knee) in [(-0.35, 0.15), (0.35, -0.12)] {
        let thigh = body(&mut scene, torso, [x, 0.0, 0.0]);
        limb(&mut scene, thigh, [0.0; 3], [knee, 0.0, -0.25], 0.04);
        let shin = body(&mut scene, thigh, [knee, 0.0, -0.25]);
        limb(&mut scene, shin, [0.0; 3], [-knee, 0.0, -0.22], 0.035);
        for (part, range) in [(thigh, [-0.5, 0.7]), (shin, [-0.6, 0.4])] {
            let at = scene.joints.len();
            let hinge = joint(&mut scene, part, JointType::Hinge, [0.0, 1.0, 0.0]);
            hinge.range = Some(range);
            hinge.stiffness[0] = 30.0;
            hinge.damping[0] = 1.5;
            hinge.armature = 0.05;
            let motor = Actuator {
                name: format!("motor{at}"),
                target: Target::Joint(at),
                gear: [20.0, 0.0, 0.0, 0.0, 0.0, 0.0],
                ctrlrange: Some([-1.0, 1.0]),
                ..Actuator::default()
            };
            // The shins have servos, which reach the bound of their force now and then.
            let motor = if part == shin {
                Actuator { bias: [0.1, -1.0, -0.02], forcerange: Some([-0.3, 0.4]), ..motor }
            } else {
                motor
            };
            scene.actuators.push(motor);
        }
    }
    by_body(scene)
}

/// Free balls and capsules, a free box that only balls meet, an arm of ball joints with
/// limits and friction loss, tied to the world: every pair of shapes and every row.
pub fn heap() -> Scene {
    let mut scene = floor();
    let spots = [[0.0, 0.0, 0.13], [0.17, 0.02, 0.12], [0.02, 0.19, 0.2], [0.09, 0.1, 0.42]];
    for (i, pos) in spots.into_iter().enumerate() {
        let part = body(&mut scene, 0, pos);
        joint(&mut scene, part, JointType::Free, [0.0, 0.0, 1.0]);
        if i % 2 == 0 {
            geom(&mut scene, part, GeomType::Sphere, [0.1, 0.0, 0.0]);
        } else {
            geom(&mut scene, part, GeomType::Capsule, [0.06, 0.09, 0.0]).friction[0] = 0.3;
        }
    }
    let box_ = body(&mut scene, 0, [0.05, -0.25, 0.12]);
    joint(&mut scene, box_, JointType::Free, [0.0, 0.0, 1.0]);
    let g = geom(&mut scene, box_, GeomType::Box, [0.1, 0.12, 0.08]);
    // A box meets nothing but balls so far.
    g.contype = 2;
    g.conaffinity = 0;
    geom(&mut scene, box_, GeomType::Sphere, [0.11, 0.0, 0.0]);
    let ball = body(&mut scene, 0, [0.1, -0.22, 0.36]);
    joint(&mut scene, ball, JointType::Free, [0.0, 0.0, 1.0]);
    geom(&mut scene, ball, GeomType::Sphere, [0.09, 0.0, 0.0]).conaffinity = 3;
    let upper = body(&mut scene, 0, [-0.4, 0.0, 0.5]);
    let j = joint(&mut scene, upper, JointType::Ball, [0.0, 0.0, 1.0]);
    j.range = Some([0.0, 0.3]);
    j.frictionloss = 0.05;
    limb(&mut scene, upper, [0.0; 3], [0.25, 0.0, 0.0], 0.04);
    let lower = body(&mut scene, upper, [0.25, 0.0, 0.0]);
    joint(&mut scene, lower, JointType::Hinge, [0.0, 1.0, 0.0]).damping[0] = 0.1;
    limb(&mut scene, lower, [0.0; 3], [0.2, 0.0, -0.1], 0.03);
    let slider = body(&mut scene, 0, [0.05, 0.0, 0.4]);
    joint(&mut scene, slider, JointType::Slide, [1.0, 0.0, 0.0]).frictionloss = 0.4;
    scene.bodies[slider].inertial = Some(Inertial {
        mass: 0.3,
        pos: [0.0; 3],
        inertia: [0.01, 0.01, 0.01, 0.0, 0.0, 0.0],
        axes: None,
    });
    scene.equalities.push(Equality {
        name: "tie".into(),
        kind: EqualityType::Connect,
        first: lower,
        second: Some(slider),
        frame1: Some(Frame { pos: [0.2, 0.0, -0.1], quat: [1.0, 0.0, 0.0, 0.0] }),
        frame2: None,
        torquescale: 1.0,
        polycoef: [0.0; 5],
        active: true,
        soft: Default::default(),
    });
    rope(&mut scene, [upper, slider], ball);
    scene
}

/// A rope between two bodies round the ball that a third one is, with all that a tendon can have.
fn rope(scene: &mut Scene, ends: [usize; 2], around: usize) {
    for body in ends {
        scene.sites.push(Site {
            name: String::new(),
            body,
            pos: [0.1, 0.0, 0.02],
            quat: [1.0, 0.0, 0.0, 0.0],
            kind: GeomType::Sphere,
            size: [0.005; 3],
        });
    }
    let geom = scene.geoms.iter().position(|geom| geom.body == around).unwrap();
    scene.tendons.push(Tendon {
        name: "rope".into(),
        path: vec![Stop::Site { site: 0 }, Stop::Geom { geom, side: None }, Stop::Site { site: 1 }],
        range: Some([0.0, 0.3]),
        springlength: [0.1, 0.2],
        stiffness: [20.0, 5.0, 0.0],
        damping: [1.0, 0.0, 0.5],
        frictionloss: 0.2,
        ..Tendon::default()
    });
}

/// The elements in the order of their bodies, as the engine takes them.
fn by_body(mut scene: Scene) -> Scene {
    let old: Vec<String> = scene.joints.iter().map(|j| j.name.clone()).collect();
    scene.joints.sort_by_key(|j| j.body);
    scene.geoms.sort_by_key(|g| g.body);
    for motor in &mut scene.actuators {
        let Target::Joint(joint) = &mut motor.target else { continue };
        *joint = scene.joints.iter().position(|j| j.name == old[*joint]).unwrap();
    }
    scene
}

/// A stream of numbers in [-1, 1), the same on every machine.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

/// qpos, qvel, ctrl.
pub type Start = (Vec<f64>, Vec<f64>, Vec<f64>);

/// A world's start: the scene's, with each world a little elsewhere, faster, and higher.
pub fn start(model: &Model, world: usize) -> Start {
    let mut random = Random(world as u64 + 1);
    let mut qpos = model.qpos0.clone();
    for joint in &model.joints {
        match joint.kind {
            JointType::Free => {
                qpos[joint.qpos + 2] += 0.01 * world as f64;
                for k in 0..4 {
                    qpos[joint.qpos + 3 + k] += 0.1 * random.next();
                }
            }
            JointType::Ball => (0..4).for_each(|k| qpos[joint.qpos + k] += 0.1 * random.next()),
            JointType::Slide | JointType::Hinge => qpos[joint.qpos] += 0.05 * random.next(),
        }
    }
    let qvel = (0..model.nv).map(|_| 0.5 * random.next()).collect();
    let ctrl = (0..model.actuators.len()).map(|_| random.next()).collect();
    (qpos, qvel, ctrl)
}

pub fn put<R: Real>(sim: &mut Sim<R>, lane: usize, (qpos, qvel, ctrl): &Start) {
    let fill = |to: &mut [R], from: &[f64]| {
        to.iter_mut().zip(from).for_each(|(to, x)| to.set_lane(lane, *x))
    };
    fill(&mut sim.state.qpos, qpos);
    fill(&mut sim.state.qvel, qvel);
    fill(&mut sim.inputs.ctrl, ctrl);
}
