//! The fluid around the bodies, compiled: which shapes it resists, and the coefficients of each
//! shape. MuJoCo documentation, "Fluid forces".

use super::parts::{Body, Geom, Span, NONE};
use super::principal::{seen_from, Axes};
use crate::real::elementary::pow;
use crate::scene::{self, FluidShape, GeomType, Scene};
use crate::spatial::rotation;
use nalgebra::{Matrix3, Vector3};
use std::f64::consts::PI;

/// The fluid and the shapes that it resists.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Fluid {
    /// Velocity of the fluid [m/s].
    pub wind: Vector3<f64>,
    pub parts: Vec<Part>,
    /// For each body, into `parts`.
    pub of_body: Vec<Span>,
}

/// A shape on a body.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// Its frame in the body's [m].
    pub pos: Vector3<f64>,
    pub rot: Matrix3<f64>,
    /// Force [N·s/m] and moment [N·m·s] by a velocity: Stokes' for a sphere.
    pub viscous: [f64; 2],
    pub shape: Shape,
}

/// A shape's resistance that grows with the square of a velocity.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A box, axis by axis: force [N·s²/m²] and moment [N·m·s²].
    Box {
        force: Vector3<f64>,
        moment: Vector3<f64>,
    },
    Ellipsoid(Box<Ellipsoid>),
}

/// The coefficients of an ellipsoid of semi-axes r. Areas, volumes and moments are multiplied by
/// the fluid's density.
#[derive(Clone, Debug, PartialEq)]
pub struct Ellipsoid {
    /// (r_j r_k)² divided by the largest of the three: they give the area across a velocity.
    pub across: Vector3<f64>,
    /// π r_j r_k of the largest one, and of the largest projection.
    pub area: f64,
    pub most_area: f64,
    /// Drag of the part across the velocity, and of the rest.
    pub blunt: f64,
    pub slender: f64,
    /// Moment by ω |Kω|: K.
    pub turning: Vector3<f64>,
    /// Lift: by circulation (Kutta), and by the body's rotation (Magnus).
    pub kutta: f64,
    pub magnus: f64,
    /// Mass [kg] and moment of inertia [kg·m²] of the fluid that moves with it.
    pub mass: Vector3<f64>,
    pub inertia: Vector3<f64>,
}

/// The resisting shapes of these bodies. `axes`: the principal axes of each inertia.
pub fn of_bodies(scene: &Scene, axes: &[Axes], bodies: &[Body], geoms: &[Geom]) -> Fluid {
    let of_body = vec![Span::default(); bodies.len()];
    let mut fluid = Fluid { wind: Vector3::from(scene.wind), parts: vec![], of_body };
    let off = !scene.features.spring && !scene.features.damper;
    if off || !(scene.density > 0.0 || scene.viscosity > 0.0) {
        return fluid;
    }
    for (index, body) in bodies.iter().enumerate().skip(1) {
        if body.tree == NONE || body.mass <= 0.0 {
            continue;
        }
        let start = fluid.parts.len();
        let own = scene.geoms.iter().zip(geoms).filter(|(_, geom)| geom.body == index);
        for (source, geom) in own {
            if source.fluidshape == FluidShape::Ellipsoid {
                fluid.parts.push(Part {
                    pos: geom.pos,
                    rot: rotation(geom.quat),
                    viscous: viscous(scene, &semiaxes(geom.kind, &geom.size)),
                    shape: ellipsoid(scene, source, semiaxes(geom.kind, &geom.size)),
                });
            }
        }
        if fluid.parts.len() == start {
            let quat = axes[index].of(&body.inertia);
            let moments = seen_from(quat, &body.inertia).diagonal() / body.mass;
            let half = |i: usize| (1.5 * (moments.sum() - 2.0 * moments[i])).max(0.0).sqrt();
            let half = Vector3::new(half(0), half(1), half(2));
            fluid.parts.push(Part {
                pos: body.ipos,
                rot: rotation(quat),
                viscous: viscous(scene, &half),
                shape: box_of(scene, &half),
            });
        }
        let len = fluid.parts.len() - start;
        fluid.of_body[index] = Span { start, len };
    }
    fluid
}

fn semiaxes(kind: GeomType, &[a, b, c]: &[f64; 3]) -> Vector3<f64> {
    match kind {
        GeomType::Sphere => Vector3::new(a, a, a),
        GeomType::Capsule => Vector3::new(a, a, a + b),
        GeomType::Cylinder => Vector3::new(a, a, b),
        _ => Vector3::new(a, b, c),
    }
}

/// 6 π μ r and 8 π μ r³ at the mean half size.
fn viscous(scene: &Scene, half: &Vector3<f64>) -> [f64; 2] {
    let r = half.sum() / 3.0;
    [6.0 * PI * scene.viscosity * r, 8.0 * PI * scene.viscosity * r * r * r]
}

/// 2 ρ r_j r_k and ρ r_i (r_j⁴ + r_k⁴)/2.
fn box_of(scene: &Scene, r: &Vector3<f64>) -> Shape {
    let each = |of: &dyn Fn(f64, f64, f64) -> f64| {
        Vector3::new(of(r.x, r.y, r.z), of(r.y, r.z, r.x), of(r.z, r.x, r.y)) * scene.density
    };
    let fourth = |x: f64| x * x * x * x;
    Shape::Box {
        force: each(&|_, j, k| 2.0 * j * k),
        moment: each(&|i, j, k| 0.5 * i * (fourth(j) + fourth(k))),
    }
}

fn ellipsoid(scene: &Scene, geom: &scene::Geom, r: Vector3<f64>) -> Shape {
    let [blunt, slender, angular, kutta, magnus] = geom.fluidcoef;
    let (x, y, z) = (r.x, r.y, r.z);
    let density = scene.density;
    let (most, least) = (r.max(), r.min());
    let middle = r.sum() - most - least;
    let squares = Vector3::new(y * z, z * x, x * y).map(|area| area * area);
    let largest = squares.max();
    // The moment of the ellipsoid that is swept by turning about an axis.
    let swept = |i: f64, j: f64, k: f64| 8.0 / 15.0 * PI * i * j.max(k).powi(4);
    let swept = Vector3::new(swept(x, y, z), swept(y, z, x), swept(z, x, y));
    let most_swept = 8.0 / 15.0 * PI * middle * most.powi(4);
    let volume = 4.0 / 3.0 * PI * x * y * z;
    let (mass, inertia) = moved(&r, volume);
    Shape::Ellipsoid(Box::new(Ellipsoid {
        across: if largest > 0.0 { squares / largest } else { squares },
        area: density * PI * largest.sqrt(),
        most_area: density * PI * most * middle,
        blunt,
        slender,
        turning: swept.map(|own| density * (angular * own + slender * (most_swept - own))),
        kutta,
        magnus: density * volume * magnus,
        mass: mass * density,
        inertia: inertia * density,
    }))
}

/// Volume and moment of the fluid that moves with an ellipsoid (Lamb 1932, chapter 5; Tuckerman
/// 1925), at density one.
fn moved(r: &Vector3<f64>, volume: f64) -> (Vector3<f64>, Vector3<f64>) {
    // Dimensionless: depends on the shape only.
    let (x, y, z) = (r.x / r.max(), r.y / r.max(), r.z / r.max());
    let kappa = Vector3::new(kappa(x, y, z), kappa(y, z, x), kappa(z, x, y));
    let mass = kappa.map(|k| volume * k / (2.0 - k).max(MARGIN));
    let moment = |i: usize| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        let (square, sum) = (r[j] * r[j] - r[k] * r[k], r[j] * r[j] + r[k] * r[k]);
        let apart = kappa[k] - kappa[j];
        let below = (2.0 * square - sum * apart).abs();
        volume / 5.0 * square * square * apart.abs() / below.max(MARGIN * sum)
    };
    (mass, Vector3::new(moment(0), moment(1), moment(2)))
}

/// Relative to one: anything smaller is a quotient of roundings.
const MARGIN: f64 = 1e-15;

/// Half of the nodes of the 15-point rule of Gauss and Kronrod on [0, 1], and their weights, to
/// MuJoCo's digits.
const NODES: [f64; 8] =
    [0.00427231, 0.02544604, 0.06756779, 0.12923441, 0.20695638, 0.29707742, 0.39610752, 0.5];
const WEIGHTS: [f64; 8] = [
    0.01146766, 0.03154605, 0.05239501, 0.07032663, 0.08450236, 0.09517529, 0.10221647, 0.10474107,
];

/// κ = ∫₀^∞ x y z dλ / √((x² + λ)³ (y² + λ) (z² + λ)), with λ = s t³/(1 − t)² and
/// s = (x³ y z)^(2/5).
fn kappa(x: f64, y: f64, z: f64) -> f64 {
    let scale = pow(x * x * x * y * z, 0.4);
    let at = |t: f64, weight: f64| {
        let left = 1.0 - t;
        let lambda = scale * (t * t * t / (left * left));
        let rate = t * t * (3.0 - t) / (left * left * left);
        let along = |r: f64| 1.0 + lambda / (r * r);
        weight * scale * rate / (along(x) * (along(x) * along(y) * along(z)).sqrt())
    };
    let mut sum = 0.0;
    for (t, weight) in NODES.iter().zip(WEIGHTS) {
        sum += at(*t, weight);
        if *t < 0.5 {
            sum += at(1.0 - t, weight);
        }
    }
    sum / (x * x)
}
