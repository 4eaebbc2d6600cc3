//! Tendons compiled: their stretches, the dofs that move them, and their values at qpos0.

use super::{Course, Model, Movers, Point, Round, Span, Stretch, Tendon};
use crate::real::Constant;
use crate::scene::{self, GeomType, Scene, Stop, Target};

/// Compiles the tendons, except their values at qpos0 and their inverse weights.
pub fn compile(scene: &Scene, model: &mut Model) {
    for source in &scene.tendons {
        let closed = dofs_passed(model, source);
        let (course, dofs) = course(model, source, closed);
        let start = model.tendons.last().map_or(0, |last| last.arms.start + last.arms.len);
        let mut trees: Vec<usize> =
            closed.of(&model.dof_lists).iter().map(|dof| model.dofs[*dof].tree).collect();
        trees.dedup();
        let features = &scene.features;
        let tendon = Tendon {
            name: source.name.clone(),
            course,
            dofs,
            closed,
            arms: Span { start, len: dofs.len },
            used: false,
            range: source.range,
            margin: source.margin,
            springlength: source.springlength,
            stiffness: if features.spring { source.stiffness } else { scene::NONE },
            damping: if features.damper { source.damping } else { scene::NONE },
            armature: source.armature,
            frictionloss: source.frictionloss,
            actuatorfrcrange: source.actuatorfrcrange,
            limit: source.limit.clone(),
            friction: source.friction.clone(),
            length0: 0.0,
            arms0: vec![],
            invweight: 0.0,
            mass: trees.iter().map(|tree| model.trees[*tree].mass).sum(),
        };
        model.tendons.push(tendon);
    }
    let driven: Vec<usize> = (model.actuators.iter())
        .filter_map(|actuator| match actuator.target {
            Target::Tendon(tendon) => Some(tendon),
            _ => None,
        })
        .collect();
    for (index, tendon) in model.tendons.iter_mut().enumerate() {
        tendon.used = tendon.acts() || driven.contains(&index);
    }
}

/// The body of a stop's joint, site or geom.
pub(super) fn body(model: &Model, stop: &Stop) -> Option<usize> {
    match *stop {
        Stop::Joint { joint, .. } => Some(model.joints[joint].body),
        Stop::Site { site } => Some(model.sites[site].body),
        Stop::Geom { geom, .. } => Some(model.geoms[geom].body),
        Stop::Pulley { .. } => None,
    }
}

/// The union of the dofs that move its stops, as a new list.
fn dofs_passed(model: &mut Model, source: &scene::Tendon) -> Span {
    let mut union = vec![];
    for stop in &source.path {
        match *stop {
            Stop::Joint { joint, .. } => {
                let chain = model.chain_of_dof(model.joints[joint].dof);
                union.extend_from_slice(chain.of(&model.dof_lists));
            }
            _ => {
                if let Some(body) = body(model, stop) {
                    union.extend_from_slice(model.bodies[body].chain.of(&model.dof_lists));
                }
            }
        }
    }
    list(model, union)
}

/// Stores these dofs, ascending, as a new list.
fn list(model: &mut Model, mut dofs: Vec<usize>) -> Span {
    dofs.sort_unstable();
    dofs.dedup();
    let span = Span { start: model.dof_lists.len(), len: dofs.len() };
    model.dof_lists.extend(dofs);
    span
}

/// Its course, and the dofs of its stops that can change its length.
fn course(model: &mut Model, source: &scene::Tendon, closed: Span) -> (Course, Span) {
    if let Some(Stop::Joint { .. }) = source.path.first() {
        let part = |stop: &Stop| match *stop {
            Stop::Joint { joint, coef } => Some((joint, coef)),
            _ => None,
        };
        let parts: Vec<_> = source.path.iter().filter_map(part).collect();
        let dofs = parts.iter().map(|(joint, _)| model.joints[*joint].dof).collect();
        return (Course::Fixed(parts), list(model, dofs));
    }
    let mut stretches = stretches(model, source, closed);
    let moved = stretches.iter().flat_map(|stretch| &stretch.movers).flat_map(|own| &own.dofs);
    let dofs = moved.map(|(dof, _)| *dof).collect();
    let dofs = list(model, dofs);
    let own = dofs.of(&model.dof_lists);
    let movers = stretches.iter_mut().flat_map(|stretch| &mut stretch.movers);
    for (dof, at) in movers.flat_map(|movers| &mut movers.dofs) {
        *at = own.partition_point(|own| own < dof);
    }
    (Course::Spatial(stretches), dofs)
}

fn stretches(model: &Model, source: &scene::Tendon, closed: Span) -> Vec<Stretch> {
    let point = |site: usize| Point { body: model.sites[site].body, pos: model.sites[site].pos };
    let (mut stretches, mut last, mut round, mut share) = (vec![], None, None, 1.0);
    for stop in &source.path {
        match *stop {
            Stop::Pulley { divisor } => (last, round, share) = (None, None, 1.0 / divisor),
            Stop::Geom { geom, side } => {
                let shape = &model.geoms[geom];
                let sphere = shape.kind == GeomType::Sphere;
                let side = side.map(point);
                round = Some(Round { geom, sphere, radius: shape.size[0], side });
            }
            Stop::Site { site } => {
                let end = point(site);
                if let Some(first) = last {
                    let ends = [first, end];
                    let movers = movers(model, ends, round, closed.of(&model.dof_lists));
                    stretches.push(Stretch { ends, round, share, movers });
                }
                (last, round) = (Some(end), None);
            }
            Stop::Joint { .. } => {}
        }
    }
    stretches
}

/// The dofs that move some, but not all, of a stretch's supports; their places are not set yet.
fn movers(model: &Model, ends: [Point; 2], round: Option<Round>, dofs: &[usize]) -> Vec<Movers> {
    let carries = |body: usize, dof: usize| {
        model.bodies[body].chain.of(&model.dof_lists).binary_search(&dof).is_ok()
    };
    let geom = round.map(|round| model.geoms[round.geom].body);
    let mut all: Vec<Movers> = vec![];
    for &dof in dofs {
        let [first, second] = ends.map(|end| carries(end.body, dof));
        let middle = geom.map(|body| carries(body, dof));
        let (tree, moves) = (model.dofs[dof].tree, [first, middle.unwrap_or(false), second]);
        if !moves.contains(&true) || first && second && middle.unwrap_or(true) {
            continue;
        }
        match all.iter_mut().find(|own| (own.tree, own.moves) == (tree, moves)) {
            Some(own) => own.dofs.push((dof, 0)),
            None => all.push(Movers { tree, moves, dofs: vec![(dof, 0)] }),
        }
    }
    all
}

impl<N: Constant> Model<N> {
    /// Whether each tendon's armature couples dofs of which neither moves the other: see
    /// `place/tendon_inertia.rs`.
    pub fn armature_beyond_the_tree(&self) -> Vec<bool> {
        let beyond = |tendon: &Tendon<N>| {
            let moved = tendon.dofs.of(&self.dof_lists);
            let apart = |i: &usize| moved.iter().any(|j| self.entry(*i, *j).is_none());
            !tendon.armature.vanishes() && moved.iter().any(apart)
        };
        self.tendons.iter().map(beyond).collect()
    }

    /// For each tree: whether the armature of a spatial tendon is part of its mass matrix.
    pub(super) fn weighted_by_tendons(&self) -> Vec<bool> {
        self.trees_of_tendons(|tendon| !tendon.armature.vanishes())
    }

    /// For each tree: whether a spatial tendon that steps read runs over a body of it.
    pub(super) fn passed_by_tendons(&self) -> Vec<bool> {
        self.trees_of_tendons(|tendon| tendon.used)
    }

    fn trees_of_tendons(&self, which: impl Fn(&Tendon<N>) -> bool) -> Vec<bool> {
        let mut found = vec![false; self.trees.len()];
        for tendon in self.tendons.iter().filter(|tendon| which(tendon) && tendon.spatial()) {
            for dof in tendon.closed.of(&self.dof_lists) {
                found[self.dofs[*dof].tree] = true;
            }
        }
        found
    }
}
