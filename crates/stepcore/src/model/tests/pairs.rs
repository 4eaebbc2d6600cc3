//! Chains, pairs, mixing, still tangents and equalities.

use super::{ball, free, geom, joint, near, Build};
use crate::model::Tie;
use crate::model::NONE;
use crate::scene::{Equality, EqualityType, Frame, Geom, GeomType, Joint, JointType, Softness};

/// Two arms on one trunk: rows hold a dof and its ancestors, nearest first.
#[test]
fn chains_and_rows_of_a_branching_tree() {
    let hinge = || [joint(JointType::Hinge, [0.0, 1.0, 0.0])];
    let model = Build::new()
        .body(0, &hinge(), &[ball()])
        .body(1, &hinge(), &[ball()])
        .body(2, &[], &[ball()])
        .body(1, &hinge(), &[Geom { pos: [0.0, 0.0, 1.0], ..ball() }])
        .body(0, &hinge(), &[ball()])
        .model();
    let rows: Vec<_> = model.dofs.iter().map(|d| d.row.of(&model.row_dofs).to_vec()).collect();
    assert_eq!(rows, [vec![0], vec![1, 0], vec![2, 0], vec![3]]);
    let chains: Vec<_> =
        model.bodies.iter().map(|b| b.chain.of(&model.dof_lists).to_vec()).collect();
    assert_eq!(chains, [vec![], vec![0], vec![0, 1], vec![0, 1], vec![0, 2], vec![3]]);
    assert_eq!(model.bodies.iter().map(|b| b.weld).collect::<Vec<_>>(), [0, 1, 2, 2, 4, 5]);
    assert_eq!(model.bodies.iter().map(|b| b.tree).collect::<Vec<_>>(), [NONE, 0, 0, 0, 0, 1]);
    // Parents do not meet children, nor bodies fixed to them; cousins and other trees do.
    let pairs: Vec<_> = model
        .pairs
        .iter()
        .map(|p| (p.geom1, p.geom2, p.dofs.of(&model.dof_lists).to_vec()))
        .collect();
    let expected = [
        (0, 4, vec![0, 3]),
        (1, 3, vec![0, 1, 2]),
        (1, 4, vec![0, 1, 3]),
        (2, 3, vec![0, 1, 2]),
        (2, 4, vec![0, 1, 3]),
        (3, 4, vec![0, 2, 3]),
    ];
    assert_eq!(pairs, expected);
    assert_eq!((model.pairs[0].mass, model.pairs[1].mass), (5.0, 4.0));
}

#[test]
fn filters_and_mixing() {
    let soft = |a, b| Softness { solref: [a, b], ..Softness::default() };
    let a = Geom {
        friction: [0.5, 0.0, 0.2],
        margin: 0.1,
        solmix: 3.0,
        condim: 1,
        soft: soft(0.1, 1.0),
        ..ball()
    };
    let b = Geom { friction: [0.7, 0.1, 0.0], margin: 0.2, soft: soft(0.3, 2.0), ..ball() };
    let two = |a: &Geom, b: &Geom| {
        Build::new().body(0, &[free()], std::slice::from_ref(a)).body(
            0,
            &[free()],
            std::slice::from_ref(b),
        )
    };
    let model = two(&a, &b).model();
    let (pair, mixed) = (&model.pairs[0], &model.materials[0]);
    assert_eq!((mixed.condim, mixed.friction), (3, [0.7, 0.7, 0.1, 0.2, 0.2]));
    assert!(
        near(mixed.margin, 0.3)
            && near(mixed.soft.solref[0], 0.15)
            && near(mixed.soft.solref[1], 1.25)
    );
    assert_eq!(pair.invweight, 2.0);
    let direct = Geom { soft: soft(-100.0, -3.0), ..b.clone() };
    assert_eq!(two(&a, &direct).model().materials[0].soft.solref, [-100.0, -3.0]);
    let first = Geom { priority: 1, ..a.clone() };
    let mixed = two(&first, &b).model().materials[0].clone();
    assert_eq!((mixed.condim, mixed.friction[0], mixed.soft.solref), (1, 0.5, [0.1, 1.0]));
    let apart = Geom { contype: 2, conaffinity: 4, ..b.clone() };
    assert!(two(&a, &apart).model().pairs.is_empty());
    let mut excluded = two(&a, &b);
    excluded.0.excludes.push([2, 1]);
    assert!(excluded.model().pairs.is_empty());
    let mut family = Build::new().floor().body(0, &[free()], &[ball()]).body(
        1,
        &[joint(JointType::Ball, [0.0; 3])],
        &[ball()],
    );
    assert_eq!(family.model().pairs.len(), 2);
    family.0.features.filterparent = false;
    assert_eq!(family.model().pairs.len(), 3);
    family.0.features.contact = false;
    assert!(family.model().pairs.is_empty());
}

#[test]
fn still_tangents() {
    let (x, y, z) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
    let (slide, hinge) = (|a| joint(JointType::Slide, a), |a| joint(JointType::Hinge, a));
    let upright = Geom { density: 1.0, ..geom(GeomType::Capsule, [0.1, 0.5, 0.0]) };
    let lying = |quat| Geom { quat, ..upright.clone() };
    let still = |joints: &[Joint], g: &Geom| {
        Build::new().floor().body(0, joints, std::slice::from_ref(g)).model().pairs[0].still
    };
    // Tangents on a floor: y, then −x; of a capsule: its axis, then z × axis.
    assert_eq!(still(&[slide(z)], &ball()), [true, true]);
    assert_eq!(still(&[slide(x), slide(z)], &ball()), [true, false]);
    assert_eq!(still(&[slide(y), slide(z)], &ball()), [false, true]);
    assert_eq!(still(&[slide(x), slide(z), hinge(y)], &ball()), [true, false]);
    assert_eq!(still(&[slide(x), slide(z), hinge(y)], &upright), [false, true]);
    // Upright, the first tangent becomes x, which is here the axis of the hinge.
    assert_eq!(still(&[slide(y), slide(z), hinge(x)], &upright), [false, false]);
    assert_eq!(
        still(&[slide(x), slide(z), hinge(y)], &lying([1.0, 1.0, 0.0, 0.0])),
        [false, false]
    );
    assert_eq!(still(&[slide(x), slide(z)], &lying([1.0, 0.0, 1.0, 0.0])), [false, true]);
    assert_eq!(still(&[slide(z)], &upright), [true, true]);
    assert_eq!(still(&[slide(x), slide(z)], &upright), [false, false]);
    assert_eq!(still(&[slide(x), hinge(y), hinge(z)], &ball()), [false, false]);
    assert_eq!(still(&[free()], &ball()), [false, false]);
}

#[test]
fn a_connected_point_is_found_on_both_bodies() {
    let mut b = Build::new().body(0, &[free()], &[ball()]).body(0, &[free()], &[ball()]);
    b.0.bodies[1].pos = [1.0, 0.0, 0.0];
    b.0.bodies[2].quat = [1.0, 0.0, 0.0, 1.0];
    let soft = Softness::default();
    b.0.equalities.push(Equality {
        name: "pin".into(),
        kind: EqualityType::Connect,
        first: 1,
        second: Some(2),
        frame1: Some(Frame { pos: [0.5, 0.0, 0.25], quat: [1.0, 0.0, 0.0, 0.0] }),
        frame2: None,
        torquescale: 1.0,
        polycoef: [0.0; 5],
        active: true,
        soft,
    });
    let q = b.model().equalities[0].clone();
    let Tie::Connect(ends) = &q.tie else { panic!("{:?}", q.tie) };
    assert!((ends.pos[1] - nalgebra::Vector3::new(0.0, -1.5, 0.25)).amax() < 1e-15);
    assert_eq!((q.dofs.len, ends.invweight[0], q.mass), (12, 2.0, 2.0));
}
