//! The skeleton: bodies, joints and dofs in order, trees, chains of dofs, and the
//! pattern of the mass matrix.

use super::meshes::Asset;
use super::{Body, Dof, Geom, Joint, Model, Site, Span, Tree, NONE};
use crate::scene::{self, GeomType, JointType, Scene};
use crate::spatial::{rotation, unit_quat};
use nalgebra::{Matrix3, Vector3};
use std::collections::HashMap;

/// The model without masses, inverse weights, pairs and equalities.
pub fn lay_out(scene: &Scene, assets: &[Asset]) -> Model {
    let mut model = Model {
        name: scene.name.clone(),
        sticks: scene.geoms.iter().any(|geom| geom.adhesion > 0.0)
            || scene.pairs.iter().any(|pair| pair.adhesion > 0.0),
        gravity: Vector3::from(scene.gravity),
        magnetic: Vector3::from(scene.magnetic),
        features: scene.features.clone(),
        bodies: Vec::with_capacity(scene.bodies.len()),
        joints: Vec::with_capacity(scene.joints.len()),
        geoms: scene.geoms.iter().zip(assets).map(|(g, asset)| geom(g, asset)).collect(),
        compensates: compensates(scene),
        sensors: scene.sensors.clone(),
        explicit: scene
            .pairs
            .iter()
            .map(|p| (p.geom1.min(p.geom2), p.geom1.max(p.geom2)))
            .collect(),
        excludes: scene.excludes.iter().map(|[a, b]| (*a.min(b), *a.max(b))).collect(),
        actuators: scene.actuators.clone(),
        keys: scene.keys.clone(),
        ..Model::default()
    };
    for s in &scene.sites {
        let (name, pos) = (s.name.clone(), Vector3::from(s.pos));
        let quat = unit_quat(s.quat);
        model.sites.push(Site { name, body: s.body, pos, quat, kind: s.kind, size: s.size });
    }
    let mut next = 0;
    for i in 0..scene.bodies.len() {
        let start = next;
        while scene.joints.get(next).is_some_and(|j| j.body == i) {
            next += 1;
        }
        body(&mut model, scene, i, Span { start, len: next - start });
    }
    for i in 0..model.nv {
        row(&mut model, i);
    }
    close_lists(&mut model);
    model
}

/// Whether weight is compensated. As in MuJoCo, a share below 0 counts only next to one above 0.
fn compensates(scene: &Scene) -> bool {
    let on = scene.features.gravity && scene.features.passive();
    on && scene.bodies.iter().any(|body| body.gravcomp > 0.0)
}

/// Appends body `i` with its joints, its dofs and its chain.
fn body(model: &mut Model, scene: &Scene, i: usize, joints: Span) {
    let source = &scene.bodies[i];
    let (pos, quat) = (Vector3::from(source.pos), unit_quat(source.quat));
    let above = (i > 0).then(|| model.bodies[source.parent].clone());
    let mut tree = above.as_ref().map_or(NONE, |p| p.tree);
    let kinds = || joints.of(&scene.joints).iter().map(|j| j.kind);
    if joints.len > 0 && tree == NONE {
        tree = model.trees.len();
        model.trees.push(Tree {
            bodies: Span { start: i, len: 0 },
            dofs: Span { start: model.nv, len: 0 },
            mass: 0.0,
            slides_only: above.as_ref().is_none_or(|p| !p.carried),
            constant: false,
            seen: true,
            plane: None,
            sleep: source.sleep,
        });
    }
    let dofs = Span { start: model.nv, len: kinds().map(JointType::dofs).sum() };
    let mut chain = above.as_ref().map_or(Span::default(), |p| p.chain);
    if dofs.len > 0 {
        let inherited = chain.range();
        chain = Span { start: model.dof_lists.len(), len: chain.len + dofs.len };
        model.dof_lists.extend_from_within(inherited);
        model.dof_lists.extend(dofs.range());
    }
    if tree != NONE {
        let tree = &mut model.trees[tree];
        tree.bodies.len += 1;
        tree.dofs.len += dofs.len;
        tree.slides_only &= !kinds().any(JointType::turns);
    }
    let mocap = source.mocap.then_some(model.mocaps.len());
    model.mocaps.extend(mocap.map(|_| i));
    let carried = mocap.is_some() || above.as_ref().is_some_and(|p| p.carried);
    if carried && tree == NONE {
        model.carried.push(i);
    }
    let weld =
        if joints.len > 0 || mocap.is_some() { i } else { above.as_ref().map_or(0, |p| p.weld) };
    let turns = carried || above.is_some_and(|p| p.turns) || kinds().any(JointType::turns);
    model.bodies.push(Body {
        name: source.name.clone(),
        parent: source.parent,
        weld,
        tree,
        pos,
        quat,
        joints,
        dofs,
        chain,
        closed: Span::default(),
        mass: 0.0,
        ipos: Vector3::zeros(),
        iquat: [1.0, 0.0, 0.0, 0.0],
        inertia: Matrix3::zeros(),
        invweight: [0.0; 2],
        gravcomp: source.gravcomp,
        mocap,
        carried,
        turns,
    });
    for index in joints.range() {
        joint(model, scene, index);
    }
}

fn joint(model: &mut Model, scene: &Scene, index: usize) {
    let source = &scene.joints[index];
    let body = &model.bodies[source.body];
    let (start, stop) = match source.kind {
        JointType::Free => {
            let mut pose = body.pos.as_slice().to_vec();
            pose.extend(body.quat);
            (pose.clone(), pose)
        }
        JointType::Ball => (vec![1.0, 0.0, 0.0, 0.0], vec![1.0, 0.0, 0.0, 0.0]),
        JointType::Slide | JointType::Hinge => (vec![source.reference], vec![source.springref]),
    };
    let axis = Vector3::from(source.axis);
    let length = axis.norm();
    model.joints.push(Joint {
        name: source.name.clone(),
        kind: source.kind,
        body: source.body,
        qpos: model.nq,
        dof: model.nv,
        pos: Vector3::from(source.pos),
        axis: if length > 0.0 { axis / length } else { Vector3::z() },
        range: source.range,
        margin: source.margin,
        reference: source.reference,
        stiffness: if scene.features.spring { source.stiffness } else { scene::NONE },
        damping: if scene.features.damper { source.damping } else { scene::NONE },
        actuatorfrcrange: source.actuatorfrcrange,
        limit: source.limit.clone(),
        actuatorgravcomp: source.actuatorgravcomp,
    });
    // The last dof already on the chain: a dof of this body, or of the bodies above it.
    let body = &model.bodies[source.body];
    let above = body.chain.len - body.dofs.len;
    let before = body.chain.of(&model.dof_lists)[..above].last().copied();
    let mut parent = if model.nv > body.dofs.start { model.nv - 1 } else { before.unwrap_or(NONE) };
    for _ in 0..source.kind.dofs() {
        model.dofs.push(Dof {
            joint: index,
            body: source.body,
            tree: body.tree,
            parent,
            closed: Span::default(),
            row: Span::default(),
            armature: source.armature,
            frictionloss: source.frictionloss,
            friction: source.friction.clone(),
            invweight: 0.0,
        });
        parent = model.nv;
        model.nv += 1;
    }
    model.nq += start.len();
    model.qpos0.extend(start);
    model.qpos_spring.extend(stop);
}

/// This dof and its ancestors, nearest first.
fn row(model: &mut Model, dof: usize) {
    let start = model.row_dofs.len();
    let mut at = dof;
    while at != NONE {
        model.row_dofs.push(at);
        at = model.dofs[at].parent;
    }
    model.dofs[dof].row = Span { start, len: model.row_dofs.len() - start };
}

fn geom(source: &crate::scene::Geom, asset: &Asset) -> Geom {
    let [a, b, c] = source.size;
    let reach = match source.kind {
        GeomType::Plane => f64::INFINITY,
        GeomType::HField => (a * a + b * b + c * c).sqrt(),
        GeomType::Mesh => (a * a + b * b + c * c).sqrt(),
        GeomType::Sphere => a,
        GeomType::Capsule => a + b,
        GeomType::Ellipsoid => a.max(b).max(c),
        GeomType::Cylinder => (a * a + b * b).sqrt(),
        GeomType::Box => (a * a + b * b + c * c).sqrt(),
    };
    Geom {
        name: source.name.clone(),
        body: source.body,
        kind: source.kind,
        size: source.size,
        pos: Vector3::from(source.pos),
        quat: unit_quat(source.quat),
        axis: rotation(unit_quat(source.quat)).column(2).into_owned(),
        reach: asset.hull.as_ref().map_or(reach, |hull| hull.reach()),
        half: half(source, asset, reach),
        hull: asset.hull.clone(),
        field: asset.field.clone(),
        surface: asset.surface.clone(),
        group: source.group,
        hidden: source.hidden,
        contype: source.contype,
        conaffinity: source.conaffinity,
        collides: false,
        by_axis: source.kind == GeomType::Capsule && source.surfacevel == [0.0; 6],
        belt: belt(&source.surfacevel),
        in_plane: None,
    }
}

fn belt(surfacevel: &[f64; 6]) -> Option<[Vector3<f64>; 2]> {
    let &[x, y, z, a, b, c] = surfacevel;
    surfacevel.iter().any(|v| *v != 0.0).then(|| [Vector3::new(x, y, z), Vector3::new(a, b, c)])
}

/// Half sizes of the box about a geom's frame that holds it [m].
fn half(source: &crate::scene::Geom, asset: &Asset, reach: f64) -> [f64; 3] {
    let [a, b, c] = source.size;
    match (source.kind, &asset.hull) {
        (_, Some(hull)) => hull.half(),
        (GeomType::Sphere, _) => [a; 3],
        (GeomType::Capsule, _) => [a, a, a + b],
        (GeomType::Cylinder, _) => [a, a, b],
        (GeomType::Ellipsoid | GeomType::Box, _) => [a, b, c],
        (GeomType::HField, _) => [a, b, asset.field.as_ref().map_or(c, |field| field.tall())],
        (GeomType::Plane | GeomType::Mesh, _) => [reach; 3],
    }
}

/// Marks the trees that a step places, and the constant ones: equalities, tendons, pairs exist.
pub fn mark(model: &mut Model) {
    let tied: Vec<usize> = model.equalities.iter().flat_map(|e| e.placed()).collect();
    let met = model.geoms.iter().filter(|g| g.collides).map(|g| g.body);
    let (met, passed) = (trees_of(model, met), model.passed_by_tendons());
    let linked = model.passed_by_linkages();
    let tied = trees_of(model, tied.into_iter());
    let weighted = model.weighted_by_tendons();
    for tree in 0..model.trees.len() {
        let turns = !model.trees[tree].slides_only;
        model.trees[tree].seen = met[tree] || tied[tree] || passed[tree] || linked[tree] || turns;
        let ball = model.free_ball(&model.trees[tree]);
        let still = !turns || ball && !tied[tree];
        model.trees[tree].constant = still && !weighted[tree];
    }
}

/// For each tree: whether some of these bodies is in it.
fn trees_of(model: &Model, bodies: impl Iterator<Item = usize>) -> Vec<bool> {
    let mut found = vec![false; model.trees.len()];
    for tree in bodies.map(|body| model.bodies[body].tree).filter(|tree| *tree != NONE) {
        found[tree] = true;
    }
    found
}

/// Unions of two bodies' chains, each stored once.
#[derive(Default)]
pub struct Unions(HashMap<[(usize, usize); 2], Span>);

impl Unions {
    /// Every dof that moves either body, ascending.
    pub fn of(&mut self, model: &mut Model, body1: usize, body2: usize) -> Span {
        let (a, b) = (model.bodies[body1].chain, model.bodies[body2].chain);
        self.of_spans(model, a, b)
    }

    /// Every dof of two lists, ascending.
    pub fn of_spans(&mut self, model: &mut Model, a: Span, b: Span) -> Span {
        let (one, two) = (a.of(&model.dof_lists), b.of(&model.dof_lists));
        if two.iter().all(|d| one.binary_search(d).is_ok()) {
            return a;
        }
        if one.iter().all(|d| two.binary_search(d).is_ok()) {
            return b;
        }
        let mut union = [one, two].concat();
        union.sort_unstable();
        union.dedup();
        // One list for all with these two, in either order. Joints of one body share their start.
        let mut two = [a, b].map(|span| (span.start, span.len));
        two.sort_unstable();
        let lists = &mut model.dof_lists;
        *self.0.entry(two).or_insert_with(|| {
            let span = Span { start: lists.len(), len: union.len() };
            lists.extend(union);
            span
        })
    }
}

/// Replaces every list with its closure in the tree.
fn close_lists(model: &mut Model) {
    for k in 0..model.nv {
        let body = &model.bodies[model.dofs[k].body];
        let after = body.dofs.start + body.dofs.len - 1 - k;
        model.dofs[k].closed = Span { start: body.chain.start, len: body.chain.len - after };
    }
    for body in &mut model.bodies {
        body.closed = body.chain;
    }
}
