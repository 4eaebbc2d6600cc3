//! Scenes that cannot be compiled.

use super::{ball, free, Build};
use crate::scene::{ExplicitPair, Geom, GeomType, Joint, JointType, Key, Scene};

/// Each scene is refused, and the text names the element and the field.
#[test]
fn what_is_refused_is_named() {
    let good = || {
        let mut b =
            Build::new().floor().body(0, &[free()], &[Geom { name: "ball".into(), ..ball() }]);
        b.0.joints[0].name = "root".into();
        b.0.bodies[1].name = "toy".into();
        b
    };
    good().model();
    type Spoil = fn(&mut Scene);
    let cases: &[(Spoil, &str)] = &[
        (|s| s.gravity[2] = f64::NAN, "gravity[2]"),
        (|s| s.bodies.clear(), "no world"),
        (|s| s.geoms[1].size[0] = 0.0, "geom 'ball' size[0]"),
        (|s| s.geoms[1].mass = Some(-1.0), "geom 'ball' mass"),
        (|s| s.geoms[1].mass = Some(0.0), "body 'toy' mass"),
        (|s| s.geoms[1].mass = Some(1e-310), "body 'toy' mass"),
        (|s| s.geoms[1].density = f64::INFINITY, "geom 'ball' density"),
        (|s| s.geoms[1].friction[0] = -0.1, "geom 'ball' friction[0]"),
        (|s| s.geoms[1].soft.solref = [0.02, -1.0], "geom 'ball' solref"),
        (|s| s.geoms[1].soft.solimp[2] = f64::NAN, "geom 'ball' solimp[2]"),
        (|s| s.geoms[1].condim = 2, "geom 'ball' condim"),
        (|s| s.geoms[1].kind = GeomType::Box, "geom 'ball' size[1]"),
        (|s| s.pairs.push(ExplicitPair { geom2: 9, ..Default::default() }), "pair 0 geom2"),
        (|s| s.pairs.push(ExplicitPair { condim: 2, ..Default::default() }), "pair 0 condim"),
        (|s| s.pairs.push(ExplicitPair { gap: -1.0, ..Default::default() }), "pair 0 gap"),
        (
            |s| {
                let solreffriction = Some([0.02, -1.0]);
                let name = "grip".into();
                s.pairs.push(ExplicitPair { name, solreffriction, ..Default::default() });
            },
            "pair `grip` solreffriction[1]",
        ),
        (|s| s.geoms[1].kind = GeomType::Plane, "must be on a fixed body"),
        (|s| s.geoms[1].name = "floor".into(), "'floor'"),
        (|s| s.geoms[1].body = 7, "geom 'ball' body"),
        (|s| s.bodies[1].quat = [0.0; 4], "body 'toy' quat"),
        (|s| s.bodies[1].parent = 1, "body 'toy' parent"),
        (|s| s.joints[0].damping[0] = -1.0, "joint 'root' damping"),
        (|s| s.joints[0].armature = f64::NAN, "joint 'root' armature"),
        (|s| s.joints.push(s.joints[0].clone()), "two joints"),
        (|s| s.joints.push(Joint { body: 1, ..Joint::default() }), "at most 6"),
        (|s| s.joints[0].body = 0, "world"),
        (
            |s| (s.joints[0].kind, s.joints[0].axis) = (JointType::Slide, [0.0; 3]),
            "joint 'root' axis",
        ),
        (
            |s| (s.joints[0].kind, s.joints[0].range) = (JointType::Hinge, Some([1.0, 1.0])),
            "joint 'root' range",
        ),
        (
            |s| {
                s.joints[0].kind = JointType::Slide;
                s.joints.push(Joint { name: "twin".into(), ..s.joints[0].clone() });
            },
            "joint 'root' of body 'toy' moves nothing",
        ),
        (|s| s.excludes.push([0, 9]), "exclude 0 body2"),
        (|s| s.keys.push(Key { qvel: Some(vec![0.0]), ..Default::default() }), "key 0 qvel length"),
    ];
    for (i, (spoil, names)) in cases.iter().enumerate() {
        let mut b = good();
        spoil(&mut b.0);
        let text = b.error().to_string();
        assert!(text.contains(names), "case {i}: '{names}' is not in: {text}");
    }
}

/// Numbers of hundreds of digits are shown by their exponent, and no others.
#[test]
fn a_value_is_shown_briefly() {
    let cases = [
        (-1e300, "= -1e300: must"),
        (-1.5e-300, "= -1.5e-300: must"),
        (-1234567.0, "= -1234567: must"),
        (-0.1, "= -0.1: must"),
        (f64::NAN, "= NaN: must"),
    ];
    for (mass, shown) in cases {
        let mut b = Build::new().floor().body(0, &[free()], &[ball()]);
        b.0.geoms[1].mass = Some(mass);
        let text = b.error().to_string();
        assert!(text.contains(shown), "'{shown}' is not in: {text}");
    }
}
