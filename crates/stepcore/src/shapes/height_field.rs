//! A height field against any convex shape.
//!
//! Under each cell of the field stand two prisms, as in MuJoCo: their tops are the cell's two
//! triangles, which share the diagonal from its corner of least x and y to the opposite one, and
//! their bottoms lie `base` below height 0. Each prism that the shape's box meets is a convex
//! shape of its own. But a prism knows nothing of its neighbours: the shortest way out of it may
//! lead into the next one, over an edge that is none of the field's. Such an answer is dropped for
//! the top's own normal, where the shape's lowest place is over the prism, or is over a part of the
//! field that goes on as the prism's top does: on a flat field every shape then touches as on a plane.
//!
//! Points in one place count once. Of more than `MOST` those stay that lie furthest out along eight
//! directions of the field, so a base is held by its corners; then each time the one furthest from
//! those that stay, and last the deepest. So a body that rests keeps its contacts.

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
/// Contacts that are looked at at once; of more, `KEPT` that are far from each other go on.
const ROOM: usize = 256;
const KEPT: usize = 64;
/// Slopes from a corner of a prism's top to a triangle's up to which that goes on in its plane.
const ONWARD: f64 = 1e-3;
/// Directions in the field's plane, none of them along a side or a diagonal of its cells.
const AROUND: [(f64, f64); 8] = [
    (0.92, 0.38),
    (0.38, 0.92),
    (-0.38, 0.92),
    (-0.92, 0.38),
    (-0.92, -0.38),
    (-0.38, -0.92),
    (0.38, -0.92),
    (0.92, -0.38),
];
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

impl Prism {
    /// Of its top: unit, upward.
    fn normal(&self) -> V3<f64> {
        let [a, b, c, ..] = self.corners;
        let cross = (b - a).cross(&(c - a));
        let cross = if cross.z < 0.0 { -cross } else { cross };
        cross * (1.0 / cross.dot(&cross).sqrt())
    }

    /// A line along the top's normal through a point meets the top, or passes it by `beside` [m].
    fn holds(&self, point: &V3<f64>, beside: f64) -> bool {
        let ([a, b, c, ..], up) = (self.corners, self.normal());
        let side = |p: V3<f64>, q: V3<f64>| {
            let slack = beside * (q - p).dot(&(q - p)).sqrt();
            ((q - p).cross(&(point - p)).dot(&up), slack)
        };
        let sides = [side(a, b), side(b, c), side(c, a)];
        sides.iter().all(|(s, slack)| *s >= -slack) || sides.iter().all(|(s, slack)| *s <= *slack)
    }
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

    /// The triangle of the surface over or under a place of the field; None beside it.
    fn surface(&self, place: &V3<f64>) -> Option<[V3<f64>; 3]> {
        let columns = Self::cells(place.x, place.x, self.ncol, self.half[0])?;
        let rows = Self::cells(place.y, place.y, self.nrow, self.half[1])?;
        let [low, _, high] = self.top(rows.0, columns.0, false);
        let (along, across) = (high.x - low.x, high.y - low.y);
        let upper = (place.y - low.y) * along > (place.x - low.x) * across;
        Some(self.top(rows.0, columns.0, upper))
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
    /// The field's x and y axes.
    axes: [V3<f64>; 2],
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
    let axes = [plain_pose.axis(0), plain_pose.axis(1)];
    let mut list = List { touches: [empty(); ROOM], count: 0, axes };
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
    let (found, own) = if field.leads_out(prism, &way, centre, tolerance) {
        (separation, true)
    } else if let Some(found) = over_top(field, prism, pose, shape) {
        found
    } else {
        return;
    };
    let touches: Touches<R, 8> = contacts(&ground, shape, &found);
    let there = || touches.iter().filter(|touch| touch.exists.any());
    if !own && there().count() == 1 {
        // Nothing lies flat on this top: the one place is another prism's.
        return;
    }
    for touch in there() {
        let at = plain(pose).to_local(&(touch.pos.map(|x| x.lane(0)) - plain(pose).pos));
        if own || prism.holds(&at, tolerance) {
            let name =
                touch.feature.lane(0) as u32 ^ (prism.number as u32).wrapping_mul(0x9E37_79B1);
            let feature = R::of(f64::from(name & 0x00FF_FFFF));
            list.add(Touch { feature, ..*touch }, tolerance);
        }
    }
}

/// The longest side of a prism's top.
fn prism_size(prism: &Prism) -> f64 {
    let way = prism.corners[2] - prism.corners[0];
    way.dot(&way).sqrt()
}

/// The separation along the top's own normal, if the shape's deepest point is over the top (true)
/// or over ground that goes on in its plane (false).
fn over_top<R: Real>(
    field: &HeightField,
    prism: &Prism,
    pose: &Pose<R>,
    shape: &Solid<R>,
) -> Option<(Separation, bool)> {
    let (pose, other) = (plain(pose), plain(shape.pose));
    let (a, local) = (prism.corners[0], prism.normal());
    let normal = pose.to_world(&local);
    let body = Solid { core: shape.core, radius: shape.radius, pose: &other };
    let point = pose.to_local(&(other.pos - pose.pos + body.support(&-normal).0));
    let over = prism.holds(&point, 0.0);
    let onward = || {
        let Some(ground) = field.surface(&point) else { return false };
        // Over its own top, but beside it along the normal: an edge or a corner is nearer.
        let own = ground.iter().all(|corner| prism.corners[..3].contains(corner));
        !own && ground.iter().all(|corner| {
            let (way, height) = (corner - a, local.dot(&(corner - a)));
            height * height <= ONWARD * ONWARD * way.dot(&way)
        })
    };
    let apart = local.dot(&(point - a));
    let found = Separation { normal, apart, cause: Cause::FaceOne(local) };
    (over || onward()).then_some((found, over))
}

impl<R: Real> List<R> {
    fn add(&mut self, touch: Touch<R>, same: f64) {
        if self.count == ROOM {
            self.thin(same);
        }
        self.touches[self.count] = touch;
        self.count += 1;
    }

    /// Makes room: `KEPT` of the contacts stay.
    fn thin(&mut self, same: f64) {
        let picked = self.spread(KEPT, same);
        let mut kept = 0;
        for i in 0..self.count {
            if picked[i] {
                self.touches[kept] = self.touches[i];
                kept += 1;
            }
        }
        self.count = kept;
    }

    /// `MOST` of them: see the top of the file.
    fn chosen(&self, same: f64) -> Touches<R, MOST> {
        let mut out = [empty(); MOST];
        let picked = self.spread(MOST, same);
        let listed = self.touches[..self.count].iter().zip(picked).filter(|(_, picked)| *picked);
        for (to, (touch, _)) in out.iter_mut().zip(listed) {
            *to = *touch;
        }
        out
    }

    /// Which of the contacts stay, at most `most`.
    fn spread(&self, most: usize, same: f64) -> [bool; ROOM] {
        let all = &self.touches[..self.count];
        let mut picked = [false; ROOM];
        let depth = |i: usize| all[i].dist.lane(0);
        let Some(deepest) = (0..all.len()).min_by(|i, j| depth(*i).total_cmp(&depth(*j))) else {
            return picked;
        };
        let mut nearest = [f64::INFINITY; ROOM];
        let mut pick = |next: usize, nearest: &mut [f64; ROOM]| {
            picked[next] = true;
            for (i, touch) in all.iter().enumerate() {
                let way = touch.pos - all[next].pos;
                nearest[i] = nearest[i].min(way.dot(&way).lane(0));
            }
        };
        let mut kept = 0;
        for (x, y) in AROUND {
            let way = self.axes[0] * x + self.axes[1] * y;
            let out = |i: usize| way.dot(&all[i].pos.map(|x| x.lane(0)));
            let next = (1..all.len()).fold(0, |far, i| if out(i) > out(far) { i } else { far });
            if nearest[next] > same * same {
                pick(next, &mut nearest);
                kept += 1;
            }
        }
        while kept < most {
            let far = |best: usize, i: usize| if nearest[i] > nearest[best] { i } else { best };
            // The last place is the deepest one's, if no other has been given to it.
            let missing = kept + 1 == most && nearest[deepest] > same * same;
            let next = if missing { deepest } else { (1..all.len()).fold(0, far) };
            if nearest[next] <= same * same {
                break;
            }
            pick(next, &mut nearest);
            kept += 1;
        }
        picked
    }
}
