//! A shape for the convex routine: its furthest point along a direction, the motion of this point as
//! the direction turns, and its corners, edges and faces.
//!
//! A shape is a core and a radius around it: a sphere is a point and a radius, a capsule a segment and
//! a radius, all others have radius 0. A radius lengthens the reach along every direction by the same
//! length, so it changes distances and nothing else. Points are in world axes, from the shape's centre.

use super::hull::{Face, Hull};
use crate::real::Real;
use crate::spatial::{Pose, V3};

/// A shape without its radius.
#[derive(Clone, Copy)]
pub enum Core<'a> {
    Point,
    /// Half the length, along z.
    Segment(f64),
    /// Half axes.
    Ellipsoid([f64; 3]),
    /// Radius and half the length, along z.
    Cylinder(f64, f64),
    /// Half sizes.
    Box([f64; 3]),
    Hull(&'a Hull),
    Prism(&'a Prism),
}

/// Six corners: a triangle, and below or above each of its corners the other triangle's; and the
/// outward normals of its faces.
#[derive(Clone, Copy)]
pub struct Prism {
    pub corners: [V3<f64>; 6],
    normals: [V3<f64>; 5],
}

impl Prism {
    #[inline(never)]
    pub fn of(corners: [V3<f64>; 6]) -> Self {
        Self { corners, normals: PRISM_FACES.map(|face| normal_of(&corners, face)) }
    }
}

/// A shape and its orientation.
#[derive(Clone, Copy)]
pub struct Solid<'a, R: Real> {
    pub core: Core<'a>,
    pub radius: f64,
    pub pose: &'a Pose<R>,
}

/// Sine of an angle that is only rounding.
const LEVEL: f64 = 1e-13;
/// The two other corners of a prism's triangle, and the one across.
const PRISM: [[usize; 3]; 6] = [[1, 2, 3], [2, 0, 4], [0, 1, 5], [5, 4, 0], [3, 5, 1], [4, 3, 2]];

impl<'a, R: Real> Solid<'a, R> {
    /// Returns the largest half extent, for tolerances [m].
    pub fn extent(&self) -> f64 {
        let core = match self.core {
            Core::Point => 0.0,
            Core::Segment(half) => half,
            Core::Ellipsoid(size) | Core::Box(size) => size[0].max(size[1]).max(size[2]),
            Core::Cylinder(radius, half) => radius.max(half),
            Core::Hull(hull) => hull.reach(),
            Core::Prism(prism) => prism.corners.iter().flat_map(|c| c.iter()).fold(0.0, far),
        };
        core + self.radius
    }

    /// Checks that its surface bends: a search over directions ends near the answer and not at it.
    pub fn smooth(&self) -> bool {
        matches!(self.core, Core::Ellipsoid(_) | Core::Cylinder(..))
    }

    /// Returns the furthest point of the core along a direction of any length, and its corner.
    pub fn support(&self, direction: &V3<R>) -> (V3<R>, usize) {
        let (local, corner) = self.support_local(&self.pose.to_local(direction));
        (self.pose.to_world(&local), corner)
    }

    /// Does the same from a corner that was the furthest along a direction near this one.
    pub fn support_from(&self, corner: usize, direction: &V3<R>) -> (V3<R>, usize) {
        let Core::Hull(hull) = self.core else { return self.support(direction) };
        let local = self.pose.to_local(direction).map(|x| x.lane(0));
        let corner = hull.support_from(corner, &local);
        (self.pose.to_world(&hull.vertices[corner].map(R::of)), corner)
    }

    fn support_local(&self, d: &V3<R>) -> (V3<R>, usize) {
        let zero = R::zero();
        let side = |x: R, half: f64| R::of(if x.lane(0) >= 0.0 { half } else { -half });
        match self.core {
            Core::Point => (V3::zeros(), 0),
            Core::Segment(half) => {
                (V3::new(zero, zero, side(d.z, half)), usize::from(d.z.lane(0) >= 0.0))
            }
            Core::Ellipsoid(size) => {
                // x = A² d/|A d| with A the half axes: the gradient of |A d|.
                let scaled = V3::from_fn(|i, _| R::of(size[i]) * d[i]);
                let inverse = scaled.dot(&scaled).sqrt().recip_or_zero();
                (V3::from_fn(|i, _| R::of(size[i]) * (scaled[i] * inverse)), 0)
            }
            Core::Cylinder(radius, half) => {
                let across = (d.x * d.x + d.y * d.y).sqrt();
                let scale = R::of(radius) * across.recip_or_zero();
                (V3::new(d.x * scale, d.y * scale, side(d.z, half)), 0)
            }
            Core::Box(size) => {
                let corner = (0..3).fold(0, |c, i| c | usize::from(d[i].lane(0) >= 0.0) << i);
                (V3::from_fn(|i, _| side(d[i], size[i])), corner)
            }
            Core::Hull(hull) => {
                let corner = hull.support(&d.map(|x| x.lane(0)));
                (hull.vertices[corner].map(R::of), corner)
            }
            Core::Prism(Prism { corners, .. }) => {
                let plain = d.map(|x| x.lane(0));
                let mut best = 0;
                for i in 1..6 {
                    if corners[i].dot(&plain) > corners[best].dot(&plain) {
                        best = i;
                    }
                }
                (corners[best].map(R::of), best)
            }
        }
    }

    /// Returns its piece that reaches furthest: a corner, or an end of a cylinder.
    pub fn piece(&self, direction: &V3<R>) -> usize {
        match self.core {
            Core::Cylinder(..) => usize::from(self.pose.axis(2).dot(direction).lane(0) >= 0.0),
            _ => self.support(direction).1,
        }
    }

    /// Returns the furthest point of one of its pieces.
    pub fn pinned(&self, piece: usize, direction: &V3<R>) -> V3<R> {
        match self.core {
            Core::Cylinder(_, half) => {
                let axis = self.pose.axis(2);
                let far = axis.dot(direction).lane(0) >= 0.0;
                let point = self.support(direction).0;
                match (far, piece == 1) {
                    (true, false) => point - axis * R::of(2.0 * half),
                    (false, true) => point + axis * R::of(2.0 * half),
                    _ => point,
                }
            }
            Core::Ellipsoid(_) => self.support(direction).0,
            _ => self.corner(piece),
        }
    }

    /// Returns the distance of a point (from the centre) outside of the core, to first order; or minus
    /// its depth.
    pub fn outside(&self, point: &V3<f64>) -> f64 {
        let p = plain(self.pose).to_local(point);
        match self.core {
            Core::Point => p.dot(&p).sqrt(),
            Core::Segment(half) => {
                let z = p.z - p.z.clamp(-half, half);
                (p.x * p.x + p.y * p.y + z * z).sqrt()
            }
            // x over the half axes has length 1 on the surface: the excess over 1, over its slope.
            Core::Ellipsoid(size) => {
                let level = V3::from_fn(|i, _| p[i] / size[i]);
                let slope = V3::from_fn(|i, _| level[i] / size[i]);
                let (length, steep) = (level.dot(&level).sqrt(), slope.dot(&slope).sqrt());
                (length - 1.0) * length * steep.recip_or_zero()
            }
            Core::Cylinder(radius, half) => {
                ((p.x * p.x + p.y * p.y).sqrt() - radius).max(p.z.abs() - half)
            }
            Core::Box(size) => {
                (0..3).map(|i| p[i].abs() - size[i]).fold(f64::NEG_INFINITY, f64::max)
            }
            Core::Hull(hull) => hull.outside(&p),
            Core::Prism(Prism { corners, normals }) => (PRISM_FACES.iter().zip(normals))
                .map(|(face, normal)| normal.dot(&(p - corners[face[0]])))
                .fold(f64::NEG_INFINITY, f64::max),
        }
    }

    /// Returns the distance of a point (from the centre) from the sides of a face, in the projection
    /// along its normal; negative outside the face, and for a face that is not level.
    pub fn room(&self, face: usize, point: &V3<f64>) -> f64 {
        let p = plain(self.pose).to_local(point);
        match self.core {
            Core::Cylinder(radius, _) => radius - (p.x * p.x + p.y * p.y).sqrt(),
            Core::Box(size) => {
                let [i, k] = [1, 2].map(|further| (face / 2 + further) % 3);
                (size[i] - p[i].abs()).min(size[k] - p[k].abs())
            }
            Core::Hull(hull) => {
                let Face { normal, corners, level, .. } = &hull.faces[face];
                if !level {
                    return f64::NEG_INFINITY;
                }
                within(&p, normal, corners.len(), |k| hull.vertices[corners[k]])
            }
            Core::Prism(Prism { corners: all, normals }) => {
                let (corners, normal) = (PRISM_FACES[face], normals[face]);
                // They run either way around.
                let [one, other] = [normal, -normal]
                    .map(|normal| within(&p, &normal, corners.len(), |k| all[corners[k]]));
                one.max(other)
            }
            Core::Point | Core::Segment(_) | Core::Ellipsoid(_) => f64::NEG_INFINITY,
        }
    }

    /// Returns the middle of a level face, from the centre.
    pub fn middle(&self, face: usize) -> Option<V3<f64>> {
        let local = match self.core {
            Core::Cylinder(_, half) => V3::z() * if face == 1 { half } else { -half },
            Core::Box(size) => on_box_face(face, &size, V3::zeros()),
            Core::Hull(hull) => {
                let Face { corners, level: true, .. } = &hull.faces[face] else { return None };
                let sum = corners.iter().fold(V3::zeros(), |sum, k| sum + hull.vertices[*k]);
                sum * (1.0 / corners.len() as f64)
            }
            _ => return None,
        };
        Some(plain(self.pose).to_world(&local))
    }

    /// Returns, of the places furthest along a unit direction within rounding, one that is nearest to a
    /// point: a corner, or a place of a face or of an edge.
    #[inline(never)]
    pub fn furthest_near(&self, direction: &V3<R>, to: &V3<f64>) -> V3<f64> {
        let plain_of = |v: &V3<R>| v.map(|x| x.lane(0));
        let n = plain_of(direction);
        let face = self.face(direction).filter(|(normal, ..)| {
            let lean = plain_of(normal).cross(&n);
            lean.dot(&lean) <= LEVEL * LEVEL
        });
        if let Some(place) = face.and_then(|(.., face)| self.nearest(face, to)) {
            return place;
        }
        let (here, corner) = self.support(direction);
        let here = plain_of(&here);
        let mut best = here;
        let mut along = |there: V3<f64>| {
            let (way, place) = (there - here, on_segment(&here, &there, to));
            let level = way.dot(&n) * way.dot(&n) <= LEVEL * LEVEL * way.dot(&way);
            if level && (place - to).dot(&(place - to)) < (best - to).dot(&(best - to)) {
                best = place;
            }
        };
        if let Core::Cylinder(_, half) = self.core {
            let axis = plain_of(&self.pose.axis(2));
            along(here - axis * (2.0 * half).copysign(axis.dot(&here)));
        }
        (0..).map_while(|k| self.fold(corner, k)).for_each(|k| along(plain_of(&self.corner(k))));
        best
    }

    fn nearest(&self, face: usize, to: &V3<f64>) -> Option<V3<f64>> {
        let pose = plain(self.pose);
        let p = pose.to_local(to);
        let local = match self.core {
            Core::Cylinder(radius, half) => {
                let share = (radius * (p.x * p.x + p.y * p.y).sqrt().recip_or_zero()).min(1.0);
                V3::new(p.x * share, p.y * share, if face == 1 { half } else { -half })
            }
            Core::Box(size) => on_box_face(face, &size, p),
            Core::Hull(hull) => {
                let Face { normal, corners, level: true, .. } = &hull.faces[face] else {
                    return None;
                };
                let corner = |k: usize| hull.vertices[corners[k % corners.len()]];
                let foot = p - normal * normal.dot(&(p - corner(0)));
                if within(&p, normal, corners.len(), corner) >= 0.0 {
                    foot
                } else {
                    let sides =
                        (0..corners.len()).map(|k| on_segment(&corner(k), &corner(k + 1), &p));
                    let square = |x: &V3<f64>| (x - foot).dot(&(x - foot));
                    sides.min_by(|a, b| square(a).total_cmp(&square(b)))?
                }
            }
            _ => return None,
        };
        Some(pose.to_world(&local))
    }

    /// Returns the motion of the furthest point as the unit direction turns by a small `turn` across
    /// it: the second derivative of the reach, times `turn`. 0 at a corner.
    pub fn bend(&self, direction: &V3<f64>, turn: &V3<f64>) -> V3<f64> {
        let pose = plain(self.pose);
        let (d, t) = (pose.to_local(direction), pose.to_local(turn));
        let local = match self.core {
            // (A² − x xᵀ)/|A d| with x = A² d/|A d|.
            Core::Ellipsoid(size) => {
                let scaled = V3::from_fn(|i, _| size[i] * d[i]);
                let inverse = scaled.dot(&scaled).sqrt().recip_or_zero();
                let x = V3::from_fn(|i, _| size[i] * (scaled[i] * inverse));
                let along = x.dot(&t);
                V3::from_fn(|i, _| (size[i] * (size[i] * t[i]) - x[i] * along) * inverse)
            }
            // The rim: r/|d_xy| times the part along the rim.
            Core::Cylinder(radius, _) => {
                let inverse = (d.x * d.x + d.y * d.y).sqrt().recip_or_zero();
                let rim = V3::new(-d.y * inverse, d.x * inverse, 0.0);
                rim * (radius * inverse * rim.dot(&t))
            }
            _ => V3::zeros(),
        };
        pose.to_world(&local)
    }

    /// Returns a corner of a polytope or an end of a segment, from the centre.
    pub fn corner(&self, corner: usize) -> V3<R> {
        let local = match self.core {
            Core::Box(size) => {
                V3::from_fn(|i, _| if corner >> i & 1 == 1 { size[i] } else { -size[i] })
            }
            Core::Hull(hull) => hull.vertices[corner],
            Core::Prism(prism) => prism.corners[corner],
            Core::Segment(half) => V3::new(0.0, 0.0, if corner == 1 { half } else { -half }),
            _ => V3::zeros(),
        };
        self.pose.to_world(&local.map(R::of))
    }

    /// Returns the corner at the other end of a corner's k-th edge.
    pub fn neighbour(&self, corner: usize, k: usize) -> Option<usize> {
        match self.core {
            Core::Box(_) => (k < 3).then(|| corner ^ 1 << k),
            Core::Hull(hull) => hull.neighbours(corner).get(k).copied(),
            Core::Prism(_) => PRISM[corner].get(k).copied(),
            Core::Segment(_) => (k == 0).then_some(1 - corner),
            _ => None,
        }
    }

    /// Does the same for edges along which the surface folds.
    pub fn fold(&self, corner: usize, k: usize) -> Option<usize> {
        match self.core {
            Core::Hull(hull) => hull.folds(corner).get(k).copied(),
            _ => self.neighbour(corner, k),
        }
    }

    /// Returns the outward unit normal nearest to a unit direction among the faces, the cosine of the
    /// angle between them, and the face.
    pub fn face(&self, direction: &V3<R>) -> Option<(V3<R>, f64, usize)> {
        let d = plain(self.pose).to_local(&direction.map(|x| x.lane(0)));
        let (local, face) = match self.core {
            Core::Cylinder(..) => {
                let up = d.z >= 0.0;
                (V3::new(0.0, 0.0, if up { 1.0 } else { -1.0 }), usize::from(up))
            }
            Core::Box(_) => {
                let mut axis = 0;
                for i in 1..3 {
                    if d[i].abs() > d[axis].abs() {
                        axis = i;
                    }
                }
                let up = d[axis] >= 0.0;
                let mut normal = V3::zeros();
                normal[axis] = if up { 1.0 } else { -1.0 };
                (normal, 2 * axis + usize::from(up))
            }
            Core::Hull(hull) => {
                let face = hull.face(&d);
                (hull.faces[face].normal, face)
            }
            Core::Prism(prism) => {
                let mut best = (f64::NEG_INFINITY, V3::zeros(), 0);
                for (face, normal) in prism.normals.iter().enumerate() {
                    let along = normal.dot(&d);
                    if along > best.0 {
                        best = (along, *normal, face);
                    }
                }
                (best.1, best.2)
            }
            _ => return None,
        };
        Some((self.pose.to_world(&local.map(R::of)), local.dot(&d), face))
    }
}

impl Solid<'_, f64> {
    /// For a cylinder, returns its cap's normal tilted towards a point, from its centre, beyond the rim.
    pub fn over_rim(&self, cap: &V3<f64>, point: &V3<f64>, size: f64) -> Option<V3<f64>> {
        let Core::Cylinder(radius, _) = self.core else { return None };
        let across = point - cap * cap.dot(point);
        let length = across.dot(&across).sqrt();
        let beyond = length - radius;
        if beyond <= 0.0 {
            return None;
        }
        let lean = cap + across * ((beyond / size).min(LEAN) / length);
        Some(lean * (1.0 / lean.dot(&lean).sqrt()))
    }
}

/// The largest tilt of `over_rim`.
const LEAN: f64 = 0.3;

/// Faces of a prism: two triangles and three sides. The order of the corners turns a face either way;
/// `normal_of` points away from the other corners.
pub const PRISM_FACES: [&[usize]; 5] =
    [&[0, 1, 2], &[3, 4, 5], &[0, 1, 4, 3], &[1, 2, 5, 4], &[2, 0, 3, 5]];

/// Returns the point of a box's face nearest to another one.
fn on_box_face(face: usize, size: &[f64; 3], to: V3<f64>) -> V3<f64> {
    V3::from_fn(|i, _| match (face / 2 == i, face % 2 == 1) {
        (true, true) => size[i],
        (true, false) => -size[i],
        _ => to[i].clamp(-size[i], size[i]),
    })
}

/// Returns the point of a segment nearest to a point.
pub fn on_segment<R: Real>(a: &V3<R>, b: &V3<R>, to: &V3<R>) -> V3<R> {
    let along = b - a;
    let share = along.dot(&(to - a)) * along.dot(&along).recip_or_zero();
    a + along * share.clamp(R::zero(), R::one())
}

/// Returns the distance of a point from the sides of a polygon whose corners run counter-clockwise
/// about its normal.
fn within(p: &V3<f64>, normal: &V3<f64>, count: usize, corner: impl Fn(usize) -> V3<f64>) -> f64 {
    let mut least = f64::INFINITY;
    let mut from = corner(count - 1);
    for k in 0..count {
        let to = corner(k);
        let inward = normal.cross(&(to - from));
        least = least.min(inward.dot(&(p - from)) / inward.dot(&inward).sqrt());
        from = to;
    }
    least
}

fn normal_of(corners: &[V3<f64>; 6], face: &[usize]) -> V3<f64> {
    let [a, b, c] = [0, 1, 2].map(|k| corners[face[k]]);
    let last = corners[face[face.len() - 1]];
    let across = if face.len() == 4 { (c - a).cross(&(last - b)) } else { (b - a).cross(&(c - a)) };
    let normal = across * across.dot(&across).sqrt().recip_or_zero();
    let middle = corners.iter().fold(V3::zeros(), |sum, c| sum + c) * (1.0 / 6.0);
    if normal.dot(&(middle - a)) > 0.0 {
        -normal
    } else {
        normal
    }
}

fn far(most: f64, x: &f64) -> f64 {
    most.max(x.abs())
}

/// Returns a pose in plain numbers.
pub fn plain<R: Real>(pose: &Pose<R>) -> Pose<f64> {
    Pose { pos: pose.pos.map(|x| x.lane(0)), rot: pose.rot.map(|x| x.lane(0)) }
}
