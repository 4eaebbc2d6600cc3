//! Helpers for the tests of shapes: random poses and sizes, and slopes against differences.

use super::{Shape, Touch};
use crate::real::{Constant, Dual, Real};
use crate::spatial::Pose;
use nalgebra::{Matrix3, Rotation3, Vector3};

pub struct Random(pub u64);

impl Random {
    /// Uniform in [-1, 1).
    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
    pub fn vector(&mut self) -> Vector3<f64> {
        Vector3::new(self.next(), self.next(), self.next())
    }
    pub fn pose(&mut self, spread: f64) -> Pose<f64> {
        let rot = Rotation3::new(self.vector() * 3.0).into_inner();
        Pose { pos: self.vector() * spread, rot }
    }
    pub fn size(&mut self) -> [f64; 3] {
        self.vector().map(|x| 0.3 + 0.25 * x).into()
    }
}

/// A pose at a place, unturned.
pub fn at(x: f64, y: f64, z: f64) -> Pose<f64> {
    Pose { pos: Vector3::new(x, y, z), rot: Matrix3::identity() }
}

/// A shape that is given by its size alone.
pub fn bare<'a, R: Real>(pose: &'a Pose<R>, size: &'a [R::Value; 3]) -> Shape<'a, R> {
    Shape { pose, size, hull: None, field: None }
}

/// Numbers of a model.
pub fn constants<R: Real>(of: &[f64; 3]) -> [R::Value; 3] {
    of.map(|x| R::Value::by_lane(&[x]))
}

/// A pose that moves: by `way` and `turn` for each unit of a parameter.
pub struct Moving {
    pub pose: Pose<f64>,
    pub way: Vector3<f64>,
    pub turn: Vector3<f64>,
}

impl Moving {
    pub fn at(&self, h: f64) -> Pose<f64> {
        let rot = Rotation3::new(self.turn * h).into_inner() * self.pose.rot;
        Pose { pos: self.pose.pos + self.way * h, rot }
    }

    /// At 0, with the parameter's slopes.
    pub fn dual(&self) -> Pose<Dual> {
        let seed = |x: f64, slope: f64| {
            let mut dual = Dual::of(x);
            dual.slopes[0] = slope;
            dual
        };
        let (pose, spin) = (&self.pose, self.turn.cross_matrix() * self.pose.rot);
        Pose {
            pos: Vector3::from_fn(|i, _| seed(pose.pos[i], self.way[i])),
            rot: Matrix3::from_fn(|i, k| seed(pose.rot[(i, k)], spin[(i, k)])),
        }
    }
}

/// A pose that does not move.
pub fn still(pose: &Pose<f64>) -> Pose<Dual> {
    Pose { pos: pose.pos.map(Dual::of), rot: pose.rot.map(Dual::of) }
}

/// The features on both sides of 0 equal the ones at 0.
pub fn same_features(slopes: &[Touch<Dual>], sides: [&[Touch<f64>]; 2]) -> bool {
    let own = || slopes.iter().map(|touch| touch.feature.value);
    sides.iter().all(|side| side.iter().map(|touch| touch.feature).eq(own()))
}

/// Slopes equal the differences between −h and h.
pub fn assert_slopes(slopes: &[Touch<Dual>], sides: [&[Touch<f64>]; 2], h: f64, tolerance: f64) {
    for (k, touch) in slopes.iter().enumerate() {
        let [lo, hi] = sides.map(|side| &side[k]);
        let close = |slope: f64, lo: f64, hi: f64| {
            let difference = (hi - lo) / (2.0 * h);
            let off = (slope - difference).abs();
            assert!(off < tolerance * (1.0 + difference.abs()), "{slope} {difference} {touch:?}");
        };
        close(touch.dist.slopes[0], lo.dist, hi.dist);
        for i in 0..3 {
            close(touch.pos[i].slopes[0], lo.pos[i], hi.pos[i]);
            close(touch.normal[i].slopes[0], lo.normal[i], hi.normal[i]);
        }
    }
}
