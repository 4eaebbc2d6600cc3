//! A height field against any convex shape.
//!
//! Under each cell of the field stand two prisms, as in MuJoCo: their tops are the cell's two
//! triangles, which share the diagonal from its corner of least x and y to the opposite one, and
//! their bottoms lie `base` below height 0. Each prism that the shape's box meets is a convex
//! shape of its own. But a prism knows nothing of its neighbours: the shortest way out of it may
//! lead into the next one, over an edge that is none of the field's. Such an answer is dropped for
//! the top's own normal, where that is over the prism: on a flat field every shape then touches
//! as on a plane.
//!
//! Points in one place count once. Of more than `MOST` the deepest stays, and then each time the
//! one furthest from those that stay.

use super::by_lane::{empty, OneWorld};
use super::convex::{contacts, meeting, solid};
use super::separation::{Cause, Separation};
use super::solid::{plain, Core, Solid};
use super::touch::{Touch, Touches};
use super::Shape;
use crate::real::{Mask, Real};
use crate::scene::GeomType;
use crate::spatial::{Pose, V3};

/// The most contacts of a height field and one shape.
pub const MOST: usize = 16;
/// Contacts that are looked at, at most.
const ROOM: usize = 256;
/// Over the pair's size: what is in one place, and what lies as far along a direction.
const SAME: f64 = 1e-9;

/// Heights over a grid.
#[derive(Clone, Debug, PartialEq)]
pub struct HeightField {
    /// Nodes along y, and along x.
    pub nrow: usize,
    pub ncol: usize,
    /// Half extents along x and y [m].
    pub half: [f64; 2],
    /// How deep the solid reaches below height 0 [m].
    pub base: f64,
    /// Node by node [m], row by row: y grows from row to row, x along a row.
    pub heights: Vec<f64>,
}

/// One of the two prisms under a cell.
struct Prism {
    corners: [V3<f64>; 6],
    /// Row and column of the nodes of its top.
    nodes: [(usize, usize); 3],
    number: usize,
}

impl HeightField {
    fn node(&self, row: usize, col: usize) -> V3<f64> {
        let along = |i: usize, n: usize, half: f64| half * (2.0 * i as f64 / (n - 1) as f64 - 1.0);
        V3::new(
            along(col, self.ncol, self.half[0]),
            along(row, self.nrow, self.half[1]),
            self.heights[row * self.ncol + col],
        )
    }

    /// The corners of one of a cell's two triangles, counter-clockwise seen from above.
    pub(super) fn top(&self, row: usize, col: usize, upper: bool) -> [V3<f64>; 3] {
        let (first, last) = (self.node(row, col), self.node(row + 1, col + 1));
        if upper {
            [first, last, self.node(row + 1, col)]
        } else {
            [first, self.node(row, col + 1), last]
        }
    }

    fn prism(&self, row: usize, col: usize, upper: bool) -> Prism {
        let third = if upper { (row + 1, col) } else { (row, col + 1) };
        let nodes = [(row, col), third, (row + 1, col + 1)];
        let top = nodes.map(|(r, c)| self.node(r, c));
        let below = top.map(|p| V3::new(p.x, p.y, -self.base));
        let corners = [top[0], top[1], top[2], below[0], below[1], below[2]];
        let number = 2 * (row * (self.ncol - 1) + col) + usize::from(upper);
        Prism { corners, nodes, number }
    }

    /// First and last cell that a stretch meets, of `n` nodes over ±half.
    fn cells(low: f64, high: f64, n: usize, half: f64) -> Option<(usize, usize)> {
        if !(low <= half && high >= -half) {
            return None;
        }
        let cell = |x: f64| {
            let place = (x / half + 1.0) * (0.5 * (n - 1) as f64);
            // A float that is out of range becomes the nearest whole number.
            (place.floor().max(0.0) as usize).min(n - 2)
        };
        Some((cell(low), cell(high)))
    }

    /// Nodes that share a triangle's side with a node.
    fn around(&self, (row, col): (usize, usize)) -> impl Iterator<Item = V3<f64>> + '_ {
        let ways: [(isize, isize); 6] = [(0, 1), (1, 1), (1, 0), (0, -1), (-1, -1), (-1, 0)];
        ways.into_iter().filter_map(move |(dr, dc)| {
            let (r, c) = (row.checked_add_signed(dr)?, col.checked_add_signed(dc)?);
            (r < self.nrow && c < self.ncol).then(|| self.node(r, c))
        })
    }

    /// Nodes across the sides that two neighbouring nodes share.
    fn beside(&self, a: (usize, usize), b: (usize, usize)) -> impl Iterator<Item = V3<f64>> + '_ {
        let near = |p: &V3<f64>, q: V3<f64>| (p - q).dot(&(p - q)) == 0.0;
        let others: [Option<V3<f64>>; 6] = {
            let mut list = [None; 6];
            let mut count = 0;
            for p in self.around(a) {
                if self.around(b).any(|q| near(&p, q)) {
                    list[count] = Some(p);
                    count += 1;
                }
            }
            list
        };
        others.into_iter().flatten()
    }

    /// A side of a triangle on the field's border.
    fn border(&self, a: (usize, usize), b: (usize, usize)) -> bool {
        let end = |i: usize, n: usize| i == 0 || i == n - 1;
        a.0 == b.0 && end(a.0, self.nrow) || a.1 == b.1 && end(a.1, self.ncol)
    }

    /// The direction, in the field's axes, leads out of the whole field at the prism's place that
    /// lies furthest along it, and not into a neighbour.
    fn leads_out(&self, prism: &Prism, way: &V3<f64>, centre: &V3<f64>, tolerance: f64) -> bool {
        let most = prism.corners.iter().map(|c| c.dot(way)).fold(f64::NEG_INFINITY, f64::max);
        let far: [bool; 6] =
            core::array::from_fn(|k| prism.corners[k].dot(way) >= most - tolerance);
        if far[3] || far[4] || far[5] {
            // The bottom, or a wall.
            let under = centre.z < -self.base;
            let wall = |i: usize, k: usize| {
                (far[i] || far[i + 3])
                    && (far[k] || far[k + 3])
                    && self.border(prism.nodes[i], prism.nodes[k])
            };
            return under || wall(0, 1) || wall(1, 2) || wall(2, 0);
        }
        let mut list = [0; 3];
        let mut count = 0;
        for k in 0..3 {
            if far[k] {
                list[count] = k;
                count += 1;
            }
        }
        let not_higher = |p: V3<f64>, from: usize| (p - prism.corners[from]).dot(way) <= tolerance;
        match count {
            1 => self.around(prism.nodes[list[0]]).all(|p| not_higher(p, list[0])),
            2 => self
                .beside(prism.nodes[list[0]], prism.nodes[list[1]])
                .all(|p| not_higher(p, list[0])),
            _ => true,
        }
    }
}

/// A height field, and a shape of this type.
#[derive(Clone, Copy, Debug)]
pub struct OnField(pub GeomType);

impl OneWorld<MOST> for OnField {
    fn touches<R: Real>(&self, one: &Shape<R>, two: &Shape<R>) -> Touches<R, MOST> {
        match one.field {
            Some(field) => on_field(field, one.pose, &solid(self.0, two)),
            None => [empty(); MOST],
        }
    }
}

/// Contacts found so far.
struct List<R: Real> {
    touches: [Touch<R>; ROOM],
    count: usize,
}

fn on_field<R: Real>(field: &HeightField, pose: &Pose<R>, shape: &Solid<R>) -> Touches<R, MOST> {
    let plain_pose = plain(pose);
    let plain_shape = plain(shape.pose);
    let body = Solid { core: shape.core, radius: shape.radius, pose: &plain_shape };
    let centre = plain_pose.to_local(&(plain_shape.pos - plain_pose.pos));
    // The shape's box in the field's axes, grown by its own extent: what is farther cannot matter.
    let mut low = V3::zeros();
    let mut high = V3::zeros();
    for i in 0..3 {
        let axis = plain_pose.axis(i);
        high[i] = centre[i] + axis.dot(&body.support(&axis).0) + shape.radius;
        low[i] = centre[i] + axis.dot(&body.support(&-axis).0) - shape.radius;
    }
    let grown = 0.25 * (high - low).iter().fold(0.0_f64, |most, x| most.max(*x));
    let mut list = List { touches: [empty(); ROOM], count: 0 };
    let columns = HeightField::cells(low.x - grown, high.x + grown, field.ncol, field.half[0]);
    let rows = HeightField::cells(low.y - grown, high.y + grown, field.nrow, field.half[1]);
    if let (Some(columns), Some(rows)) = (columns, rows) {
        for row in rows.0..=rows.1 {
            for col in columns.0..=columns.1 {
                for upper in [false, true] {
                    let prism = field.prism(row, col, upper);
                    let top = prism.corners[..3].iter().fold(f64::NEG_INFINITY, |m, c| m.max(c.z));
                    if low.z - grown <= top && high.z + grown >= -field.base {
                        on_prism(field, &prism, pose, shape, &centre, &mut list);
                    }
                }
            }
        }
    }
    list.chosen(SAME * shape.extent())
}

/// The contacts of one prism that are the field's.
fn on_prism<R: Real>(
    field: &HeightField,
    prism: &Prism,
    pose: &Pose<R>,
    shape: &Solid<R>,
    centre: &V3<f64>,
    list: &mut List<R>,
) {
    let ground = Solid { core: Core::Prism(&prism.corners), radius: 0.0, pose };
    // Which contacts of a field are kept depends on all of them, near or far.
    let Some(separation) = meeting(&ground, shape, f64::INFINITY) else { return };
    let way = plain(pose).to_local(&separation.normal);
    let tolerance = SAME * (shape.extent() + prism_size(prism));
    let found = if field.leads_out(prism, &way, centre, tolerance) {
        Some(separation)
    } else {
        over_top(prism, pose, shape)
    };
    if let Some(found) = found {
        let touches: Touches<R, 8> = contacts(&ground, shape, &found);
        for touch in touches {
            if touch.exists.any() {
                let name =
                    touch.feature.lane(0) as u32 ^ (prism.number as u32).wrapping_mul(0x9E37_79B1);
                let feature = R::of(f64::from(name & 0x00FF_FFFF));
                list.add(Touch { feature, ..touch });
            }
        }
    }
}

/// The longest side of a prism's top.
fn prism_size(prism: &Prism) -> f64 {
    let way = prism.corners[2] - prism.corners[0];
    way.dot(&way).sqrt()
}

/// The separation along the top's own normal, if the shape's deepest point is over the top.
fn over_top<R: Real>(prism: &Prism, pose: &Pose<R>, shape: &Solid<R>) -> Option<Separation> {
    let (pose, other) = (plain(pose), plain(shape.pose));
    let [a, b, c, ..] = prism.corners;
    let cross = (b - a).cross(&(c - a));
    let cross = if cross.z < 0.0 { -cross } else { cross };
    let local = cross * (1.0 / cross.dot(&cross).sqrt());
    let normal = pose.to_world(&local);
    let body = Solid { core: shape.core, radius: shape.radius, pose: &other };
    let point = pose.to_local(&(other.pos - pose.pos + body.support(&-normal).0));
    let side = |p: V3<f64>, q: V3<f64>| (q - p).cross(&(point - p)).dot(&local);
    let sides = [side(a, b), side(b, c), side(c, a)];
    let over = sides.iter().all(|s| *s >= 0.0) || sides.iter().all(|s| *s <= 0.0);
    let apart = local.dot(&(point - a));
    over.then_some(Separation { normal, apart, cause: Cause::FaceOne(local) })
}

impl<R: Real> List<R> {
    fn add(&mut self, touch: Touch<R>) {
        if self.count < ROOM {
            self.touches[self.count] = touch;
            self.count += 1;
        }
    }

    /// `MOST` of them: see the top of the file.
    fn chosen(&self, same: f64) -> Touches<R, MOST> {
        let all = &self.touches[..self.count];
        let square = |p: &Touch<R>, q: &Touch<R>| {
            let way = p.pos - q.pos;
            way.dot(&way).lane(0)
        };
        let mut out = [empty(); MOST];
        let mut nearest = [f64::INFINITY; ROOM];
        let depth = |touch: &Touch<R>| touch.dist.lane(0);
        let deeper =
            |best: usize, i: usize| if depth(&all[i]) < depth(&all[best]) { i } else { best };
        if all.is_empty() {
            return out;
        }
        let mut last = (1..all.len()).fold(0, deeper);
        let mut picked = [false; ROOM];
        picked[last] = true;
        for _ in 1..MOST {
            let mut best = (same * same, None);
            for i in 0..all.len() {
                nearest[i] = nearest[i].min(square(&all[i], &all[last]));
                if !picked[i] && nearest[i] > best.0 {
                    best = (nearest[i], Some(i));
                }
            }
            let Some(next) = best.1 else { break };
            picked[next] = true;
            last = next;
        }
        let mut count = 0;
        for (touch, picked) in all.iter().zip(picked) {
            if picked {
                out[count] = *touch;
                count += 1;
            }
        }
        out
    }
}
