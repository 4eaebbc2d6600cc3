//! Masses of bodies: given, or summed over their geoms, under MJCF's rules.

use super::meshes::Asset;
use super::principal::{seen_from, Axes};
use super::shape::{measure, unit_inertia};
use super::{Model, NONE};
use crate::elements::{text, Kind, Text};
use crate::error::{Error, Result};
use crate::scene::{Geom, GeomType, Scene};
use crate::spatial::{rotation, unit_quat};
use nalgebra::{Matrix3, SymmetricEigen, Vector3};

/// Relative to the trace: below this a principal moment, or the excess of two
/// over the third, is rounding.
const ROUNDING: f64 = 1e-15;
const TRIANGLE: f64 = 1e-10;
/// The same for the off-diagonal rest in axes that are given as principal.
const GIVEN: f64 = 1e-9;
/// Two frames closer than this (radians; parts of the body's size) are one, as in MuJoCo.
const SAME_FRAME: f64 = 1e-6;

/// A body's mass, centre and inertia, while they are computed.
#[derive(Clone, Debug)]
struct Load {
    mass: f64,
    ipos: Vector3<f64>,
    inertia: Matrix3<f64>,
    /// The body's frame is its inertia's frame: MuJoCo's rule for simple bodies.
    aligned: bool,
    axes: Axes,
}

impl Load {
    /// Keeps the axes when moments become equal: a fluid's box has them.
    fn keep_axes(&mut self) {
        self.axes = Axes::Own(self.axes.of(&self.inertia));
    }
}

fn turned(diagonal: Vector3<f64>, rot: &Matrix3<f64>) -> Matrix3<f64> {
    let mut full = rot * Matrix3::from_diagonal(&diagonal) * rot.transpose();
    for (i, j) in [(0, 1), (0, 2), (1, 2)] {
        full[(j, i)] = full[(i, j)];
    }
    full
}

/// Inertia of a point mass at `p`.
fn point_inertia(mass: f64, p: &Vector3<f64>) -> Matrix3<f64> {
    (Matrix3::identity() * p.norm_squared() - p * p.transpose()) * mass
}

/// Inertia of a geom about its centre, in body axes.
fn own_inertia(g: &Geom, asset: &Asset, mass: f64) -> Matrix3<f64> {
    let quat = unit_quat(g.quat);
    match &asset.solid {
        Some(solid) => seen_from(conjugate(quat), &(solid.inertia * mass)),
        None => turned(unit_inertia(g) * mass, &rotation(quat)),
    }
}

fn conjugate([w, x, y, z]: [f64; 4]) -> [f64; 4] {
    [w, -x, -y, -z]
}

/// The sum over the geoms; None if no geom of this body counts.
fn from_geoms(scene: &Scene, assets: &[Asset], geoms: &[usize]) -> Option<Load> {
    let [lo, hi] = scene.mass_rules.group_range;
    let mass_of = |g: &Geom, asset: &Asset| match g.mass {
        _ if matches!(g.kind, GeomType::Plane | GeomType::HField) => 0.0,
        Some(mass) => mass,
        None => g.density * asset.solid.as_ref().map_or_else(|| measure(g), |solid| solid.measure),
    };
    let chosen: Vec<(&Geom, &Asset, f64)> = geoms
        .iter()
        .map(|i| (&scene.geoms[*i], &assets[*i]))
        .map(|(g, asset)| (g, asset, mass_of(g, asset)))
        .filter(|(g, _, mass)| (lo..=hi).contains(&g.group) && *mass > 0.0)
        .collect();
    let mass: f64 = chosen.iter().map(|(.., m)| m).sum();
    if let [(g, asset, _)] = chosen[..] {
        let (ipos, quat) = (Vector3::from(g.pos), unit_quat(g.quat));
        let inertia = own_inertia(g, asset, mass);
        let size = (inertia.trace() / mass).sqrt();
        let aligned = same_frame(&ipos, quat, size);
        return Some(Load { mass, ipos, inertia, aligned, axes: Axes::Own(quat) });
    }
    chosen.first()?;
    let weighed = chosen.iter().map(|(g, _, m)| Vector3::from(g.pos) * *m);
    let ipos = weighed.sum::<Vector3<f64>>() / mass;
    let mut inertia = Matrix3::zeros();
    for (g, asset, m) in &chosen {
        inertia += own_inertia(g, asset, *m);
        inertia += point_inertia(*m, &(Vector3::from(g.pos) - ipos));
    }
    // MuJoCo sorts principal moments in falling order, so a diagonal matrix in
    // another order has a turned frame there.
    let falling = inertia[(0, 0)] >= inertia[(1, 1)] && inertia[(1, 1)] >= inertia[(2, 2)];
    let aligned = falling && centred(mass, &ipos, &inertia) && diagonal(&inertia);
    Some(Load { mass, ipos, inertia, aligned, axes: Axes::Found })
}

fn centred(mass: f64, ipos: &Vector3<f64>, inertia: &Matrix3<f64>) -> bool {
    ipos.amax() <= SAME_FRAME * (inertia.trace() / mass).sqrt()
}

/// The principal axes are the coordinate axes, within the tolerance of frames.
fn diagonal(inertia: &Matrix3<f64>) -> bool {
    [(0, 1), (0, 2), (1, 2)].iter().all(|&(i, j)| {
        let apart = (inertia[(i, i)] - inertia[(j, j)]).abs();
        inertia[(i, j)].abs() <= (2.0 * SAME_FRAME * apart).max(ROUNDING * inertia.trace())
    })
}

fn given(scene: &Scene, body: usize) -> Option<Load> {
    let x = scene.bodies[body].inertial.as_ref()?;
    let [xx, yy, zz, xy, xz, yz] = x.inertia;
    let (ipos, inertia) = (Vector3::from(x.pos), Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz));
    let aligned = (x.mass == 0.0 || centred(x.mass, &ipos, &inertia)) && diagonal(&inertia);
    let axes = x.axes.map_or(Axes::Found, |quat| Axes::Own(unit_quat(quat)));
    Some(Load { mass: x.mass, ipos, inertia, aligned, axes })
}

/// The load of a body without mass. MuJoCo then reads the body's pos and quat as the pose of its
/// inertia; if the body is fixed to a moving one, the inverse weight at that point counts in its
/// contacts.
fn nothing(scene: &Scene, body: usize) -> Load {
    let (ipos, quat) = (Vector3::from(scene.bodies[body].pos), unit_quat(scene.bodies[body].quat));
    let aligned = same_frame(&ipos, quat, 0.0);
    Load { mass: 0.0, ipos, inertia: Matrix3::zeros(), aligned, axes: Axes::Own(quat) }
}

fn same_frame(offset: &Vector3<f64>, quat: [f64; 4], size: f64) -> bool {
    offset.amax() <= SAME_FRAME * size && quat[1..].iter().all(|x| x.abs() < SAME_FRAME)
}

/// Checks that given axes are principal.
fn principal(element: &Text, load: &Load) -> Result<()> {
    let Axes::Own(quat) = load.axes else { return Ok(()) };
    let seen = seen_from(quat, &load.inertia);
    if (seen[(0, 1)].abs().max(seen[(0, 2)].abs()).max(seen[(1, 2)].abs())) <= GIVEN * seen.trace()
    {
        return Ok(());
    }
    let [w, x, y, z] = quat;
    let limit = "the principal axes of the inertia";
    Err(Error::value(text![element, " iquat"], format!("[{w}, {x}, {y}, {z}]"), limit))
}

/// Refuses a negative moment, which no mass rule mends, and, as in MuJoCo, a full matrix with one.
fn positive(element: &Text, load: &Load) -> Result<()> {
    let m = SymmetricEigen::new(load.inertia).eigenvalues;
    let least = if diagonal(&load.inertia) { -ROUNDING } else { ROUNDING };
    if m.min() >= least * m.amax() {
        return Ok(());
    }
    Err(Error::value(
        text![element, " inertia"],
        format!("[{:.3e}, {:.3e}, {:.3e}]", m[0], m[1], m[2]),
        "positive principal moments",
    ))
}

/// Bounds from below, then no principal moment greater than the sum of the others.
fn apply_rules(scene: &Scene, body: usize, load: &mut Load) -> Result<()> {
    let rules = &scene.mass_rules;
    let element = Text::label(Kind::Body, &scene.bodies[body].name, body);
    finite(&element, load)?;
    load.mass = load.mass.max(rules.bound_mass);
    positive(&element, load)?;
    if rules.bound_inertia > 0.0 {
        let eigen = SymmetricEigen::new(load.inertia);
        if eigen.eigenvalues.min() < rules.bound_inertia {
            let raised = eigen.eigenvalues.map(|x| x.max(rules.bound_inertia));
            load.keep_axes();
            load.inertia = turned(raised, &eigen.eigenvectors);
        }
    }
    // Second moments along the axes: their least principal value is (A + B − C)/2.
    let second = Matrix3::identity() * (0.5 * load.inertia.trace()) - load.inertia;
    let trace = load.inertia.trace();
    let fits = trace == 0.0 || SymmetricEigen::new(second / trace).eigenvalues.min() >= -TRIANGLE;
    if fits {
        return Ok(());
    }
    if !rules.balance_inertia {
        let m = SymmetricEigen::new(load.inertia).eigenvalues;
        return Err(Error::value(
            text![element, " inertia"],
            format!("[{:.3e}, {:.3e}, {:.3e}]", m[0], m[1], m[2]),
            "principal moments of which none is greater than the sum of the others; <compiler balanceinertia=\"true\"/>, in a URDF inside <mujoco>, sets each to their mean",
        ));
    }
    load.keep_axes();
    load.inertia = Matrix3::identity() * (load.inertia.trace() / 3.0);
    Ok(())
}

/// Fills mass, centre and inertia of every body and the mass of every tree. Returns which bodies'
/// frames are their inertias' frames, and the axes of the inertias.
pub fn weigh(scene: &Scene, assets: &[Asset], model: &mut Model) -> Result<(Vec<bool>, Vec<Axes>)> {
    let rules = &scene.mass_rules;
    let mut geoms = vec![vec![]; scene.bodies.len()];
    for (i, g) in scene.geoms.iter().enumerate() {
        geoms[g.body].push(i);
    }
    let mut loads = vec![nothing(scene, 0); scene.bodies.len()];
    for i in 1..loads.len() {
        let counted = match (rules.from_geoms, &scene.bodies[i].inertial) {
            (Some(false), _) | (None, Some(_)) => None,
            _ => from_geoms(scene, assets, &geoms[i]),
        };
        loads[i] = counted.or_else(|| given(scene, i)).unwrap_or_else(|| nothing(scene, i));
        principal(&Text::label(Kind::Body, &scene.bodies[i].name, i), &loads[i])?;
        apply_rules(scene, i, &mut loads[i])?;
    }
    let total: f64 = loads.iter().map(|x| x.mass).sum();
    if rules.total_mass > 0.0 && total > 0.0 {
        let scale = rules.total_mass / total;
        for x in &mut loads {
            x.mass *= scale;
            x.inertia *= scale;
        }
    }
    check(scene, model, &loads)?;
    for (body, x) in model.bodies.iter_mut().zip(&loads) {
        (body.mass, body.ipos, body.inertia) = (x.mass, x.ipos, x.inertia);
        body.iquat = x.axes.of(&x.inertia);
        if body.tree != NONE {
            model.trees[body.tree].mass += x.mass;
        }
    }
    Ok(loads.iter().map(|x| (x.aligned, x.axes)).unzip())
}

fn finite(element: &Text, x: &Load) -> Result<()> {
    if x.mass.is_finite() && x.inertia.iter().all(|m| m.is_finite()) {
        return Ok(());
    }
    Err(Error::value(text![element, " mass"], x.mass, "finite, with a finite inertia"))
}

/// Checks that every moving body has mass, itself or in a body that is fixed to it. A point mass
/// may turn about an axis away from it; a mass matrix that is singular at the initial configuration
/// is refused in `invweight`.
fn check(scene: &Scene, model: &Model, loads: &[Load]) -> Result<()> {
    let heavy = |x: &Load| x.mass > 0.0 && (1.0 / x.mass).is_finite();
    for (i, body) in model.bodies.iter().enumerate() {
        let x = &loads[i];
        let element = Text::label(Kind::Body, &scene.bodies[i].name, i);
        finite(&element, x)?;
        if body.joints.len == 0 {
            continue;
        }
        let welded = || (i..loads.len()).filter(|j| model.bodies[*j].weld == i).map(|j| &loads[j]);
        if !welded().any(heavy) {
            let limit = "> 0 kg with a finite inverse, because it moves (give it a geom with mass, or an inertial)";
            return Err(Error::value(text![element, " mass"], x.mass, limit));
        }
    }
    Ok(())
}
