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
    /// shapes then holds that ball around the origin, and no way out is shorter.
    pub(super) fn on_face(&self, near: &V3<f64>) -> Option<Separation> {
        let facing = self.facing(near, -1.0);
        let best = self.best_of(&facing)?;
        let certain = |Facing { separation, face }: &Facing| {
            let Separation { normal, apart, cause } = separation;
            let foot = normal * apart.max(0.0);
            let outside = match cause {
                Cause::FaceOne(_) => {
                    let point = self.between + self.two.support(&-normal).0;
                    self.one.outside_but(*face, &(point - foot))
                }
                _ => {
                    let point = self.one.support(normal).0 - self.between;
                    self.two.outside_but(*face, &(point + foot))
                }
            };
            let even = *apart >= best.apart - ROUNDING * self.size;
            even && outside < apart.min(0.0) - CLEAR * self.size
        };
        facing.iter().flatten().any(certain).then_some(best)
    }
}
