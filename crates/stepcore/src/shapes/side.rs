//! The side of a cylinder as the direction of a separation, if certain without a search.
//!
//! In the projection along its axis the cylinder is a disc, and the shape next to it a shadow with
//! corners and edges. Along no direction across the axis are the two further apart than along the line
//! from the axis to the place p of the shadow nearest to it, by |p| − r. For shapes apart this is the
//! distance if p lies between the caps. For shapes that overlap it is the shortest way out if p lies
//! deeper below the caps than below the side: two minus one holds the cylinder around p, which has no
//! shorter way out.

use super::gjk::{gjk, Vertex};
use super::separation::{across, Cause, Pairing, Separation};
use super::solid::{Core, Solid};
use super::touch::unit;
use crate::spatial::V3;

/// Over the size of the pair: margin over rounding by which one place must be nearer than others.
const CLEAR: f64 = 1e-9;
/// The relative error of the shadow's distance: rounding.
const GAP: f64 = 1e-15;

impl Pairing<'_> {
    /// Returns the separation along the side of a cylinder next to a polytope, searched from a rough
    /// direction, if no search can find more.
    #[inline(never)] // It is large, and rarely called.
    pub(super) fn on_side(&self, rough: &V3<f64>) -> Option<Separation> {
        let (one, two) = (&self.one, &self.two);
        let (cylinder, other, sign) = match (one.core, two.core) {
            (Core::Cylinder(..), _) if !two.smooth() => (one, two, 1.0),
            (_, Core::Cylinder(..)) if !one.smooth() => (two, one, -1.0),
            _ => return None,
        };
        let Core::Cylinder(radius, half) = cylinder.core else { return None };
        let (axis, clear) = (cylinder.pose.axis(2), CLEAR * self.size);
        let sideways = |way: &V3<f64>| way - axis * axis.dot(way);
        // From the middle of the cylinder.
        let corner = |piece: usize| self.between * sign + other.corner(piece);
        let shadow = |way: &V3<f64>| {
            self.ask();
            let piece = other.support(way).1;
            Vertex { at: sideways(&corner(piece)), pieces: [piece as u32; 2] }
        };
        let nearest = gjk(shadow, sideways(&(rough * sign)), GAP, f64::INFINITY);
        let foot = nearest.point;
        if nearest.inside || foot.dot(&foot) <= clear * clear {
            return None;
        }
        let piece = |of: &Vertex| of.pieces[0] as usize;
        let (pieces, place, outward, edge) = match &nearest.simplex[..nearest.count] {
            [a] => ([piece(a); 2], corner(piece(a)), unit(&a.at), None),
            [a, b] => {
                let (from, way) = (corner(piece(a)), corner(piece(b)) - corner(piece(a)));
                let along = b.at - a.at;
                let place = from - way * (along.dot(&a.at) / along.dot(&along));
                let edge = unit(&way);
                ([a, b].map(piece), place, across(&axis, &edge, &place)?, Some(edge))
            }
            _ => return None,
        };
        let deep = radius - outward.dot(&place);
        let level = half - axis.dot(&place).abs() > deep.max(0.0) + clear;
        if !level || !alone(other, &outward, pieces, clear) {
            return None;
        }
        let own = cylinder.pose.to_local(&axis);
        let cause = match (edge.map(|edge| other.pose.to_local(&edge)), sign > 0.0) {
            (Some(edge), true) => Cause::Edges(own, edge),
            (Some(edge), false) => Cause::Edges(edge, own),
            (None, true) => Cause::EdgeOne(own),
            (None, false) => Cause::EdgeTwo(own),
        };
        let normal = outward * sign;
        Some(Separation { normal, apart: self.apart(&normal), cause })
    }
}

/// Checks that a corner, or two with an edge that folds between them, are certainly the furthest
/// against a direction: all neighbouring corners are less far.
fn alone(of: &Solid<f64>, outward: &V3<f64>, [a, b]: [usize; 2], clear: f64) -> bool {
    let height = |corner: usize| outward.dot(&of.corner(corner));
    let beside = |corner: usize| (0..).map_while(move |k| of.neighbour(corner, k));
    let lowest = |corner: usize| {
        let mut others = beside(corner).filter(|k| ![a, b].contains(k));
        others.all(|k| height(k) > height(corner) + clear)
    };
    let folds = || (0..).map_while(|k| of.fold(a, k)).any(|k| k == b);
    (a == b || folds()) && lowest(a) && lowest(b)
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

    /// A cylinder that moves through polytopes has the same contacts, bit for bit, without the step
    /// before. No search finds a shorter way than its side, whose result is the same from any start.
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
