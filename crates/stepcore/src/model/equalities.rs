//! Equalities, compiled: the elements that each ties, with the data that its rows share.

use super::tree::Unions;
use super::{Coupling, Ends, Equality, Model, Span, Tie, Transmission};
use crate::scene::{self, EqualityType, Scene};
use crate::spatial::{unit_quat, Pose, Quat};
use nalgebra::Vector3;

/// Compiles the equalities; bodies and dofs have their inverse weights.
pub fn compile(scene: &Scene, model: &mut Model, poses: &[Pose<f64>], unions: &mut Unions) {
    for q in &scene.equalities {
        let tie = match q.kind {
            EqualityType::Connect => Tie::Connect(ends(model, poses, q)),
            EqualityType::Weld => {
                Tie::Weld { ends: ends(model, poses, q), torquescale: q.torquescale }
            }
            EqualityType::Joint => Tie::Lengths(coupling(model, q, Transmission::Joint)),
            EqualityType::Tendon => {
                Tie::Lengths(coupling(model, q, |tendon| Transmission::Tendon(tendon, None)))
            }
        };
        let chains = match &tie {
            Tie::Connect(ends) | Tie::Weld { ends, .. } => {
                ends.bodies.map(|body| model.bodies[body].chain)
            }
            Tie::Lengths(tie) => {
                [tie.first, tie.second.unwrap_or(tie.first)].map(|length| length.dofs(model))
            }
        };
        let dofs = unions.of_spans(model, chains[0], chains[1]);
        model.equalities.push(Equality {
            name: q.name.clone(),
            tie,
            active: q.active,
            soft: q.soft.clone(),
            dofs,
            mass: mass_of(model, dofs),
        });
    }
}

/// The total mass of the trees of some dofs, each counted once.
fn mass_of(model: &Model, dofs: Span) -> f64 {
    let mut trees: Vec<usize> =
        dofs.of(&model.dof_lists).iter().map(|dof| model.dofs[*dof].tree).collect();
    trees.dedup();
    trees.iter().map(|tree| model.trees[*tree].mass).sum()
}

/// The frames of an equality; one that is not given is at the other one's place at qpos0.
fn ends(model: &Model, poses: &[Pose<f64>], q: &scene::Equality) -> Ends {
    let bodies = [q.first, q.second.unwrap_or(0)];
    let mut pos = [Vector3::zeros(); 2];
    let mut quat = [[1.0, 0.0, 0.0, 0.0]; 2];
    let frames = [&q.frame1, &q.frame2];
    for k in 0..2 {
        let (own, other) = (bodies[k], bodies[1 - k]);
        match (frames[k], frames[1 - k]) {
            (Some(frame), _) => {
                (pos[k], quat[k]) = (Vector3::from(frame.pos), unit_quat(frame.quat));
            }
            (None, Some(frame)) => {
                let at = poses[other].point(Vector3::from(frame.pos)) - poses[own].pos;
                let there = turn(model, other).mul(&Quat::of(&unit_quat(frame.quat)));
                pos[k] = poses[own].rot.transpose() * at;
                turn(model, own).conjugate().mul(&there).store(&mut quat[k]);
            }
            (None, None) => {}
        }
    }
    let sum = |k: usize| bodies.iter().map(|body| model.bodies[*body].invweight[k]).sum();
    Ends { bodies, pos, quat, invweight: [sum(0), sum(1)] }
}

/// Orientation of a body at qpos0.
fn turn(model: &Model, body: usize) -> Quat<f64> {
    let mut turn = Quat::identity();
    let mut at = body;
    while at > 0 {
        turn = Quat::of(&model.bodies[at].quat).mul(&turn);
        at = model.bodies[at].parent;
    }
    turn
}

fn coupling(
    model: &mut Model,
    q: &scene::Equality,
    length: impl Fn(usize) -> Transmission,
) -> Coupling {
    if q.kind == EqualityType::Tendon {
        [Some(q.first), q.second].iter().flatten().for_each(|at| model.tendons[*at].used = true);
    }
    let at = |index: usize| match length(index) {
        Transmission::Tendon(tendon, _) => {
            let tendon = &model.tendons[tendon];
            (tendon.length0, tendon.invweight)
        }
        _ => {
            let joint = &model.joints[index];
            (model.qpos0[joint.qpos], model.dofs[joint.dof].invweight)
        }
    };
    let (first, second) = (at(q.first), q.second.map_or((0.0, 0.0), at));
    Coupling {
        first: length(q.first),
        second: q.second.map(length),
        rest: [first.0, second.0],
        polycoef: q.polycoef,
        invweight: first.1 + second.1,
    }
}
