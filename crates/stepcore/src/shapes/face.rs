//! A face that fixes the direction of a separation, and when that is certain without a search.

use super::separation::{Cause, Pairing, Separation, ROUNDING};
use crate::spatial::V3;

/// Over the size of the pair: by how much more room there must be than rounding takes.
const CLEAR: f64 = 1e-9;

/// What a face of one of the two says, and which it is.
pub struct Facing {
    pub separation: Separation,
    face: usize,
}

impl Pairing<'_> {
    /// The faces of both that look most along a direction, if the cosine of the angle to it is as much
    /// as this.
    pub(super) fn facing(&self, rough: &V3<f64>, cosine: f64) -> [Option<Facing>; 2] {
        let along = |face: &(V3<f64>, f64, usize)| face.1 >= cosine;
        let of_one = self.one.face(rough).filter(along).map(|(normal, _, face)| {
            let cause = Cause::FaceOne(self.one.pose.to_local(&normal));
            Facing { separation: Separation { normal, apart: self.apart(&normal), cause }, face }
        });
        let of_two = self.two.face(&-rough).filter(along).map(|(outward, _, face)| {
            let (normal, cause) = (-outward, Cause::FaceTwo(self.two.pose.to_local(&outward)));
            Facing { separation: Separation { normal, apart: self.apart(&normal), cause }, face }
        });
        [of_one, of_two]
    }

    /// Of what faces say the largest; the first one's where they differ by rounding.
    pub(super) fn best_of(&self, facing: &[Option<Facing>; 2]) -> Option<Separation> {
        let [one, two] = facing.each_ref().map(|facing| facing.as_ref().map(|own| own.separation));
        match (one, two) {
            (Some(one), Some(two)) if two.apart > one.apart + ROUNDING * self.size => Some(two),
            (one, two) => one.or(two),
        }
    }

    /// What a face near a direction says, if no search can find more. Of shapes apart: the other one's
    /// nearest point stands over the face. Of shapes that overlap: around the other one's deepest point
    /// the face's own shape has room for a ball as large as the overlap. The difference of the two
    /// shapes then holds that ball around the origin, and no way out is shorter. `proven`: what is known to
    /// be the answer.
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
        let certain = |Facing { separation, face }: &Facing| {
            let Separation { normal, apart, cause } = separation;
            let foot = normal * apart.max(0.0);
            let depth = CLEAR * self.size - apart.min(0.0);
            let even = *apart >= best.apart - ROUNDING * self.size;
            even && match cause {
                Cause::FaceOne(_) => {
                    let point = self.between + self.two.support(&-normal).0 - foot;
                    self.one.under_all_but(*face, &point, depth)
                }
                _ => {
                    let point = self.one.support(normal).0 - self.between + foot;
                    self.two.under_all_but(*face, &point, depth)
                }
            }
        };
        facing.iter().flatten().any(certain).then_some(best)
    }
}

#[cfg(test)]
mod tests {
    use super::super::convex::solid;
    use super::super::hull::Hull;
    use super::super::separation::Pairing;
    use super::super::trial::Random;
    use super::super::Shape;
    use crate::scene::GeomType;
    use crate::spatial::Pose;
    use nalgebra::{Matrix3, Rotation3, Vector3};

    const KINDS: [GeomType; 5] =
        [GeomType::Capsule, GeomType::Ellipsoid, GeomType::Cylinder, GeomType::Box, GeomType::Mesh];

    /// Where a face is certain the search finds the same, bit for bit: of shapes at random, and of
    /// shapes that stand on a face, level but for `tilt`. How often it is certain.
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
            let found = pairing.search(f64::INFINITY).unwrap();
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
        assert!(certain(&mut random, None) > 250);
        for tilt in [0.0, 1e-10, 1e-7, 1e-3] {
            assert!(certain(&mut random, Some(tilt)) > 250);
        }
    }
}
