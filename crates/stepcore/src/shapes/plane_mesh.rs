//! A plane and a convex hull: the hull's support polygon.
//!
//! Contacts are vertices: the corners of the face that points most into the plane, at any distance, and
//! all vertices below the plane or hardly higher than the lowest. If there are more than `MOST`, the
//! lowest stays, and others that are far from it and from each other within the hull, which no motion
//! changes, so that a mesh that rests keeps its contacts.

use super::by_lane::{empty, OneWorld};
use super::hull::Hull;
use super::spread::spread;
use super::touch::{Touch, Touches};
use super::Shape;
use crate::bits::ones;
use crate::real::{Constant, Mask, Real};
use crate::spatial::V3;

/// The largest number of contacts.
pub const MOST: usize = super::convex::PATCH;
/// Largest number of vertices in the choice: see `List::thin_out`.
const ROOM: usize = 256;
/// Words of 64 vertices each: for larger hulls every vertex is examined.
const WORDS: usize = 128;
/// Over the hull's size: vertices no higher than this above the lowest lie on its base.
const LEVEL: f64 = 1e-5;
/// The same: vertices whose heights differ by less count as equally high.
const EVEN: f64 = 1e-10;

/// Over the hull's size: margin over a distance beyond which a hull is certainly apart, whatever the
/// rounding of its contacts.
const SURE: f64 = 1e-6;

/// The test of a plane (`one`) and a mesh; contacts at this distance or farther [m] may be left out.
pub struct PlaneMesh {
    pub within: f64,
}

impl OneWorld<MOST> for PlaneMesh {
    fn touches<R: Real>(&self, one: &Shape<R>, two: &Shape<R>) -> Touches<R, MOST> {
        let Some(hull) = two.hull else { return [empty(); MOST] };
        let (plane, mesh) = (one.pose, two.pose);
        let normal = plane.axis(2);
        let centre = normal.dot(&(mesh.pos - plane.pos));
        let own = mesh.rot.transpose() * normal;
        let up = V3::new(own.x.lane(0), own.y.lane(0), own.z.lane(0));
        let size = two.size.iter().fold(0.0, |a: f64, b| a.max(b.lane(0)));
        let mut touches = [empty(); MOST];
        let lowest = hull.support(&-up);
        let least = centre.lane(0) + up.dot(&hull.vertices[lowest]);
        if least > self.within + SURE * hull.reach() {
            return touches;
        }
        let (chosen, count) = polygon(hull, lowest, &up, centre.lane(0), size);
        for (touch, &vertex) in touches.iter_mut().zip(&chosen[..count]) {
            let at = mesh.rot * hull.vertices[vertex].map(R::of);
            let dist = centre + normal.dot(&at);
            *touch = Touch {
                dist,
                pos: mesh.pos + at - normal * (R::of(0.5) * dist),
                normal,
                exists: R::Mask::of(true),
                feature: R::of(vertex as f64),
            };
        }
        touches
    }
}

/// Returns the vertices that are contacts, ascending, and their number: `up` is the plane's normal in
/// the hull's frame, `centre` the height of this frame.
fn polygon(
    hull: &Hull,
    lowest: usize,
    up: &V3<f64>,
    centre: f64,
    size: f64,
) -> ([usize; MOST], usize) {
    let height = |vertex: usize| centre + up.dot(&hull.vertices[vertex]);
    let limit = (height(lowest) + LEVEL * size).max(0.0);
    let even = height(lowest) + EVEN * size;
    let low = |vertex: &usize| height(*vertex) <= limit;
    let mut list = List { vertices: [0; ROOM], count: 0 };
    // The first of even ones, regardless of rounding.
    let (even, mut every) = (|vertex: &usize| height(*vertex) <= even, 0..hull.vertices.len());
    let first = if list.spread(hull, lowest, low) {
        list.all().find(even)
    } else {
        list.thin_out(every.clone().filter(low));
        every.find(even)
    };
    list.begin_with(first.unwrap_or(lowest));
    // A vertex that is not below acts only if no other does: it does not replace one that is.
    let must = list.count.min(MOST);
    if must < MOST {
        let corners = hull.faces.get(hull.face(&-up)).map_or(&[][..], |face| &face.corners);
        for corner in corners.iter().step_by(1 + (must + corners.len()) / ROOM) {
            if list.all().take(must).all(|own| own != *corner) {
                list.push(*corner);
            }
        }
    }
    // All that act if they fit, else the lowest; then the furthest from these.
    let vertex = |place: usize| &hull.vertices[list.vertices[place] as usize];
    let mut places = core::array::from_fn::<usize, MOST, _>(|place| place);
    let mut kept = list.count.min(MOST);
    if list.count > MOST {
        kept = if must < MOST { must } else { 1 };
        let apart = |i: usize, j: usize| (vertex(i) - vertex(j)).norm_squared();
        kept = spread::<ROOM>(list.count, &mut places, kept, 0.0, apart);
    }
    let mut chosen = places.map(|place| list.vertices[place] as usize);
    chosen[..kept].sort_unstable();
    (chosen, kept)
}

/// Vertices to choose from, each once.
struct List {
    vertices: [u32; ROOM],
    count: usize,
}

impl List {
    /// Lists the vertices below a height around the first, ascending, by walking over neighbours: on a
    /// convex surface they are connected. Returns false if there are too many.
    fn spread(&mut self, hull: &Hull, first: usize, low: impl Fn(&usize) -> bool) -> bool {
        let vertices = hull.vertices.len();
        if vertices > 64 * WORDS {
            return false;
        }
        // A bit for each visited vertex.
        let mut seen = [0u64; WORDS];
        let bit = |vertex: usize| (vertex / 64, 1 << (vertex % 64));
        let (word, own) = bit(first);
        seen[word] |= own;
        self.push(first);
        let mut next = 0;
        while next < self.count {
            for vertex in hull.neighbours(self.vertices[next] as usize) {
                let (word, own) = bit(*vertex);
                if seen[word] & own != 0 || !low(vertex) {
                    continue;
                }
                seen[word] |= own;
                if self.count == ROOM {
                    return false;
                }
                self.push(*vertex);
            }
            next += 1;
        }
        let words = &seen[..vertices.div_ceil(64).min(WORDS)];
        self.vertices.iter_mut().zip(ones(words)).for_each(|(place, seen)| *place = seen as u32);
        true
    }

    /// Keeps every second, fourth, eighth … of many vertices, so that there is room for them.
    fn thin_out(&mut self, vertices: impl Iterator<Item = usize>) {
        self.count = 0;
        let mut others = 0; // A power of two minus one: one vertex stays of each others + 1.
        for (at, vertex) in vertices.enumerate() {
            if at & others == 0 && self.count == ROOM {
                self.count /= 2;
                (0..self.count).for_each(|at| self.vertices[at] = self.vertices[2 * at]);
                others = 2 * others + 1;
            }
            if at & others == 0 {
                self.push(vertex);
            }
        }
    }

    fn all(&self) -> impl Iterator<Item = usize> + '_ {
        self.vertices[..self.count].iter().map(|vertex| *vertex as usize)
    }

    fn push(&mut self, vertex: usize) {
        if self.count < ROOM {
            self.vertices[self.count] = vertex as u32;
            self.count += 1;
        }
    }

    /// Moves a vertex to the front, or inserts it there.
    fn begin_with(&mut self, vertex: usize) {
        let known = self.all().position(|own| own == vertex);
        self.count = ROOM.min(self.count + usize::from(known.is_none()));
        let at = known.unwrap_or(self.count - 1);
        self.vertices[..=at].rotate_right(1);
        self.vertices[0] = vertex as u32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spatial::Pose;
    use nalgebra::{Rotation3, Vector3};

    fn touch(hull: &Hull, mesh: &Pose<f64>) -> Vec<Touch<f64>> {
        let plane = Pose { pos: V3::new(1.0, 2.0, 0.5), rot: nalgebra::Matrix3::identity() };
        let shape = |pose, size, hull| Shape { pose, size, hull, field: None };
        let one = shape(&plane, &[0.0; 3], None);
        let two = shape(mesh, &[0.5, 0.5, 0.5], Some(hull));
        PlaneMesh { within: f64::INFINITY }
            .touches(&one, &two)
            .into_iter()
            .filter(|touch| touch.exists)
            .collect()
    }

    fn prism(n: usize) -> Hull {
        let ring = |i: usize| {
            let angle = std::f64::consts::TAU * (i / 2) as f64 / n as f64;
            [0.4 * angle.cos(), 0.4 * angle.sin(), 0.3 * (i % 2) as f64 - 0.15]
        };
        Hull::of(&(0..2 * n).map(ring).collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn a_block_stands_on_four_corners() {
        let hull = Hull::block([0.5, 0.25, 0.1]).unwrap();
        let pose = Pose { pos: V3::new(3.0, 0.0, 0.59), rot: nalgebra::Matrix3::identity() };
        let touches = touch(&hull, &pose);
        assert_eq!(touches.len(), 4);
        for touch in &touches {
            assert!((touch.dist + 0.01).abs() < 1e-15);
            assert!((touch.pos.z - 0.495).abs() < 1e-15);
            assert_eq!(touch.normal, Vector3::z());
        }
    }

    #[test]
    fn a_prism_of_many_corners_stands_on_four_that_surround_its_centre() {
        let hull = prism(60);
        for step in 0..40 {
            let tilt = Rotation3::from_euler_angles(1e-7 * step as f64, -2e-7 * step as f64, 0.3);
            let pose = Pose { pos: V3::new(0.0, 0.0, 0.649), rot: *tilt.matrix() };
            let touches = touch(&hull, &pose);
            assert_eq!(touches.len(), 4);
            let lowest = hull.vertices.iter().map(|v| (tilt * v).z).fold(f64::INFINITY, f64::min);
            let deepest = touches.iter().map(|t| t.dist).fold(f64::INFINITY, f64::min);
            assert!((deepest - (0.149 + lowest)).abs() < 1e-15);
            // Every quarter around the centre has one.
            for quarter in 0..4 {
                let (x, y) = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)][quarter];
                assert!(touches.iter().any(|t| t.pos.x * x > -0.1 && t.pos.y * y > -0.1));
            }
        }
    }

    #[test]
    fn a_mesh_that_is_far_tells_nothing() {
        let (hull, plane) = (prism(60), crate::shapes::trial::at(0.0, 0.0, 0.0));
        for (height, there) in [(0.5, true), (0.61, false)] {
            let mesh = crate::shapes::trial::at(0.0, 0.0, height);
            let shape = |pose, hull| Shape { pose, size: &[0.5; 3], hull, field: None };
            let (one, two) = (shape(&plane, None), shape(&mesh, Some(&hull)));
            let touches = PlaneMesh { within: 0.4 }.touches(&one, &two);
            assert_eq!(touches.iter().any(|touch| touch.exists), there);
        }
    }

    #[test]
    fn the_lowest_vertex_is_always_among_them() {
        let hull = prism(60);
        for step in 0..200 {
            let angle = 0.05 * step as f64;
            let turn = Rotation3::from_euler_angles(angle, 1.7 * angle, 0.2);
            for height in [0.3, 0.6, 1.4] {
                let pose = Pose { pos: V3::new(0.0, 0.0, height), rot: *turn.matrix() };
                let touches = touch(&hull, &pose);
                let lowest =
                    hull.vertices.iter().map(|v| (turn * v).z).fold(f64::INFINITY, f64::min);
                let deepest = touches.iter().map(|t| t.dist).fold(f64::INFINITY, f64::min);
                assert!((deepest - (height - 0.5 + lowest)).abs() < 1e-14);
                let mut features: Vec<f64> = touches.iter().map(|t| t.feature).collect();
                features.dedup();
                assert_eq!(features.len(), touches.len());
            }
        }
    }
}
