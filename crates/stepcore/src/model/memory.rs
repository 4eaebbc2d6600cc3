//! The memory that a model and its worlds need, before any of it is allocated.
//!
//! A program that runs out of memory is aborted, and with it the interpreter. So all memory that a
//! short file can request is added up first. The bytes of each element were measured and rounded
//! up.

use super::Model;
use crate::detect::Contact;
use crate::elements::{text, Kind, Text};
use crate::error::{Error, Result};
use crate::room::can_be_had;
use crate::scene::{Scene, Stop};
use crate::settings::Settings;

/// A past control: in a world's working space, and in the arrays of its user.
const SAMPLE: usize = 300;
/// A place of the mass matrix: in the model's lists, and in a world's matrices.
const PLACE: usize = 60;
const PLACES: usize = 70;
/// A vertex of a mesh that is on its hull, and a height.
const VERTEX: usize = 1000;
const HEIGHT: usize = 24;
/// An element, or a number of a keyframe or a sensor.
const ELEMENT: usize = 2000;
const NUMBER: usize = 32;

/// One line of the account: its purpose, and its size in bytes.
type Line = (usize, Text);

/// Refuses a scene that does not fit in memory, and names the largest request.
pub(super) fn check_scene(scene: &Scene) -> Result<()> {
    let lines = [
        elements(scene),
        matrix(scene),
        histories(scene),
        meshes(scene),
        hfields(scene),
        keys(scene),
        sensors(scene),
    ];
    let all = lines.iter().fold(0_usize, |sum, (bytes, _)| sum.saturating_add(*bytes));
    if can_be_had(all) {
        return Ok(());
    }
    let most = lines.into_iter().max_by_key(|(bytes, _)| *bytes);
    let (bytes, what) = most.unwrap_or((0, Text::default()));
    Err(Error::Scene(text![
        format!(
            "the model takes about {}, more than the memory has: {} for ",
            size(all),
            size(bytes)
        ),
        what
    ]))
}

/// Bytes of the working space of a world, with room for this many contacts.
fn working_space(model: &Model, contacts: usize) -> usize {
    let elements = model.bodies.len() + model.geoms.len() + model.tendons.len();
    let parts = [(model.nhistory, SAMPLE), (model.row_dofs.len(), PLACES), (elements, ELEMENT)];
    let reserved = contacts * size_of::<Contact<f64>>();
    parts.iter().fold(reserved, |sum, (count, each)| sum + count * each)
}

/// Refuses more working spaces than fit in memory; `field` names the number that sets them.
pub(crate) fn check_spaces(
    model: &Model,
    settings: &Settings,
    spaces: usize,
    field: &str,
) -> Result<()> {
    let bytes = working_space(model, settings.max_contacts).saturating_mul(spaces);
    if can_be_had(bytes) {
        return Ok(());
    }
    let limit = format!("a number whose working space, {}, the memory can hold", size(bytes));
    Err(Error::value(field, spaces, limit))
}

/// Bytes as a text shows them.
fn size(bytes: usize) -> String {
    let units = [(1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB")];
    let bytes = bytes as f64;
    let (unit, word) = units.into_iter().find(|(unit, _)| bytes >= *unit).unwrap_or((1.0, "B"));
    format!("{:.1} {word}", bytes / unit)
}

fn elements(scene: &Scene) -> Line {
    let counts = [
        scene.bodies.len(),
        scene.joints.len(),
        scene.geoms.len(),
        scene.sites.len(),
        scene.tendons.len(),
        scene.actuators.len(),
        scene.equalities.len(),
        scene.pairs.len(),
        scene.sensors.len(),
    ];
    let count: usize = counts.iter().sum();
    (count * ELEMENT, format!("its {count} elements").into())
}

/// The matrix entries of each dof with the dofs before it on its body's way to the world, and of
/// the dofs that a tendon couples with each other.
fn matrix(scene: &Scene) -> Line {
    let mut own = vec![0; scene.bodies.len()];
    for joint in &scene.joints {
        own[joint.body] += joint.kind.dofs();
    }
    let (mut way, mut places) = (own.clone(), 0_usize);
    for (index, body) in scene.bodies.iter().enumerate().skip(1) {
        way[index] += way[body.parent];
        places = places.saturating_add(own[index] * way[index]);
    }
    let nv: usize = own.iter().sum();
    for tendon in &scene.tendons {
        let dofs = tendon.path.iter().map(|stop| match *stop {
            Stop::Joint { joint, .. } => way[scene.joints[joint].body],
            Stop::Site { site } => way[scene.sites[site].body],
            Stop::Geom { geom, .. } => way[scene.geoms[geom].body],
            Stop::Pulley { .. } => 0,
        });
        let dofs = dofs.sum::<usize>().min(nv);
        places = places.saturating_add(dofs.saturating_mul(dofs) / 2);
    }
    (places.saturating_mul(PLACE + PLACES), format!("the mass matrix of its {nv} dofs").into())
}

fn histories(scene: &Scene) -> Line {
    let late = || scene.actuators.iter().enumerate().filter(|(_, a)| a.history() > 0);
    let samples = late().fold(0_usize, |sum, (_, a)| sum.saturating_add(a.history()));
    let bytes = samples.saturating_mul(SAMPLE);
    let Some((index, most)) = late().max_by_key(|(_, a)| a.history()) else {
        return (bytes, Text::default());
    };
    let count = late().count();
    let what = format!("the past controls (nsample) of {count} actuators, most of them for ");
    (bytes, text![what, Text::label(Kind::Actuator, &most.name, index)])
}

fn meshes(scene: &Scene) -> Line {
    let count = |mesh: &crate::scene::Mesh| mesh.vertices.len();
    let vertices: usize = scene.meshes.iter().map(count).sum();
    let most = scene.meshes.iter().max_by_key(|mesh| count(mesh));
    let what = format!("the {vertices} vertices of its meshes{}", named(most.map(|m| &*m.name)));
    (vertices.saturating_mul(VERTEX), what.into())
}

fn hfields(scene: &Scene) -> Line {
    let heights: usize = scene.hfields.iter().map(|field| field.data.len()).sum();
    let most = scene.hfields.iter().max_by_key(|field| field.data.len());
    let name = named(most.map(|field| &*field.name));
    (heights.saturating_mul(HEIGHT), format!("the {heights} heights of its hfields{name}").into())
}

fn keys(scene: &Scene) -> Line {
    let numbers = scene.keys.iter().flat_map(|key| {
        let lists = [&key.qpos, &key.qvel, &key.act, &key.ctrl, &key.mpos, &key.mquat];
        lists.map(|list| list.as_ref().map_or(0, Vec::len))
    });
    let numbers: usize = numbers.sum();
    let count = scene.keys.len();
    let bytes = numbers.saturating_mul(NUMBER).saturating_add(count.saturating_mul(ELEMENT));
    (bytes, format!("its {count} keyframes").into())
}

fn sensors(scene: &Scene) -> Line {
    let numbers =
        scene.sensors.iter().fold(0_usize, |sum, sensor| sum.saturating_add(sensor.size()));
    let most = scene.sensors.iter().enumerate().max_by_key(|(_, sensor)| sensor.size());
    let what = format!("the {numbers} numbers of its sensors");
    let bytes = numbers.saturating_mul(NUMBER);
    let Some((index, most)) = most else { return (bytes, what.into()) };
    (bytes, text![what, ", most of them of ", Text::label(Kind::Sensor, &most.name, index)])
}

/// The name of the largest of some assets, if it has one.
fn named(name: Option<&str>) -> String {
    match name {
        None | Some("") => String::new(),
        Some(name) => format!(", most of them of '{name}'"),
    }
}
