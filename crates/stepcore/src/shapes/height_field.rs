//! A height field against any convex shape.
//!
//! Under each cell of the field are two prisms, as in MuJoCo: their tops are the cell's two triangles,
//! which share the diagonal from its corner of least x and y to the opposite one, and their bottoms lie
//! `base` below height 0. Each prism that the shape's box meets is tested as a separate convex shape.
//! But a prism ignores its neighbours: the shortest way out of it may lead into the next one, over an
//! edge that is not part of the field's surface. Such an answer is replaced by the top's normal, if the
//! shape's lowest place is over the prism, or over a part of the field that continues the prism's top:
//! on a flat field every shape then touches as on a plane.
//!
//! Points in one place count once. If there are more than `MOST`, the furthest along eight directions
//! of the field stay, so a base is held by its corners; then each time the one furthest from the chosen
//! ones, and last the deepest. So a body that rests keeps its contacts.

use super::by_lane::{empty, OneWorld};
use super::convex::{contacts, meeting, solid};
use super::field_list::List;
use super::separation::{Cause, Separation};
use super::solid::{self, plain, Core, Solid};
use super::touch::Touches;
use super::Shape;
use crate::interrupt::checkpoint;
use crate::real::{Mask, Real};
use crate::scene::GeomType;
use crate::spatial::{Pose, V3};

/// The largest number of contacts of a height field and one shape.
pub const MOST: usize = 16;
/// Largest slope from a corner of a prism's top to a triangle's that continues its plane.
const SAME_PLANE: f64 = 1e-3;
/// Number of cells between two checks for an interrupt.
const CELLS: usize = 1024;
/// Over the pair's size: distance of coincident places, and difference of equal reaches.
const SAME: f64 = 1e-9;

/// Heights over a grid.
#[derive(Clone, Debug, PartialEq)]
pub struct HeightField {
    /// Nodes along y, and along x.
    pub nrow: usize,
    pub ncol: usize,
    /// Half extents along x and y [m].
    pub half: [f64; 2],
    /// Depth of the solid below height 0 [m].
    pub base: f64,
    /// Node by node [m], row by row: y grows from row to row, x along a row.
    pub heights: Vec<f64>,
}

/// One of the two prisms under a cell.
#[derive(Clone, Copy)]
pub(super) struct Prism {
    corners: [V3<f64>; 6],
    /// Row and column of the nodes of its top.
    nodes: [(usize, usize); 3],
    pub number: usize,
}

impl Prism {
    /// Checks that its height range comes within `more` [m] of a box.
    fn near(&self, bounds: &Bounds, more: f64) -> bool {
        let top = self.corners[..3].iter().fold(f64::NEG_INFINITY, |most, c| most.max(c.z));
        bounds.low.z - more <= top && bounds.high.z + more >= self.corners[3].z
    }

    /// Returns a lower bound of the distance from a box [m].
    fn apart(&self, bounds: &Bounds) -> f64 {
        let sideways = V3::from_fn(|i, _| {
            let corners = || self.corners.iter().map(|corner| corner[i]);
            let (low, high) = (bounds.low[i], bounds.high[i]);
            let beyond = corners().fold(f64::INFINITY, f64::min) - high;
            beyond.max(low - corners().fold(f64::NEG_INFINITY, f64::max)).max(0.0)
        });
        sideways.dot(&sideways).sqrt()
    }

    /// Returns the normal of its top: unit, upward.
    fn normal(&self) -> V3<f64> {
        let [a, b, c, ..] = self.corners;
        let cross = (b - a).cross(&(c - a));
        let cross = if cross.z < 0.0 { -cross } else { cross };
        cross * (1.0 / cross.dot(&cross).sqrt())
    }

    /// Checks that a line along the top's normal through a point is within `beside` [m] of the top.
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
    /// Returns the largest reach up or down from height 0 [m].
    pub fn tall(&self) -> f64 {
        self.heights.iter().fold(self.base, |most, height| most.max(*height))
    }

    fn node(&self, row: usize, col: usize) -> V3<f64> {
        let along = |i: usize, n: usize, half: f64| half * (2.0 * i as f64 / (n - 1) as f64 - 1.0);
        V3::new(
            along(col, self.ncol, self.half[0]),
            along(row, self.nrow, self.half[1]),
            self.heights[row * self.ncol + col],
        )
    }

    /// Returns the corners of one of a cell's two triangles, counter-clockwise from above.
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

    /// Returns the first and last cell that a stretch meets, of `n` nodes over ±half.
    fn cells(low: f64, high: f64, n: usize, half: f64) -> Option<(usize, usize)> {
        if !(low <= half && high >= -half) {
            return None;
        }
        let cell = |x: f64| {
            let place = (x / half + 1.0) * (0.5 * (n - 1) as f64);
            // An out-of-range float becomes the nearest integer.
            (place.floor().max(0.0) as usize).min(n - 2)
        };
        Some((cell(low), cell(high)))
    }

    /// Returns the cells that a box meets that is larger by `more` [m].
    fn stretch(&self, bounds: &Bounds, more: f64) -> Stretch {
        let cells = |i: usize, n: usize| {
            Self::cells(bounds.low[i] - more, bounds.high[i] + more, n, self.half[i])
        };
        Stretch(cells(1, self.nrow).zip(cells(0, self.ncol)).map(|(rows, columns)| [rows, columns]))
    }

    /// Returns the triangle of the surface over or under a place of the field; None outside the field.
    fn surface(&self, place: &V3<f64>) -> Option<[V3<f64>; 3]> {
        let columns = Self::cells(place.x, place.x, self.ncol, self.half[0])?;
        let rows = Self::cells(place.y, place.y, self.nrow, self.half[1])?;
        let [low, _, high] = self.top(rows.0, columns.0, false);
        let (along, across) = (high.x - low.x, high.y - low.y);
        let upper = (place.y - low.y) * along > (place.x - low.x) * across;
        Some(self.top(rows.0, columns.0, upper))
    }

    /// Returns the nodes that share a triangle's side with a node.
    fn around(&self, (row, col): (usize, usize)) -> impl Iterator<Item = V3<f64>> + '_ {
        let ways: [(isize, isize); 6] = [(0, 1), (1, 1), (1, 0), (0, -1), (-1, -1), (-1, 0)];
        ways.into_iter().filter_map(move |(dr, dc)| {
            let (r, c) = (row.checked_add_signed(dr)?, col.checked_add_signed(dc)?);
            (r < self.nrow && c < self.ncol).then(|| self.node(r, c))
        })
    }

    /// Returns the nodes across the sides that two neighbouring nodes share.
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

    /// Checks for a side of a triangle on the field's border.
    fn border(&self, a: (usize, usize), b: (usize, usize)) -> bool {
        let end = |i: usize, n: usize| i == 0 || i == n - 1;
        a.0 == b.0 && end(a.0, self.nrow) || a.1 == b.1 && end(a.1, self.ncol)
    }

    /// Checks that the direction, in the field's axes, leads out of the whole field at the prism's
    /// place that is furthest along it, and not into a neighbour.
    fn leads_out(&self, prism: &Prism, way: &V3<f64>, centre: &V3<f64>, tolerance: f64) -> bool {
        let most = prism.corners.iter().map(|c| c.dot(way)).fold(f64::NEG_INFINITY, f64::max);
        let far: [bool; 6] =
            crate::real::array::from_fn(|k| prism.corners[k].dot(way) >= most - tolerance);
        if far[3] || far[4] || far[5] {
            // The bottom, or a wall.
            let under = centre.z < -self.base;
            let end = |(row, col): (usize, usize)| {
                (row == 0 || row == self.nrow - 1) && (col == 0 || col == self.ncol - 1)
            };
            // The upright edge at a corner of the field.
            let upright = |i: usize| far[i] && far[i + 3] && end(prism.nodes[i]);
            let wall = |i: usize, k: usize| {
                (far[i] || far[i + 3])
                    && (far[k] || far[k + 3])
                    && self.border(prism.nodes[i], prism.nodes[k])
            };
            return under || (0..3).any(upright) || wall(0, 1) || wall(1, 2) || wall(2, 0);
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

/// A box in the field's axes.
struct Bounds {
    low: V3<f64>,
    high: V3<f64>,
}

/// Rows and columns of cells, the first and the last of each; None: no cell.
struct Stretch(Option<[(usize, usize); 2]>);

impl Stretch {
    fn holds(&self, (row, col): (usize, usize)) -> bool {
        let between = |i: usize, (low, high): (usize, usize)| low <= i && i <= high;
        self.0.is_some_and(|[rows, columns]| between(row, rows) && between(col, columns))
    }

    /// Returns the prisms of its cells that may have contacts.
    fn prisms<'a>(&self, near: &'a Near) -> impl Iterator<Item = Prism> + 'a {
        self.0.into_iter().flat_map(move |[rows, columns]| {
            (rows.0..=rows.1).flat_map(move |row| {
                (columns.0..=columns.1).flat_map(move |col| {
                    // One field can have as many cells in a row as in all.
                    if (row * near.field.ncol + col) % CELLS == 0 {
                        checkpoint();
                    }
                    [false, true].into_iter().filter_map(move |upper| near.prism(row, col, upper))
                })
            })
        })
    }
}

/// The data that determine which prisms may have contacts with a shape nearer than `within`.
struct Near<'a> {
    field: &'a HeightField,
    pose: &'a Pose<f64>,
    body: &'a Solid<'a, f64>,
    bounds: &'a Bounds,
    centre: V3<f64>,
    within: f64,
}

impl<'a> Near<'a> {
    fn new(
        field: &'a HeightField,
        pose: &'a Pose<f64>,
        body: &'a Solid<'a, f64>,
        bounds: &'a Bounds,
        within: f64,
    ) -> Self {
        let centre = (bounds.low + bounds.high) * 0.5;
        // Larger than rounding.
        let far = centre.dot(&centre).sqrt() + field.half[0] + field.half[1];
        let slack = SAME * body.extent() + 64.0 * f64::EPSILON * far;
        Self {
            field,
            pose,
            body,
            bounds,
            centre: pose.to_local(&(body.pose.pos - pose.pos)),
            within: within.max(0.0) + slack,
        }
    }

    /// Returns a prism of a cell, unless all of its contacts are proven to be farther.
    ///
    /// The two places of a contact are `dist` apart along its normal. If the normal is the top's,
    /// `dist` is at least the shape's height above the top's plane, and the shape's place is beside the
    /// prism by at most its depth times the slope of the normal. Any other contact is the shortest way
    /// between the two.
    fn prism(&self, row: usize, col: usize, upper: bool) -> Option<Prism> {
        let Self { field, pose, body, bounds, centre, within } = *self;
        if within.is_infinite() {
            return Some(field.prism(row, col, upper));
        }
        let third = if upper { (row + 1, col) } else { (row, col + 1) };
        let height = |(r, c): (usize, usize)| field.heights[r * field.ncol + c];
        let top = height((row, col)).max(height(third)).max(height((row + 1, col + 1)));
        if bounds.low.z > top + within {
            return None;
        }
        let prism = field.prism(row, col, upper);
        let within = within + SAME * prism_size(&prism);
        // Gap of the shape beyond a corner along a direction.
        let beyond = |way: &V3<f64>, corner: &V3<f64>| {
            let point = pose.to_local(&body.support(&-pose.to_world(way)).0);
            way.dot(&(centre + point - corner)) - body.radius
        };
        let [a, _, c, ..] = prism.corners;
        let up = prism.normal();
        let above = beyond(&up, &a);
        let sideways = within.max(-above * (up.x * up.x + up.y * up.y).sqrt());
        let gap = |i: usize| (a[i].min(c[i]) - bounds.high[i]).max(bounds.low[i] - a[i].max(c[i]));
        if above > within || gap(0) > sideways || gap(1) > sideways {
            return None;
        }
        // The side that the two prisms share.
        let way = if upper {
            V3::new(c.y - a.y, a.x - c.x, 0.0)
        } else {
            V3::new(a.y - c.y, c.x - a.x, 0.0)
        };
        let across = beyond(&(way * (1.0 / way.dot(&way).sqrt())), &a);
        (across <= sideways).then_some(prism)
    }
}

/// A height field, and a shape of this type.
#[derive(Clone, Copy, Debug)]
pub struct OnField {
    pub kind: GeomType,
    /// Shapes at least this far apart [m] have no contact.
    pub within: f64,
}

impl OneWorld<MOST> for OnField {
    fn touches<R: Real>(&self, one: &Shape<R>, two: &Shape<R>) -> Touches<R, MOST> {
        match one.field {
            Some(field) => on_field(field, one.pose, &solid(self.kind, two), self.within),
            None => [empty(); MOST],
        }
    }
}

fn on_field<R: Real>(
    field: &HeightField,
    pose: &Pose<R>,
    shape: &Solid<R>,
    within: f64,
) -> Touches<R, MOST> {
    let plain_pose = plain(pose);
    let plain_shape = plain(shape.pose);
    let body = Solid { core: shape.core, radius: shape.radius, pose: &plain_shape };
    let centre = plain_pose.to_local(&(plain_shape.pos - plain_pose.pos));
    // The shape's box in the field's axes.
    let mut bounds = Bounds { low: V3::zeros(), high: V3::zeros() };
    for i in 0..3 {
        let axis = plain_pose.axis(i);
        bounds.high[i] = centre[i] + axis.dot(&body.support(&axis).0) + shape.radius;
        bounds.low[i] = centre[i] + axis.dot(&body.support(&-axis).0) - shape.radius;
    }
    let near = Near::new(field, &plain_pose, &body, &bounds, within);
    // The prisms near the shape, within a part of its extent, and then others that may be near enough.
    let extents = bounds.high - bounds.low;
    let beside = 0.25 * extents.iter().fold(0.0_f64, |most, x| most.max(*x));
    let first = field.stretch(&bounds, beside);
    let mut prisms = first.prisms(&near).filter(|prism| prism.near(&bounds, beside)).peekable();
    if prisms.peek().is_none() && within <= beside {
        return [empty(); MOST];
    }
    let mut list = List::new([plain_pose.axis(0), plain_pose.axis(1)]);
    prisms.for_each(|prism| on_prism(field, &prism, pose, shape, &centre, &mut list));
    let enough = |list: &List<R>| if within.is_finite() { within } else { list.least() };
    if enough(&list) > beside {
        for prism in field.stretch(&bounds, enough(&list)).prisms(&near) {
            let known = first.holds(prism.nodes[0]) && prism.near(&bounds, beside);
            if !known && prism.apart(&bounds) < enough(&list) {
                on_prism(field, &prism, pose, shape, &centre, &mut list);
            }
        }
    }
    // Under a valley every way out may lead into another prism: then a top holds the shape below it.
    if let Some((prism, _)) = list.sunk.take().filter(|_| list.least() >= 0.0) {
        let wedge = solid::Prism::of(prism.corners);
        let ground = Solid { core: Core::Prism(&wedge), radius: 0.0, pose };
        let found = on_top(&prism, &plain_pose, &body);
        let touches: Touches<R, 8> = contacts(&ground, shape, &found);
        list.add_all(&prism, &touches, SAME * shape.extent(), |_| true);
    }
    list.chosen(SAME * shape.extent())
}

/// Adds the contacts of one prism that are the field's.
#[inline(never)]
fn on_prism<R: Real>(
    field: &HeightField,
    prism: &Prism,
    pose: &Pose<R>,
    shape: &Solid<R>,
    centre: &V3<f64>,
    list: &mut List<R>,
) {
    let wedge = solid::Prism::of(prism.corners);
    let ground = Solid { core: Core::Prism(&wedge), radius: 0.0, pose };
    // The choice among a field's contacts depends on all of them, near or far.
    let Some(separation) = meeting(&ground, shape, f64::INFINITY, None) else { return };
    let way = plain(pose).to_local(&separation.normal);
    let tolerance = SAME * (shape.extent() + prism_size(prism));
    let (found, own) = if field.leads_out(prism, &way, centre, tolerance) {
        (separation, true)
    } else {
        let over = over_top(field, prism, pose, shape);
        // Behind a steep top, and not in its prism: other prisms have the contact.
        let behind = separation.apart > tolerance;
        match over.filter(|(found, own)| !(*own && behind && found.apart < -tolerance)) {
            Some(over) => over,
            None => return list.drop_way(prism, &separation, shape.radius),
        }
    };
    let touches: Touches<R, 8> = contacts(&ground, shape, &found);
    let there = || touches.iter().filter(|touch| touch.exists.any());
    if !own && there().count() == 1 {
        // Nothing lies flat on this top: the single place belongs to another prism.
        return list.drop_way(prism, &separation, shape.radius);
    }
    list.add_all(prism, &touches, tolerance, |touch| {
        let at = plain(pose).to_local(&(touch.pos.map(|x| x.lane(0)) - plain(pose).pos));
        own || prism.holds(&at, tolerance)
    });
}

/// Returns the longest side of a prism's top.
fn prism_size(prism: &Prism) -> f64 {
    let way = prism.corners[2] - prism.corners[0];
    way.dot(&way).sqrt()
}

/// Returns the separation along the top's normal, if the shape's deepest point is over the top (true)
/// or over ground that continues its plane (false).
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
    let in_plane = || {
        let Some(ground) = field.surface(&point) else { return false };
        // Over this top, but next to it along the normal: an edge or a corner is nearer.
        let own = ground.iter().all(|corner| prism.corners[..3].contains(corner));
        !own && ground.iter().all(|corner| {
            let (way, height) = (corner - a, local.dot(&(corner - a)));
            height * height <= SAME_PLANE * SAME_PLANE * way.dot(&way)
        })
    };
    (over || in_plane()).then(|| (on_top(prism, &pose, &body), over))
}

/// Returns the separation along the top's normal.
fn on_top(prism: &Prism, pose: &Pose<f64>, body: &Solid<f64>) -> Separation {
    let local = prism.normal();
    let normal = pose.to_world(&local);
    let point = pose.to_local(&(body.pose.pos - pose.pos + body.support(&-normal).0));
    let apart = local.dot(&(point - prism.corners[0]));
    Separation { normal, apart, cause: Cause::FaceOne(local) }
}
