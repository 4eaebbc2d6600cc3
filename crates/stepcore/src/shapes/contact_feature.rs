//! The feature of a shape that meets another one: a face, an edge or a point.

use super::solid::{Core, Solid, PRISM_FACES};
use crate::real::Real;
use crate::spatial::V3;

/// Largest number of corners of a face; a face with more keeps this many at equal steps.
pub const CORNERS: usize = 48;

/// Cosine of the angle between a face and the normal up to which the face lies against the other shape,
/// and sine of an edge's: MuJoCo 4's values, found by turning boxes and capsules.
const FACE: f64 = 0.996;
const EDGE: f64 = 0.0888;

/// Cosine and sine of π/8: corners of a cylinder's cap are at odd multiples.
const EIGHTH: (f64, f64) = (0.923_879_532_511_286_7, 0.382_683_432_365_089_8);

/// A corner relative to the first shape's centre, and its number on its shape.
#[derive(Clone, Copy)]
pub struct Corner<R: Real> {
    pub at: V3<R>,
    pub name: usize,
}

/// A face: its corners in order, and the plane normal · x = offset that it lies in.
pub struct Polygon<R: Real> {
    pub corners: [Corner<R>; CORNERS],
    pub count: usize,
    pub normal: V3<R>,
    pub offset: R,
    /// For a cylinder's cap, whose corners represent a circle: its centre and radius.
    pub circle: Option<(V3<R>, R)>,
}

#[allow(clippy::large_enum_variant)] // One of each shape, on the stack.
pub enum Feature<R: Real> {
    Face(Polygon<R>),
    Edge([Corner<R>; 2]),
    Point,
}

/// Returns the feature of a shape with its centre at `centre` that is furthest along a unit direction.
pub fn feature<R: Real>(solid: &Solid<R>, centre: &V3<R>, along: &V3<R>) -> Feature<R> {
    match face(solid, centre, along) {
        Some(polygon) => Feature::Face(polygon),
        None => edge(solid, centre, along).map_or(Feature::Point, Feature::Edge),
    }
}

fn face<R: Real>(solid: &Solid<R>, centre: &V3<R>, along: &V3<R>) -> Option<Polygon<R>> {
    let (normal, cosine, face) = solid.face(along)?;
    if cosine < FACE {
        return None;
    }
    let none = Corner { at: V3::zeros(), name: 0 };
    let mut out =
        Polygon { corners: [none; CORNERS], count: 0, normal, offset: R::zero(), circle: None };
    let mut add = |at: V3<R>, name: usize| {
        if out.count < CORNERS {
            out.corners[out.count] = Corner { at: centre + at, name };
            out.count += 1;
        }
    };
    match solid.core {
        Core::Box(_) => {
            let (axis, up) = (face / 2, face % 2);
            let (i, k) = ((axis + 1) % 3, (axis + 2) % 3);
            for (a, b) in [(0, 0), (1, 0), (1, 1), (0, 1)] {
                let corner = up << axis | a << i | b << k;
                add(solid.corner(corner), corner);
            }
        }
        Core::Cylinder(radius, half) => {
            let (c, s) = EIGHTH;
            let round = [(c, s), (s, c), (-s, c), (-c, s), (-c, -s), (-s, -c), (s, -c), (c, -s)];
            let height = if face == 1 { half } else { -half };
            for (k, (x, y)) in round.iter().enumerate() {
                let local = V3::new(radius * x, radius * y, height);
                add(solid.pose.to_world(&local.map(R::of)), 8 * face + k);
            }
        }
        Core::Hull(hull) => {
            let corners = &hull.faces[face].corners;
            let count = corners.len().min(CORNERS);
            for k in 0..count {
                let corner = corners[k * corners.len() / count];
                add(solid.corner(corner), corner);
            }
        }
        Core::Prism(_) => PRISM_FACES[face].iter().for_each(|c| add(solid.corner(*c), *c)),
        _ => return None,
    }
    if let Core::Cylinder(radius, half) = solid.core {
        out.circle = Some((centre + normal * R::of(half), R::of(radius)));
    }
    // The furthest corner: faces of files in single precision are flat except for rounding.
    let height = |corner: &Corner<R>| normal.dot(&corner.at);
    out.offset = height(&out.corners[0]);
    for corner in &out.corners[1..out.count] {
        out.offset = out.offset.max(height(corner));
    }
    Some(out)
}

fn edge<R: Real>(solid: &Solid<R>, centre: &V3<R>, along: &V3<R>) -> Option<[Corner<R>; 2]> {
    let plain = |v: &V3<R>| v.map(|x| x.lane(0));
    let direction = plain(along);
    let ends = |a: (V3<R>, usize), b: (V3<R>, usize)| {
        [a, b].map(|(at, name)| Corner { at: centre + at, name })
    };
    match solid.core {
        Core::Segment(_) => {
            let axis = solid.pose.axis(2);
            let across = plain(&axis).dot(&direction).abs() <= EDGE;
            across.then(|| ends((solid.corner(0), 0), (solid.corner(1), 1)))
        }
        Core::Cylinder(radius, half) => {
            let axis = solid.pose.axis(2);
            if plain(&axis).dot(&direction).abs() > EDGE {
                return None;
            }
            let out = along - axis * axis.dot(along);
            let side = out * (R::of(radius) / out.dot(&out).sqrt());
            let reach = axis * R::of(half);
            Some(ends((side - reach, 0), (side + reach, 1)))
        }
        Core::Box(_) | Core::Hull(_) | Core::Prism(_) => {
            let corner = solid.support(along).1;
            let here = solid.corner(corner);
            let mut best = (EDGE, None);
            let mut k = 0;
            while let Some(next) = solid.neighbour(corner, k) {
                let way = plain(&(solid.corner(next) - here));
                let sine = (way.dot(&direction) / way.dot(&way).sqrt()).abs();
                if sine <= best.0 {
                    best = (sine, Some(next));
                }
                k += 1;
            }
            // From the lower number to the higher: the order keeps its meaning.
            let next = best.1?;
            let (a, b) = (corner.min(next), corner.max(next));
            Some(ends((solid.corner(a), a), (solid.corner(b), b)))
        }
        Core::Point | Core::Ellipsoid(_) => None,
    }
}
