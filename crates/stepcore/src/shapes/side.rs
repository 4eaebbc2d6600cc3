//! The side of a cylinder fixes the direction, when that is certain without a search.
//!
//! Seen along its axis the cylinder is a disc, and the shape beside it a shadow with corners and
//! edges. Along no direction across the axis are the two further apart than along the line from the
//! axis to the place p of the shadow nearest to it, by |p| − r. Of shapes apart that is the distance
//! if p lies between the caps. Of shapes that overlap it is the shortest way out if p lies deeper
//! below the caps than below the side: two minus one holds the cylinder around p, and no way out of
//! that is shorter.

use super::separation::{across, Cause, Pairing, Separation};
use super::solid::{Core, Solid};
use super::touch::unit;
use crate::spatial::V3;

/// Over the size of the pair: by how much one place must be nearer than others than rounding takes.
const CLEAR: f64 = 1e-9;
/// Corners of the shadow that are visited.
const MOST: usize = 16;

/// A corner, from the middle of the cylinder, and what of it is across the axis.
#[derive(Clone, Copy)]
struct Corner {
    piece: usize,
    at: V3<f64>,
    aside: V3<f64>,
}

/// A cylinder and the corners beside it.
struct Beside<'a> {
    other: &'a Solid<'a, f64>,
    /// From the middle of the cylinder to the other's centre.
    way: V3<f64>,
    axis: V3<f64>,
    clear: f64,
}

/// The place of the shadow nearest to the axis, and the corners that it lies between: two, or one twice.
struct Nearest {
    place: V3<f64>,
    corners: [Corner; 2],
}

impl Pairing<'_> {
    /// What the side of a cylinder beside a polytope says, sought from a rough direction, if no search can
    /// find more.
    pub(super) fn on_side(&self, rough: &V3<f64>) -> Option<Separation> {
        let (one, two) = (&self.one, &self.two);
        let (cylinder, other, sign) = match (one.core, two.core) {
            (Core::Cylinder(..), _) if !two.smooth() => (one, two, 1.0),
            (_, Core::Cylinder(..)) if !one.smooth() => (two, one, -1.0),
            _ => return None,
        };
        let Core::Cylinder(radius, half) = cylinder.core else { return None };
        let axis = cylinder.pose.axis(2);
        let clear = CLEAR * self.size;
        let beside = Beside { other, way: self.between * sign, axis, clear };
        let Nearest { place, corners: [a, b] } = beside.nearest(&(rough * sign))?;
        let (outward, edge) = if a.piece == b.piece {
            (unit(&beside.across(&place)), None)
        } else {
            let edge = unit(&(b.at - a.at));
            (across(&axis, &edge, &place)?, Some(edge))
        };
        let deep = radius - outward.dot(&place);
        let level = half - axis.dot(&place).abs() > deep.max(0.0) + clear;
        if !level || !beside.alone(&outward, [&a, &b]) {
            return None;
        }
        let [own, of_other] =
            [cylinder.pose.to_local(&axis), edge.map_or(axis, |edge| other.pose.to_local(&edge))];
        let cause = match (edge.is_some(), sign > 0.0) {
            (true, true) => Cause::Edges(own, of_other),
            (true, false) => Cause::Edges(of_other, own),
            (false, true) => Cause::EdgeOne(own),
            (false, false) => Cause::EdgeTwo(own),
        };
        let normal = outward * sign;
        Some(Separation { normal, apart: self.apart(&normal), cause })
    }
}

impl Beside<'_> {
    fn across(&self, way: &V3<f64>) -> V3<f64> {
        way - self.axis * self.axis.dot(way)
    }

    fn corner(&self, (at, piece): (V3<f64>, usize)) -> Corner {
        let at = self.way + at;
        Corner { piece, at, aside: self.across(&at) }
    }

    /// The way of `gjk`, in the plane across the axis; None where that goes through the other shape.
    fn nearest(&self, rough: &V3<f64>) -> Option<Nearest> {
        let mut a = self.corner(self.other.support(&-self.across(rough)));
        let mut near = Nearest { place: a.at, corners: [a, a] };
        for _ in 0..MOST {
            let foot = self.across(&near.place);
            let square = foot.dot(&foot);
            if square <= self.clear * self.clear {
                return None;
            }
            let next = self.corner(self.other.support_from(a.piece, &-foot));
            let gained = square - foot.dot(&next.aside);
            let known = near.corners.iter().any(|corner| corner.piece == next.piece);
            if known || gained <= self.clear * square.sqrt() {
                return Some(near);
            }
            let [one, two] = near.corners.map(|corner| self.between(&corner, &next));
            let closer = |x: &Nearest, y: &Nearest| {
                let [x, y] = [x, y].map(|near| self.across(&near.place));
                x.dot(&x) <= y.dot(&y)
            };
            near = if closer(&one, &two) { one } else { two };
            a = next;
        }
        None
    }

    /// The place of an edge nearest to the axis.
    fn between(&self, a: &Corner, b: &Corner) -> Nearest {
        let along = b.aside - a.aside;
        let (share, square) = (-along.dot(&a.aside), along.dot(&along));
        if share <= 0.0 || square == 0.0 {
            Nearest { place: a.at, corners: [*a, *a] }
        } else if share >= square {
            Nearest { place: b.at, corners: [*b, *b] }
        } else {
            Nearest { place: a.at + (b.at - a.at) * (share / square), corners: [*a, *b] }
        }
    }

    /// The corners that a direction was made of are its nearest for sure: two have an edge that folds between
    /// them, and all corners beside them are further.
    fn alone(&self, outward: &V3<f64>, [a, b]: [&Corner; 2]) -> bool {
        let others = |corner: &Corner| {
            let piece = corner.piece;
            (0..).map_while(move |k| self.other.neighbour(piece, k))
        };
        let further = |piece: usize, from: &Corner| {
            let way = self.way + self.other.corner(piece) - from.at;
            outward.dot(&way) > self.clear
        };
        let folds = || (0..).map_while(|k| self.other.fold(a.piece, k)).any(|k| k == b.piece);
        (a.piece == b.piece || folds())
            && [a, b].iter().all(|from| {
                others(from).filter(|k| ![a.piece, b.piece].contains(k)).all(|k| further(k, from))
            })
    }
}

#[cfg(test)]
mod tests {
    use super::super::hint::Hint;
    use super::super::hull::Hull;
    use super::super::separation::Pairing;
    use super::super::solid::{Core, Solid};
    use super::super::trial::Random;
    use crate::spatial::V3;
    use core::cell::Cell;
    use nalgebra::Rotation3;

    /// A cylinder that moves through polytopes has the contacts, bit for bit, of those who know nothing of
    /// the step before; what its side says no search finds shorter, and it says so from wherever it is asked.
    #[test]
    fn what_a_side_says_the_search_finds() {
        let mut random = Random(7);
        let (mut met, mut on_side, mut deep) = (0, 0, 0);
        for case in 0..300 {
            let points: Vec<[f64; 3]> = (0..[8, 40, 200][case % 3])
                .map(|_| (random.vector().normalize() * 0.12).into())
                .collect();
            let hull = Hull::of(&points).unwrap();
            let other = match case % 5 {
                0 => Core::Box([0.1, 0.15, 0.05]),
                1 => Core::Segment(0.15),
                _ => Core::Hull(&hull),
            };
            let cylinder = Core::Cylinder(0.07, [0.025, 0.2][case % 2]);
            let cores = if case % 4 < 2 { [cylinder, other] } else { [other, cylinder] };
            let mut poses = [random.pose(0.1), random.pose(0.1)];
            let (drift, spin) = (random.vector() * 3e-3, random.vector() * 0.02);
            let hint = Cell::new(Hint::default());
            for _ in 0..60 {
                poses[1].pos += drift;
                poses[1].rot = Rotation3::new(spin).into_inner() * poses[1].rot;
                let solid = |i: usize| Solid { core: cores[i], radius: 0.0, pose: &poses[i] };
                let pairing = Pairing::new(solid(0), solid(1));
                let known = pairing.separation(0.01, Some(&hint));
                let blind = pairing.separation(0.01, None);
                let bits = |found: Option<super::Separation>| found.map(|s| (s.normal, s.apart));
                assert_eq!(bits(known), bits(blind), "case {case} {known:?} {blind:?}");
                let Some(found) = blind else { continue };
                met += 1;
                let asked = |way: &V3<f64>| pairing.on_side(way);
                if let Some(own) = asked(&found.normal) {
                    on_side += 1;
                    deep += usize::from(own.apart < 0.0);
                    let sought = pairing.search(f64::INFINITY, None).unwrap();
                    let gain = sought.apart - own.apart;
                    assert!(gain <= 1e-12 && gain >= -2e-5 * own.apart.abs() - 1e-7, "{gain:e}");
                    for other in [asked(&random.vector()), asked(&pairing.between)] {
                        assert!(other.is_none() || bits(other) == bits(Some(own)), "case {case}");
                    }
                }
            }
        }
        assert!(deep > 1000 && 4 * on_side > met, "{deep} {on_side} {met}");
    }
}
