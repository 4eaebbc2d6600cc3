//! The point of a convex set nearest to the origin: Gilbert, Johnson and Keerthi (1988).
//!
//! The set is given by its support function. A simplex of at most four of its points moves towards the
//! origin: its nearest point v is found, points that v does not need are dropped, and the set's
//! furthest point along −v joins. |v| is never less than the distance, v·w/|v| never more: once the
//! latter is as much as a caller needs, the walk ends.

use crate::spatial::V3;

/// A point of the set: the difference of two shapes' points, and the pieces that these belong to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vertex {
    pub at: V3<f64>,
    pub pieces: [u32; 2],
}

/// The end of the walk.
pub struct Nearest {
    /// The nearest point found; for a set beyond `enough`, a direction that shows it.
    pub point: V3<f64>,
    /// The points that it lies between; four of them hold the origin.
    pub simplex: [Vertex; 4],
    pub count: usize,
    /// The origin is inside or so near that the direction means nothing.
    pub inside: bool,
    /// The distance is more than `enough`; the other fields are not valid.
    pub beyond: bool,
    /// Number of calls of the support function.
    pub asked: usize,
}

const MOST: usize = 64;
/// Squared distance over squared size below which a direction means nothing.
const TOUCHING: f64 = 1e-20;

/// `gap`: the relative error of the distance at which the walk may end. `enough`: a distance (not
/// negative) beyond which it may end too.
pub fn gjk(
    support: impl Fn(&V3<f64>) -> Vertex,
    toward: V3<f64>,
    gap: f64,
    enough: f64,
) -> Nearest {
    let first = support(&-toward);
    let mut at = Nearest {
        point: first.at,
        simplex: [first, Vertex::default(), Vertex::default(), Vertex::default()],
        count: 1,
        inside: false,
        beyond: beyond(&first.at, &toward, enough),
        asked: 1,
    };
    if at.beyond {
        at.point = toward;
        return at;
    }
    let mut size = first.at.dot(&first.at);
    let mut length = size;
    while at.asked < MOST {
        if length <= TOUCHING * size {
            at.inside = true;
            return at;
        }
        let w = support(&-at.point);
        at.asked += 1;
        if beyond(&w.at, &at.point, enough) {
            at.beyond = true;
            return at;
        }
        size = size.max(w.at.dot(&w.at));
        let known = at.simplex[..at.count].iter().any(|corner| corner.at == w.at);
        if known || length - at.point.dot(&w.at) <= gap * length {
            return at;
        }
        let mut next = at.simplex;
        next[at.count] = w;
        let (point, simplex, count) = reduce(&next, at.count + 1);
        let shorter = point.dot(&point);
        if count == 4 {
            (at.simplex, at.count, at.inside) = (simplex, count, true);
            return at;
        }
        if shorter >= length {
            // Only rounding is left.
            return at;
        }
        (at.point, at.simplex, at.count, length) = (point, simplex, count, shorter);
    }
    at
}

/// Checks that the plane across a direction through the set's furthest point w against it is further
/// than `enough` from the origin.
pub fn beyond(w: &V3<f64>, along: &V3<f64>, enough: f64) -> bool {
    let reach = w.dot(along);
    reach > 0.0 && reach * reach > enough * enough * along.dot(along)
}

type Reduced = (V3<f64>, [Vertex; 4], usize);

/// Returns the point of a simplex nearest to the origin, and the corners between which it lies.
fn reduce(simplex: &[Vertex; 4], count: usize) -> Reduced {
    match count {
        2 => segment(&simplex[0], &simplex[1]),
        3 => triangle(&simplex[0], &simplex[1], &simplex[2]),
        _ => tetrahedron(simplex),
    }
}

fn corner(a: &Vertex) -> Reduced {
    (a.at, [*a, Vertex::default(), Vertex::default(), Vertex::default()], 1)
}

fn segment(first: &Vertex, last: &Vertex) -> Reduced {
    let (a, b) = (first.at, last.at);
    let along = b - a;
    let (before, after) = (-a.dot(&along), b.dot(&along));
    if before <= 0.0 {
        corner(first)
    } else if after <= 0.0 {
        corner(last)
    } else {
        // The foot, from the nearer end, and exactly across.
        let square = along.dot(&along);
        let foot = if before < after {
            a + along * (before / square)
        } else {
            b - along * (after / square)
        };
        (foot, [*first, *last, Vertex::default(), Vertex::default()], 2)
    }
}

/// Returns the nearest of the edges' points, unless the foot of the perpendicular is inside.
fn triangle(first: &Vertex, second: &Vertex, third: &Vertex) -> Reduced {
    let [a, b, c] = [first.at, second.at, third.at];
    let normal = (b - a).cross(&(c - a));
    let square = normal.dot(&normal);
    let inner = [(a, b), (b, c), (c, a)].map(|(p, q)| p.cross(&q).dot(&normal));
    if square > 0.0 && inner.iter().all(|x| *x > 0.0) {
        let height = a.dot(&normal) / square;
        return (normal * height, [*first, *second, *third, Vertex::default()], 3);
    }
    nearer(nearer(segment(first, second), segment(second, third)), segment(third, first))
}

fn tetrahedron(s: &[Vertex; 4]) -> Reduced {
    let mut best: Option<Reduced> = None;
    for [i, j, k, m] in [[0, 1, 2, 3], [0, 1, 3, 2], [0, 2, 3, 1], [1, 2, 3, 0]] {
        let from = s[i].at;
        let normal = (s[j].at - from).cross(&(s[k].at - from));
        let (inward, origin) = (normal.dot(&(s[m].at - from)), -normal.dot(&from));
        // On the other side from the fourth corner, or a flat tetrahedron.
        if inward == 0.0 || (inward > 0.0) != (origin > 0.0) {
            let this = triangle(&s[i], &s[j], &s[k]);
            best = Some(best.map_or(this, |best| nearer(best, this)));
        }
    }
    best.unwrap_or((V3::zeros(), *s, 4))
}

fn nearer(one: Reduced, two: Reduced) -> Reduced {
    if two.0.dot(&two.0) < one.0.dot(&one.0) {
        two
    } else {
        one
    }
}
