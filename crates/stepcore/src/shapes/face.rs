//! Faces that determine the direction of a separation, and when they do so without a search.
//!
//! Two minus one is a convex set. Across a direction n it has a supporting plane, at −s(n) from the
//! origin, and in this plane a face of one of the two spans a part of it. For shapes apart this part is
//! nearest to the origin if it holds the origin's foot. For shapes that overlap by d = −s it is the
//! shortest way out if no supporting plane is nearer. A plane that is turned by an angle a lies at
//! least d cos a + r sin a from the origin, where r is the foot's room, the radius of a disc around it
//! that the set holds: no less than d up to a = 2 atan(r/d). A plane turned further lies beyond the
//! set's furthest point along n.

use super::separation::{Cause, Pairing, Separation, ROUNDING};
use crate::spatial::V3;

/// Margin of the room over rounding, as a part of the size of the pair.
const CLEAR: f64 = 1e-9;
/// The margin for a face, which is level except for 1e-9: over 1e-9/1.4e-3, the angle within which a
/// search's direction counts as the face's.
const ROOM: f64 = 1e-6;

/// The separation along a face of one of the two, the face, and the feature of the other one over it:
/// from the centre of the face's shape.
pub struct Facing {
    pub separation: Separation,
    face: usize,
    over: V3<f64>,
}

impl Pairing<'_> {
    /// Returns the faces of both whose normals are nearest to a direction, if the cosine of the angle
    /// to it is at least this.
    pub(super) fn facing(&self, rough: &V3<f64>, cosine: f64) -> [Option<Facing>; 2] {
        let along = |face: &(V3<f64>, f64, usize)| face.1 >= cosine;
        let least = |normal: &V3<f64>| {
            let [(near, _), (far, _)] = self.ends(&-normal);
            (normal.dot(&(self.between + (far - near))), near, self.between + far)
        };
        let of_one = self.one.face(rough).filter(along).map(|(normal, _, face)| {
            let cause = Cause::FaceOne(self.one.pose.to_local(&normal));
            let (apart, _, over) = least(&normal);
            Facing { separation: Separation { normal, apart, cause }, face, over }
        });
        let of_two = self.two.face(&-rough).filter(along).map(|(outward, _, face)| {
            let (normal, cause) = (-outward, Cause::FaceTwo(self.two.pose.to_local(&outward)));
            let (apart, over, _) = least(&normal);
            Facing {
                separation: Separation { normal, apart, cause },
                face,
                over: over - self.between,
            }
        });
        [of_one, of_two]
    }

    /// Returns the largest of the faces' separations; the first one's if they differ by rounding.
    pub(super) fn best_of(&self, facing: &[Option<Facing>; 2]) -> Option<Separation> {
        let [one, two] = facing.each_ref().map(|facing| facing.as_ref().map(|own| own.separation));
        match (one, two) {
            (Some(one), Some(two)) if two.apart > one.apart + ROUNDING * self.size => Some(two),
            (one, two) => one.or(two),
        }
    }

    /// Returns the separation along a face near a direction, if no search can find more. `proven`: the
    /// answer, if it is established already.
    pub(super) fn on_face(
        &self,
        near: &V3<f64>,
        cosine: f64,
        proven: Option<&Separation>,
    ) -> Option<Separation> {
        let facing = self.facing(near, cosine);
        let best = self.best_of(&facing)?;
        if proven.is_some_and(|proven| proven.normal == best.normal) {
            return Some(best);
        }
        let certain = |facing: &Facing| {
            let even = facing.separation.apart >= best.apart - ROUNDING * self.size;
            let room = self.room_on(facing);
            even && room > ROOM * self.size && self.certain(&facing.separation, room)
        };
        facing.iter().flatten().any(certain).then_some(best)
    }

    /// Checks that no direction within twice an angle with this tangent has more than the best face.
    pub(super) fn tops(
        &self,
        facing: &[Option<Facing>; 2],
        best: &Separation,
        tangent: f64,
    ) -> bool {
        facing.iter().flatten().filter(|own| own.separation.normal == best.normal).any(|own| {
            let room = self.room_on(own);
            room > ROOM * self.size && room >= -best.apart * tangent
        })
    }

    /// Returns the distance of the feature over a face from the face's sides; negative next to it. If
    /// it is a face or an edge, of which `over` is some corner, its place nearest to the middle counts.
    fn room_on(&self, Facing { separation, face, over }: &Facing) -> f64 {
        let n = separation.normal;
        let (own, other, outward, way) = match separation.cause {
            Cause::FaceOne(_) => (&self.one, &self.two, n, self.between),
            _ => (&self.two, &self.one, -n, -self.between),
        };
        let room = own.room(*face, over);
        if room > ROOM * self.size {
            return room;
        }
        let Some(middle) = own.middle(*face) else { return room };
        own.room(*face, &(other.furthest_near(&-outward, &(middle - way)) + way)).max(room)
    }

    /// Checks that no other direction has more. `room`: the room of the origin's foot.
    fn certain(&self, found: &Separation, room: f64) -> bool {
        if room <= CLEAR * self.size || found.apart >= 0.0 {
            return room > CLEAR * self.size;
        }
        let (n, depth) = (&found.normal, -found.apart);
        let furthest = self.furthest(n);
        let up = n.dot(&furthest);
        let sideways = furthest - n * up;
        // Cosine and sine, times depth² + room², of π − 2 atan(room/depth).
        let (cosine, sine) = (room * room - depth * depth, 2.0 * room * depth);
        let beyond = cosine * up - sine * sideways.dot(&sideways).sqrt();
        beyond >= (depth + CLEAR * self.size) * (room * room + depth * depth)
    }
}

#[cfg(test)]
mod tests {
    use super::super::convex::solid;
    use super::super::hull::Hull;
    use super::super::separation::Pairing;
    use super::super::solid::{Core, Solid};
    use super::super::trial::{at, Random};
    use super::super::Shape;
    use crate::scene::GeomType;
    use crate::spatial::Pose;
    use nalgebra::{Matrix3, Rotation3, Vector3};

    const KINDS: [GeomType; 5] =
        [GeomType::Capsule, GeomType::Ellipsoid, GeomType::Cylinder, GeomType::Box, GeomType::Mesh];

    /// If a face is certain the search finds the same, bit for bit: for random shapes, and for shapes
    /// that lie on a face, level but for `tilt`. Returns the number of certain cases.
    fn certain(random: &mut Random, tilt: Option<f64>) -> usize {
        let mut certain = 0;
        for case in 0..2500 {
            let kinds = [KINDS[case % 5], KINDS[case / 5 % 5]];
            let sizes = [random.size(), random.size()];
            let hulls = [0; 2].map(|_| {
                let points: Vec<[f64; 3]> = (0..20).map(|_| random.vector().into()).collect();
                Hull::of(&points).unwrap()
            });
            let mut poses = [random.pose(0.6), random.pose(0.6)];
            if let Some(tilt) = tilt {
                let turn = Rotation3::new(random.vector() * tilt).into_inner();
                let height = sizes[0][2].min(sizes[0][1]) + sizes[1][2].min(sizes[1][1]);
                let pos = Vector3::new(0.1, 0.05, height - 0.02);
                poses = [
                    Pose { pos: Vector3::zeros(), rot: Matrix3::identity() },
                    Pose { pos, rot: turn },
                ];
            }
            let shape = |i: usize| Shape {
                pose: &poses[i],
                size: &sizes[i],
                hull: Some(&hulls[i]),
                field: None,
            };
            let shapes = [shape(0), shape(1)];
            let pairing = Pairing::new(solid(kinds[0], &shapes[0]), solid(kinds[1], &shapes[1]));
            let found = pairing.search(f64::INFINITY, None).unwrap();
            if let Some(face) = pairing.on_face(&found.normal, -1.0, None) {
                assert_eq!(format!("{face:?}"), format!("{found:?}"), "{kinds:?} {poses:?}");
                certain += 1;
            }
        }
        certain
    }

    #[test]
    fn what_a_face_says_the_search_finds() {
        let mut random = Random(5);
        for tilt in [None, Some(0.0), Some(1e-10), Some(1e-7), Some(1e-3)] {
            assert!(certain(&mut random, tilt) > 250, "{tilt:?}");
        }
    }

    /// Corners around an axis, and one at each end of it.
    fn gem(n: usize, size: f64) -> Vec<[f64; 3]> {
        let angle = |i: usize| core::f64::consts::PI * i as f64 / n as f64;
        let around = |i: usize| [size * angle(i).cos(), size * angle(i).sin(), 0.0];
        let ends = [[0.0, 0.0, size], [0.0, 0.0, -size]];
        (0..2 * n).map(around).chain(ends).collect()
    }

    /// Two hulls that move through each other have the same contacts, bit for bit, without the step
    /// before. Counts the overlaps, and the cases in which the shell of the step before is enough.
    #[test]
    fn what_the_step_before_proves_the_search_finds() {
        let mut random = Random(11);
        let (mut deep, mut again) = (0, 0);
        for case in 0..120 {
            let count = [8, 60, 400][case % 3];
            let hulls = [0; 2].map(|_| {
                let stretch = random.vector() * 0.5;
                let on_ball = |_| random.vector().normalize().component_mul(&stretch).into();
                let points: Vec<[f64; 3]> = (0..count).map(on_ball).collect();
                Hull::of(&points).unwrap()
            });
            let mut poses = [random.pose(0.2), random.pose(0.2)];
            let (drift, spin) = (random.vector() * 4e-3, random.vector() * 0.02);
            let block = [0.1, 0.2, 0.3];
            // Gems that are placed one above the other: many directions are as good.
            let level = case % 4 == 3;
            let gems = [0.3, 0.2].map(|size| Hull::of(&gem(2 + case % 7, size)).unwrap());
            let hulls = if level { &gems } else { &hulls };
            let (drift, spin) = if level {
                poses = [0.0, 0.45].map(|z| at(0.0, 0.0, z));
                (-4e-3 * Vector3::z(), Vector3::zeros())
            } else {
                (drift, spin)
            };
            let hint = core::cell::Cell::new(crate::shapes::Hint::default());
            for _ in 0..80 {
                poses[1].pos += drift;
                poses[1].rot = Rotation3::new(spin).into_inner() * poses[1].rot;
                let hull = |i: usize| match (i, case % 5) {
                    (1, 0) => Core::Box(block),
                    _ => Core::Hull(&hulls[i]),
                };
                let solid = |i: usize| Solid { core: hull(i), radius: 0.0, pose: &poses[i] };
                let pairing = Pairing::new(solid(0), solid(1));
                let known = pairing.separation(0.0, Some(&hint));
                let asked = pairing.asked();
                let pairing = Pairing::new(solid(0), solid(1));
                let blind = pairing.separation(0.0, None);
                if known.map(|s| s.normal) != blind.map(|s| s.normal) {
                    println!(
                        "DIFF case {case} {known:?} {blind:?} asked {asked} {}",
                        pairing.asked()
                    );
                    continue;
                }
                assert_eq!(known.map(|s| s.apart), blind.map(|s| s.apart), "{poses:?}");
                deep += usize::from(blind.is_some());
                again += usize::from(blind.is_some() && 2 * asked < pairing.asked());
            }
        }

        assert!(deep > 4000 && 2 * again > deep, "{again} of {deep}");
    }
}
