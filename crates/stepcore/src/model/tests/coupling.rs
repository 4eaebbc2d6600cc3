//! The pattern of the metric of `discrete`, where tendons couple branches and trees.

use super::{ball, joint, Build};
use crate::scene::{Geom, GeomType, Joint, JointType, Site, Stop, Tendon};

fn hinge() -> [Joint; 1] {
    [joint(JointType::Hinge, [0.0, 1.0, 0.0])]
}

/// A trunk (0) with two arms (1, 2), and another tree of two (3, 4).
fn trees(tendons: &[&[usize]], stiffness: f64) -> Build {
    let mut build = Build::new()
        .body(0, &hinge(), &[ball()])
        .body(1, &hinge(), &[ball()])
        .body(1, &hinge(), &[Geom { pos: [0.0, 0.0, 1.0], ..ball() }])
        .body(0, &hinge(), &[Geom { pos: [0.0, 3.0, 1.0], ..ball() }])
        .body(4, &hinge(), &[ball()]);
    let stop = |joint: &usize| Stop::Joint { joint: *joint, coef: 1.0 };
    build.0.tendons.extend(tendons.iter().map(|joints| Tendon {
        path: joints.iter().map(stop).collect(),
        stiffness: [stiffness, 0.0, 0.0],
        ..Tendon::default()
    }));
    build
}

fn closed(build: &Build) -> Vec<Vec<usize>> {
    let model = build.model();
    model.dofs.iter().map(|dof| dof.closed.of(&model.dof_lists).to_vec()).collect()
}

#[test]
fn what_nothing_couples_has_the_chains_of_its_tree() {
    let alone = [vec![0], vec![0, 1], vec![0, 2], vec![3], vec![3, 4]];
    assert_eq!(closed(&trees(&[], 1.0)), alone);
    // Dofs of one chain; and a tendon that does not pull.
    assert_eq!(closed(&trees(&[&[0, 2]], 1.0)), alone);
    assert_eq!(closed(&trees(&[&[1, 2]], 0.0)), alone);
}

#[test]
fn coupled_branches_become_one_chain() {
    let build = trees(&[&[1, 2]], 1.0);
    assert_eq!(closed(&build), [vec![0], vec![0, 1], vec![0, 1, 2], vec![3], vec![3, 4]]);
    // Rows of bodies on the second branch touch the first one too, and the pattern is closed.
    let model = build.model();
    assert!(model.couples);
    for dofs in model.pairs.iter().map(|pair| pair.dofs.of(&model.dof_lists)) {
        for dof in dofs {
            let own = model.dofs[*dof].closed.of(&model.dof_lists);
            assert!(own.iter().all(|ancestor| dofs.contains(ancestor)), "{dofs:?}");
        }
    }
}

#[test]
fn coupled_trees_are_one_island() {
    let apart = |tendons: &[&[usize]]| {
        let mut build = trees(tendons, 1.0);
        build.0.geoms.iter_mut().for_each(|geom| (geom.contype, geom.conaffinity) = (0, 0));
        build
    };
    assert_eq!(apart(&[]).model().islands(), [0, 1]);
    let build = apart(&[&[2, 4]]);
    assert_eq!(build.model().islands(), [0, 0]);
    assert_eq!(closed(&build), [vec![0], vec![0, 1], vec![0, 2], vec![0, 2, 3], vec![0, 2, 3, 4]]);
}

fn site(body: usize) -> Site {
    let (pos, quat) = ([0.5, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]);
    Site { name: String::new(), body, pos, quat, kind: GeomType::Sphere, size: [0.1; 3] }
}

/// Dofs that move the trunk move both ends of a tendon between its arms, and not its length.
#[test]
fn a_tendon_knows_the_dofs_that_change_its_length() {
    let mut build = trees(&[&[2]], 1.0);
    build.0.sites.extend([2, 3].map(site));
    let path = vec![Stop::Site { site: 0 }, Stop::Site { site: 1 }];
    build.0.tendons.push(Tendon { path, ..Tendon::default() });
    let model = build.model();
    let lists = |tendon: usize| {
        let own = &model.tendons[tendon];
        [own.dofs, own.closed].map(|dofs| dofs.of(&model.dof_lists).to_vec())
    };
    assert_eq!(lists(0), [vec![2], vec![0, 2]]);
    assert_eq!(lists(1), [vec![1, 2], vec![0, 1, 2]]);
}

/// A branch along one body never changes; its rows touch that tree all the same, and are one island
/// with it.
#[test]
fn a_tendon_is_one_island_with_every_tree_that_it_passes() {
    let mut build = trees(&[], 1.0);
    build.0.geoms.iter_mut().for_each(|geom| (geom.contype, geom.conaffinity) = (0, 0));
    build.0.sites.extend([0, 2, 2, 4].map(site));
    let stop = |site| Stop::Site { site };
    let path = vec![stop(1), stop(2), Stop::Pulley { divisor: 1.0 }, stop(0), stop(3)];
    build.0.tendons.push(Tendon { path, range: Some([0.0, 1.0]), ..Tendon::default() });
    let model = build.model();
    assert_eq!(model.tendons[0].dofs.of(&model.dof_lists), [3]);
    assert_eq!(model.tendons[0].closed.of(&model.dof_lists), [0, 1, 3]);
    assert_eq!(model.islands(), [0, 0]);
}
