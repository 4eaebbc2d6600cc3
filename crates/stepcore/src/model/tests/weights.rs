//! Masses, inertias and inverse weights.

use super::{ball, free, geom, joint, near, Build};
use crate::model::shape::{measure, unit_inertia};
use crate::scene::{Geom, GeomType, Inertial, Joint, JointType, MassRules};

/// A shell's surface and inertia are the gain of the solid when its sizes grow by a
/// layer of thickness e, per e, for e → 0: central differences, exact to O(e²).
#[test]
fn a_shell_is_the_growth_of_its_solid() {
    use GeomType::{Box, Capsule, Cylinder, Ellipsoid, Sphere};
    let e = 1e-4;
    let cases = [
        (Sphere, [1, 0, 0]),
        (Capsule, [1, 0, 0]),
        (Cylinder, [1, 1, 0]),
        (Box, [1, 1, 1]),
        (Ellipsoid, [1, 1, 1]),
    ];
    for (kind, grows) in cases {
        let size = [0.7, 0.4, 0.9];
        let grown =
            |e: f64| geom(kind, crate::real::array::from_fn(|i| size[i] + e * f64::from(grows[i])));
        let shell = Geom { shell_inertia: true, ..geom(kind, size) };
        let (more, less) = (grown(e), grown(-e));
        let area = (measure(&more) - measure(&less)) / (2.0 * e);
        let gain = (unit_inertia(&more) * measure(&more) - unit_inertia(&less) * measure(&less))
            / (2.0 * e)
            / area;
        assert!((gain - unit_inertia(&shell)).amax() < 1e-7, "{kind:?}");
        // The growing ellipsoid's layer is not of even thickness; its area has another formula.
        assert!(kind == Ellipsoid || (area - measure(&shell)).abs() < 1e-6, "{kind:?}");
    }
}

/// A free box: 1/m, and the mean of 1/I.
#[test]
fn a_free_box_weighs_what_it_is() {
    let sides = [0.1, 0.2, 0.4];
    let model = Build::new()
        .body(0, &[free()], &[Geom { mass: Some(3.0), ..geom(GeomType::Box, sides) }])
        .model();
    let [x, y, z] = sides.map(|s| s * s);
    let mean = (1.0 / (y + z) + 1.0 / (x + z) + 1.0 / (x + y)) / 3.0;
    assert!(near(model.bodies[1].invweight[0], 1.0 / 3.0));
    assert!(near(model.bodies[1].invweight[1], mean));
    assert!(near(model.dofs[5].invweight, mean));
    assert_eq!((model.nq, model.nv, model.trees.len()), (7, 6, 1));
}

/// A pendulum: dof 1/(I + m l² + armature), its body a third of that, times l² for translation.
#[test]
fn a_pendulum_weighs_about_its_hinge() {
    let hinge = Joint { armature: 0.5, ..joint(JointType::Hinge, [0.0, 2.0, 0.0]) };
    let model = Build::new().body(0, &[hinge], &[Geom { pos: [0.0, 0.0, -2.0], ..ball() }]).model();
    let dof = 1.0 / (0.4 * 0.01 + 4.0 + 0.5);
    assert!(near(model.dofs[0].invweight, dof));
    assert!(near(model.bodies[1].invweight[0], 4.0 * dof / 3.0));
    assert!(near(model.bodies[1].invweight[1], dof / 3.0));
}

/// MuJoCo's exception: slides along coordinate axes weigh the mass, armature or not.
#[test]
fn a_plain_slider_weighs_its_mass() {
    let slide = |axis| Joint { armature: 1.0, ..joint(JointType::Slide, axis) };
    let weights = |axis, geom: Geom| {
        let model = Build::new().body(0, &[slide(axis)], &[geom]).model();
        (model.bodies[1].invweight[0], model.dofs[0].invweight)
    };
    assert_eq!(weights([0.0, -1.0, 0.0], ball()), (1.0, 1.0));
    let (body, dof) = weights([1.0, 1.0, 0.0], ball());
    assert!(near(body, 0.5 / 3.0) && near(dof, 0.5));
    let (body, dof) = weights([0.0, 1.0, 0.0], Geom { pos: [0.1, 0.0, 0.0], ..ball() });
    assert!(near(body, 0.5 / 3.0) && near(dof, 0.5));
}

/// Lengths times 4 and masses times 8: every weight changes by that power of two exactly.
#[test]
fn powers_of_two_scale_the_weights_bit_for_bit() {
    let scene = |length: f64, mass: f64| {
        let mut b = Build::new();
        b.0.features.contact = false;
        for i in 0..3 {
            let tilted = Joint {
                pos: [0.1 * length, 0.0, 0.3 * length],
                ..joint(JointType::Hinge, [0.3, 1.0, 0.2])
            };
            let box_ = Geom {
                mass: Some(0.7 * mass),
                ..geom(GeomType::Box, [0.1, 0.2, 0.3].map(|s| s * length))
            };
            let arm = Geom {
                density: 900.0 * mass / length.powi(3),
                ..geom(GeomType::Capsule, [0.05, 0.4, 0.0].map(|s| s * length))
            };
            b = b.body(i, &[tilted], &[Geom { quat: [1.0, 0.2, 0.0, 0.4], ..box_ }, arm]);
            b.0.bodies[i + 1].pos = [0.3 * length, 0.1 * length, 0.0];
            b.0.bodies[i + 1].quat = [0.8, 0.1, 0.2, 0.3];
        }
        b.model()
    };
    let (one, two) = (scene(1.0, 1.0), scene(4.0, 8.0));
    for (a, b) in one.bodies.iter().zip(&two.bodies) {
        assert_eq!([a.invweight[0] / 8.0, a.invweight[1] / 128.0], b.invweight);
        assert_eq!(a.inertia * 128.0, b.inertia);
    }
    assert!(one.dofs.iter().zip(&two.dofs).all(|(a, b)| a.invweight / 128.0 == b.invweight));
}

#[test]
fn rules_about_masses() {
    let given =
        Inertial { mass: 2.0, pos: [0.0; 3], inertia: [1.0, 1.0, 3.0, 0.0, 0.0, 0.0], axes: None };
    let mut b = Build::new().body(0, &[free()], &[ball()]);
    b.0.bodies[1].inertial = Some(given);
    assert!(b.error().to_string().contains("sum of the others"));
    b.0.mass_rules.balance_inertia = true;
    assert!(near(b.model().bodies[1].inertia[(2, 2)], 5.0 / 3.0));
    b.0.mass_rules.from_geoms = Some(true);
    assert_eq!(b.model().bodies[1].mass, 1.0);
    (b.0.mass_rules.bound_mass, b.0.mass_rules.bound_inertia) = (1.5, 0.1);
    let bound = b.model().bodies[1].clone();
    assert!(bound.mass == 1.5 && near(bound.inertia[(0, 0)], 0.1));
    b.0.mass_rules.total_mass = 6.0;
    assert!(near(b.model().trees[0].mass, 6.0) && near(b.model().bodies[1].inertia[(0, 0)], 0.4));
    b.0.mass_rules = MassRules { from_geoms: Some(false), ..Default::default() };
    b.0.bodies[1].inertial = None;
    assert!(b.error().to_string().contains("mass = 0"));
}
