//! Geoms of meshes: each in the frame of its mesh's principal axes, or as the primitive that fits.
//!
//! Measured meshes are kept for the next compilation of any scene with the same mesh: hulls take
//! most of the time of compiling a robot, and measurements compile the same robot with other
//! numbers some hundred times. A mesh is recognised by its content, so the kept result equals a new
//! one to the bit.

use super::lru::Lru;
use super::principal::product;
use super::solid::{Solid, Unsolid};
use crate::elements::{text, Kind, Text};
use crate::error::{Error, Result};
use crate::pool::lock;
use crate::scene::{
    Geom, GeomType, HField, Mesh, MeshInertia, ObjectType, Scene, Sensor, SensorObject, SensorType,
};
use crate::shapes::height_field::HeightField;
use crate::shapes::hull::Hull;
use crate::shapes::ray::Surface;
use crate::spatial::{rotation, unit_quat};
use nalgebra::Vector3;
use std::sync::{Arc, Mutex};

/// The measurements of a mesh. The hull is in the mesh's coordinates.
#[derive(Clone)]
pub struct Measured {
    solid: Arc<Solid>,
    surface: Arc<Surface>,
    hull: Option<Arc<Hull>>,
    /// The hull in the frame of the principal axes.
    aligned: Option<Arc<Hull>>,
}

/// The largest number of vertices and faces kept for all meshes: some 100 MB with their hulls.
const MOST: usize = 1 << 20;

static KEPT: Mutex<Lru<Mesh, Measured>> = Mutex::new(Lru::new(MOST, size));

/// Empties the cache.
pub(super) fn forget() {
    lock(&KEPT).clear();
}

fn size(mesh: &Mesh) -> usize {
    mesh.vertices.len() + mesh.faces.len()
}

/// Compares everything that the measurements depend on, to the bit (0 is not −0); not the name.
fn same(a: &Mesh, b: &Mesh) -> bool {
    let bits = |v: &[f64; 3]| v.map(f64::to_bits);
    a.inertia == b.inertia
        && a.maxhullvert == b.maxhullvert
        && a.vertices.len() == b.vertices.len()
        && a.faces == b.faces
        && a.vertices.iter().map(bits).eq(b.vertices.iter().map(bits))
}

/// The mesh or height field of a geom.
#[derive(Clone, Debug, Default)]
pub struct Asset {
    pub solid: Option<Arc<Solid>>,
    /// The hull of a mesh that collides.
    pub hull: Option<Arc<Hull>>,
    pub field: Option<Arc<HeightField>>,
    pub surface: Option<Arc<Surface>>,
}

/// The geoms of a scene with their assets; the geoms of meshes are in the frames of their meshes,
/// or fitted to them. Each mesh that a geom uses is measured once, or recalled from an earlier
/// scene; unused meshes are not measured.
pub fn placed(scene: &Scene) -> Result<(Vec<Geom>, Vec<Asset>)> {
    let mut measured: Vec<Option<Measured>> = scene.meshes.iter().map(|_| None).collect();
    let mut fields: Vec<Option<Arc<HeightField>>> = vec![None; scene.hfields.len()];
    let mut geoms = scene.geoms.clone();
    let mut assets = vec![Asset::default(); geoms.len()];
    for (i, (geom, asset)) in geoms.iter_mut().zip(&mut assets).enumerate() {
        if let Some(index) = geom.hfield {
            let source = &scene.hfields[index];
            let [x, y, top, base] = source.size;
            geom.size = [x, y, top.max(base)];
            asset.field =
                Some(fields[index].get_or_insert_with(|| Arc::new(height_field(source))).clone());
        }
        let Some(index) = geom.mesh else { continue };
        let named = |error| named(error, &Text::label(Kind::Geom, &geom.name, i));
        let mesh = &scene.meshes[index];
        let known = match &mut measured[index] {
            Some(known) => known,
            empty => empty.insert(match lock(&KEPT).recalled(|other| same(other, mesh)) {
                Some(known) => known,
                None => measure(mesh, index).map_err(named)?,
            }),
        };
        let paired = scene.pairs.iter().any(|pair| [pair.geom1, pair.geom2].contains(&i));
        let met = paired || may_collide(geom) || is_measured(scene, i);
        let has_hull = geom.kind == GeomType::Mesh && met;
        if has_hull && known.aligned.is_none() {
            let hull = match known.hull.take() {
                Some(hull) => hull,
                None => Arc::new(hull_of(mesh, index).map_err(named)?),
            };
            let back = rotation(known.solid.quat).transpose();
            let shift = -(back * known.solid.centre);
            known.aligned = Some(Arc::new(Arc::unwrap_or_clone(hull).moved(&back, &shift)));
        }
        place(geom, &known.solid, scene.mass_rules.fit_aabb);
        if geom.kind == GeomType::Mesh {
            asset.solid = Some(known.solid.clone());
            asset.surface = Some(known.surface.clone());
            asset.hull = known.aligned.clone().filter(|_| has_hull);
        }
    }
    for (mesh, known) in scene.meshes.iter().zip(&measured) {
        known.iter().for_each(|known| lock(&KEPT).keep(mesh.clone(), known.clone(), same));
    }
    Ok((geoms, assets))
}

/// The lowest point of the data becomes 0 and the highest 1, in single precision as MuJoCo stores
/// them, times the height of the highest.
fn height_field(field: &HField) -> HeightField {
    let single = |x: &f64| *x as f32;
    let low = field.data.iter().map(single).fold(f32::INFINITY, f32::min);
    let high = field.data.iter().map(single).fold(f32::NEG_INFINITY, f32::max);
    let [x, y, top, base] = field.size;
    let height = |h: &f64| {
        let share = if high > low { (single(h) - low) / (high - low) } else { 0.0 };
        top * f64::from(share)
    };
    let heights = field.data.iter().map(height).collect();
    HeightField { nrow: field.nrow, ncol: field.ncol, half: [x, y], base, heights }
}

/// Whether its masks let it meet something.
fn may_collide(geom: &Geom) -> bool {
    geom.contype != 0 || geom.conaffinity != 0
}

/// Whether a sensor finds its distance from others.
fn is_measured(scene: &Scene, geom: usize) -> bool {
    use SensorType::{Distance, FromTo, Normal};
    let of_distance = |sensor: &&Sensor| matches!(sensor.kind, Distance | Normal | FromTo);
    let is_its = |object: SensorObject| match object.kind {
        ObjectType::Geom => object.index == geom,
        _ => object.index == scene.geoms[geom].body,
    };
    let sensors = scene.sensors.iter().filter(of_distance);
    sensors.flat_map(|sensor| [sensor.object, sensor.reference]).flatten().any(is_its)
}

/// Prefixes an error about a mesh with the geom that uses it.
fn named(error: Error, geom: &Text) -> Error {
    Error::Scene(text![geom, ": ", error.to_string()])
}

fn label(mesh: &Mesh, index: usize) -> String {
    match &*mesh.name {
        "" => format!("mesh {index}"),
        name => format!("mesh '{name}'"),
    }
}

fn hull_of(mesh: &Mesh, index: usize) -> Result<Hull> {
    let most = mesh.maxhullvert.unwrap_or(usize::MAX);
    let refuse = |error: Error| Error::Scene(format!("{}: {error}", label(mesh, index)).into());
    Hull::of_at_most(&mesh.vertices, most).map_err(refuse)
}

fn measure(mesh: &Mesh, index: usize) -> Result<Measured> {
    let by_hull = mesh.faces.is_empty() || mesh.inertia == MeshInertia::Convex;
    let hull = if by_hull { Some(hull_of(mesh, index)?) } else { None };
    let solid = match &hull {
        Some(hull) => {
            let point = |corner: usize| hull.source[corner];
            let faces: Vec<_> = hull.triangles.iter().map(|face| face.map(point)).collect();
            Solid::of(&mesh.vertices, &faces, mesh.inertia)
        }
        None => {
            if mesh.inertia == MeshInertia::Exact {
                consistent(mesh, index)?;
            }
            Solid::of(&mesh.vertices, &mesh.faces, mesh.inertia)
        }
    };
    let solid = solid.map_err(|why| {
        let words = match why {
            Unsolid::Nothing => "its volume is 0: give it inertia \"shell\", or use a thin box",
            Unsolid::InsideOut => {
                "its volume is negative: the corners of its faces must be counter-clockwise seen from outside"
            }
        };
        Error::Scene(format!("{}: {words}", label(mesh, index)).into())
    })?;
    let faces = match &hull {
        Some(hull) if mesh.faces.is_empty() => {
            Arc::new(hull.triangles.iter().map(|face| face.map(|at| hull.source[at])).collect())
        }
        _ => mesh.faces.clone(),
    };
    let surface = Surface {
        vertices: mesh.vertices.clone(),
        faces,
        centre: solid.centre,
        turn: rotation(solid.quat),
        low: solid.low,
        high: solid.high,
    };
    let hull = hull.map(Arc::new);
    Ok(Measured { solid: Arc::new(solid), surface: Arc::new(surface), hull, aligned: None })
}

/// Checks that no two faces run along an edge in the same direction: the surface has an outside.
fn consistent(mesh: &Mesh, index: usize) -> Result<()> {
    let mut edges: Vec<(usize, usize)> = Vec::with_capacity(3 * mesh.faces.len());
    for &[a, b, c] in mesh.faces.iter() {
        if a != b && b != c && c != a {
            edges.extend([(a, b), (b, c), (c, a)]);
        }
    }
    edges.sort_unstable();
    let Some(pair) = edges.windows(2).find(|pair| pair[0] == pair[1]) else { return Ok(()) };
    let (a, b) = pair[0];
    let words = format!(
        "{}: two faces run from vertex {a} to vertex {b}, so that it has no outside: turn one over, \
         or use another inertia than \"exact\"",
        label(mesh, index)
    );
    Err(Error::Scene(words.into()))
}

/// Moves a geom from its mesh file's coordinates to the mesh's frame; fits a primitive to it.
fn place(geom: &mut Geom, solid: &Solid, aabb: bool) {
    let mut centre = solid.centre;
    let turned = rotation(solid.quat);
    if geom.kind == GeomType::Mesh {
        // As in MuJoCo: the largest coordinates, which are not half of the extents.
        geom.size = crate::real::array::from_fn(|k| solid.low[k].abs().max(solid.high[k].abs()));
    } else {
        let half = if aabb {
            centre += turned * (solid.low + solid.high) * 0.5;
            (solid.high - solid.low) * 0.5
        } else {
            inertia_box(solid)
        };
        geom.size = fitted(geom.kind, &half, aabb).map(|x| x * geom.fitscale);
        geom.mesh = None;
    }
    let quat = unit_quat(geom.quat);
    if geom.surfacevel != [0.0; 6] {
        // The same field in the new frame.
        let [x, y, z, a, b, c] = geom.surfacevel;
        let (slide, turn) = (Vector3::new(x, y, z), Vector3::new(a, b, c));
        let back = rotation(solid.quat).transpose();
        let (slide, turn) = (back * (slide + turn.cross(&centre)), back * turn);
        geom.surfacevel = [slide.x, slide.y, slide.z, turn.x, turn.y, turn.z];
    }
    geom.pos = (Vector3::from(geom.pos) + rotation(quat) * centre).into();
    geom.quat = unit_quat(product(quat, solid.quat));
}

/// Half sizes of the box with the same inertia as the mesh, both of unit mass: a solid box has
/// Σ over the other two axes of s²/3; a thin shell's is close.
fn inertia_box(solid: &Solid) -> Vector3<f64> {
    let m = solid.inertia.diagonal();
    let half = |i: usize| (1.5 * (m.sum() - 2.0 * m[i])).max(0.0).sqrt();
    Vector3::new(half(0), half(1), half(2))
}

/// The size of a primitive fitted to a box of these half sizes: about as much inside as outside, or
/// around it for a bounding box.
fn fitted(kind: GeomType, half: &Vector3<f64>, aabb: bool) -> [f64; 3] {
    let (x, y, z) = (half.x, half.y, half.z);
    let across = if aabb { x.max(y) } else { 0.5 * (x + y) };
    match kind {
        GeomType::Sphere if aabb => [x.max(y).max(z), 0.0, 0.0],
        GeomType::Sphere => [(x + y + z) / 3.0, 0.0, 0.0],
        GeomType::Capsule if aabb => [across, (z - across).max(0.0), 0.0],
        GeomType::Capsule => [across, (z - 0.5 * across).max(0.0), 0.0],
        GeomType::Cylinder => [across, z, 0.0],
        _ => [x, y, z],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube(half: f64) -> Mesh {
        let corner =
            |i: usize| crate::real::array::from_fn(|k| if i >> k & 1 == 1 { half } else { -half });
        Mesh { vertices: Arc::new((0..8).map(corner).collect()), ..Mesh::default() }
    }

    fn hull_of(mesh: Mesh) -> Arc<crate::shapes::hull::Hull> {
        let geom = Geom { kind: GeomType::Mesh, mesh: Some(0), contype: 1, ..Geom::default() };
        let scene = Scene { meshes: vec![mesh], geoms: vec![geom], ..Scene::default() };
        placed(&scene).unwrap().1[0].hull.clone().unwrap()
    }

    #[test]
    fn the_same_content_is_the_same_hull_and_any_other_bit_is_another() {
        let first = hull_of(cube(0.731));
        let renamed = Mesh { name: "other".into(), ..cube(0.731) };
        assert!(Arc::ptr_eq(&first, &hull_of(renamed)));
        let next = f64::from_bits(0.731_f64.to_bits() + 1);
        assert!(!Arc::ptr_eq(&first, &hull_of(cube(next))));
        let shell = Mesh { inertia: MeshInertia::Shell, ..cube(0.731) };
        assert!(!Arc::ptr_eq(&first, &hull_of(shell)));
        let fewer = hull_of(Mesh { maxhullvert: Some(4), ..cube(0.731) });
        assert_eq!((first.vertices.len(), fewer.vertices.len()), (8, 4));
    }
}
