//! Vectors, rotations and spatial algebra over `Real`.
//!
//! A spatial motion is (angular velocity, velocity of the body point at the
//! origin); a spatial force is (moment about the origin, force). Featherstone,
//! Rigid Body Dynamics Algorithms (2008), chapter 2. The origin is a point of the
//! tree, so that numbers stay small far away from the world's origin.

use crate::real::array::{from_fn, map};
use crate::real::{value, Real, Value};
use nalgebra::{Matrix3, Vector3};

pub type V3<R> = Vector3<R>;
pub type M3<R> = Matrix3<R>;

/// Returns the same constant vector in every lane.
#[inline(always)]
pub fn splat<R: Real, N: Value<R>>(v: &Vector3<N>) -> V3<R> {
    V3::new(v.x.get(), v.y.get(), v.z.get())
}

/// from ← from − a x for rows of a factorisation: short, and each the next one's x soon after.
///
/// One number at a time: a vector load of numbers that were just stored one by one waits for all of
/// them, and rows are too short to make up for it (measured: the factors of 7 to 18 dofs take a
/// fifth to a third less time this way). The hint keeps a compiler from vectorising.
#[inline(always)]
pub(crate) fn subtract_scaled<R: Real>(from: &mut [R], a: R, x: &[R]) {
    for (from, x) in from.iter_mut().zip(x) {
        *from -= a * *x;
        std::hint::black_box(());
    }
}

/// Numbers that are computed side by side.
pub(crate) const WIDE: usize = 4;

/// own −= Σ by · l over N rows, one after another: `WIDE` numbers at a time, which stay in registers.
#[inline(always)]
pub(crate) fn subtract_all<R: Real, const N: usize>(own: &mut [R], rows: [(R, &[R]); N]) {
    let len = own.len();
    let rows = map(rows, |(by, l)| (by, &l[..len]));
    let whole = len - len % WIDE;
    let mut at = 0;
    while at < whole {
        let part = &mut own[at..at + WIDE];
        let mut x: [R; WIDE] = from_fn(|k| part[k]);
        for (by, l) in rows {
            let l = &l[at..at + WIDE];
            for k in 0..WIDE {
                x[k] -= by * l[k];
            }
        }
        part.copy_from_slice(&x);
        at += WIDE;
    }
    for at in whole..len {
        for (by, l) in rows {
            own[at] -= by * l[at];
        }
    }
}

/// The axis (x, y or z) and the sign of a unit vector along an axis.
#[inline(always)]
pub fn principal(unit: &Vector3<f64>) -> Option<(usize, f64)> {
    match [unit.x, unit.y, unit.z] {
        [x, 0.0, 0.0] => Some((0, x)),
        [0.0, y, 0.0] => Some((1, y)),
        [0.0, 0.0, z] => Some((2, z)),
        _ => None,
    }
}

/// m · v, written out so that every number type sums in one order.
#[inline(always)]
pub fn rotate<R: Real>(m: &M3<R>, v: &V3<R>) -> V3<R> {
    V3::new(
        m.m11 * v.x + m.m12 * v.y + m.m13 * v.z,
        m.m21 * v.x + m.m22 * v.y + m.m23 * v.z,
        m.m31 * v.x + m.m32 * v.y + m.m33 * v.z,
    )
}

/// mᵀ · v.
#[inline(always)]
pub fn rotate_back<R: Real>(m: &M3<R>, v: &V3<R>) -> V3<R> {
    V3::new(
        m.m11 * v.x + m.m21 * v.y + m.m31 * v.z,
        m.m12 * v.x + m.m22 * v.y + m.m32 * v.z,
        m.m13 * v.x + m.m23 * v.y + m.m33 * v.z,
    )
}

/// Square of an angle below which an axis is not used for derivatives.
const NO_TURN: f64 = 1e-200;

/// A rotation as a unit quaternion, w x y z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quat<R: Real> {
    pub w: R,
    pub v: V3<R>,
}

impl<R: Real> Quat<R> {
    #[inline(always)]
    pub fn identity() -> Self {
        Self { w: R::one(), v: V3::zeros() }
    }
    pub fn splat<N: Value<R>>(q: &[N; 4]) -> Self {
        Self::of(&value::get(q))
    }
    #[inline(always)]
    pub fn of(q: &[R]) -> Self {
        Self { w: q[0], v: V3::new(q[1], q[2], q[3]) }
    }
    #[inline(always)]
    pub fn store(&self, to: &mut [R]) {
        to[0] = self.w;
        to[1] = self.v.x;
        to[2] = self.v.y;
        to[3] = self.v.z;
    }
    #[inline(always)]
    pub fn mul(&self, o: &Self) -> Self {
        let (a, b) = (self, o);
        Self {
            w: a.w * b.w - a.v.x * b.v.x - a.v.y * b.v.y - a.v.z * b.v.z,
            v: V3::new(
                a.w * b.v.x + a.v.x * b.w + a.v.y * b.v.z - a.v.z * b.v.y,
                a.w * b.v.y - a.v.x * b.v.z + a.v.y * b.w + a.v.z * b.v.x,
                a.w * b.v.z + a.v.x * b.v.y - a.v.y * b.v.x + a.v.z * b.w,
            ),
        }
    }
    #[inline(always)]
    pub fn conjugate(&self) -> Self {
        Self { w: self.w, v: -self.v }
    }
    /// Unit length; the identity where the length is zero.
    #[inline(always)]
    pub fn normalized(&self) -> Self {
        let n = (self.w * self.w + self.v.x * self.v.x + self.v.y * self.v.y + self.v.z * self.v.z)
            .sqrt();
        let some = n.gt(R::zero());
        let k = n.recip_or_zero();
        Self {
            w: R::select(some, self.w * k, R::one()),
            v: V3::new(self.v.x * k, self.v.y * k, self.v.z * k),
        }
    }
    /// Rotation by `angle` about the unit `axis`.
    #[inline(always)]
    pub fn about(axis: &V3<R>, angle: R) -> Self {
        let (s, c) = (angle * R::of(0.5)).sin_cos();
        Self { w: c, v: V3::new(axis.x * s, axis.y * s, axis.z * s) }
    }
    /// This rotation after a rotation by `angle` about the unit `axis`. About x, y or z it takes
    /// half of a product.
    #[inline(always)]
    pub fn turned(&self, axis: &Vector3<f64>, angle: R) -> Self {
        let Some((k, sign)) = principal(axis) else {
            return self.mul(&Self::about(&splat(axis), angle));
        };
        let (s, c) = (angle * R::of(0.5)).sin_cos();
        let s = if sign > 0.0 { s } else { -s };
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        let mut v = V3::zeros();
        v[k] = self.w * s + self.v[k] * c;
        v[i] = self.v[i] * c + self.v[j] * s;
        v[j] = self.v[j] * c - self.v[i] * s;
        Self { w: self.w * c - self.v[k] * s, v }
    }
    /// Rotation by the vector `r`: angle |r| about r.
    #[inline(always)]
    pub fn exp(r: &V3<R>) -> Self {
        let square = r.dot(r);
        let angle = square.sqrt();
        let k = angle.recip_or_zero();
        let q = Self::about(&V3::new(r.x * k, r.y * k, r.z * k), angle);
        // (1 − r²/8, r/2) + …: a zero rotation needs no axis.
        let small = square.lt(R::of(NO_TURN));
        let half = |x: R| R::of(0.5) * x;
        Self {
            w: q.w.with_slopes_of(small, || R::one() - square * R::of(0.125)),
            v: V3::new(
                q.v.x.with_slopes_of(small, || half(r.x)),
                q.v.y.with_slopes_of(small, || half(r.y)),
                q.v.z.with_slopes_of(small, || half(r.z)),
            ),
        }
    }
    /// The rotation vector with angle in (-π, π].
    pub fn log(&self) -> V3<R> {
        let (axis, angle) = self.axis_angle();
        let small = self.v.dot(&self.v).lt(R::of(NO_TURN));
        // Near ±1 the turn is 2 v/w.
        let entry =
            |axis: R, v: R| (axis * angle).with_slopes_of(small, || R::of(2.0) * v / self.w);
        V3::new(entry(axis.x, self.v.x), entry(axis.y, self.v.y), entry(axis.z, self.v.z))
    }
    /// Unit axis and angle in (-π, π]; the axis is zero for the identity.
    pub fn axis_angle(&self) -> (V3<R>, R) {
        let s = self.v.dot(&self.v).sqrt();
        let k = s.recip_or_zero();
        let angle = R::of(2.0) * s.atan2(self.w);
        let pi = R::of(std::f64::consts::PI);
        let angle = R::select(angle.gt(pi), angle - pi - pi, angle);
        (V3::new(self.v.x * k, self.v.y * k, self.v.z * k), angle)
    }
    #[inline(always)]
    pub fn matrix(&self) -> M3<R> {
        let two = R::of(2.0);
        let (w, x, y, z) = (self.w, self.v.x, self.v.y, self.v.z);
        let (xx, yy, zz, ww) = (x * x, y * y, z * z, w * w);
        M3::new(
            ww + xx - yy - zz,
            two * (x * y - w * z),
            two * (x * z + w * y),
            two * (x * y + w * z),
            ww - xx + yy - zz,
            two * (y * z - w * x),
            two * (x * z - w * y),
            two * (y * z + w * x),
            ww - xx - yy + zz,
        )
    }
    #[inline(always)]
    pub fn rotate(&self, v: &V3<R>) -> V3<R> {
        // v + 2 w (q × v) + 2 q × (q × v)
        let two = R::of(2.0);
        let t = self.v.cross(v);
        let t = V3::new(t.x * two, t.y * two, t.z * two);
        let c = self.v.cross(&t);
        V3::new(v.x + self.w * t.x + c.x, v.y + self.w * t.y + c.y, v.z + self.w * t.z + c.z)
    }
}

/// Scale to length one; a quaternion that already has it keeps its bits.
pub(crate) fn unit_quat(q: [f64; 4]) -> [f64; 4] {
    let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
    q.map(|x| x / length)
}

pub(crate) fn rotation(q: [f64; 4]) -> Matrix3<f64> {
    Quat::of(&q).matrix()
}

/// The pose of a shape: its centre and its axes (columns of `rot`), in the world.
#[derive(Clone, Copy, Debug)]
pub struct Pose<R: Real> {
    pub pos: V3<R>,
    pub rot: M3<R>,
}

impl Pose<f64> {
    pub(crate) fn new(pos: Vector3<f64>, quat: [f64; 4]) -> Self {
        Self { pos, rot: rotation(quat) }
    }

    /// Returns the world point of a local one.
    pub(crate) fn point(&self, local: Vector3<f64>) -> Vector3<f64> {
        self.pos + self.rot * local
    }

    /// Returns the world pose of a frame given in this one.
    pub(crate) fn then(&self, local: &Self) -> Self {
        Self { pos: self.point(local.pos), rot: self.rot * local.rot }
    }
}

impl<R: Real> Pose<R> {
    /// Returns one of the shape's axes, in the world.
    #[inline(always)]
    pub fn axis(&self, i: usize) -> V3<R> {
        V3::new(self.rot[(0, i)], self.rot[(1, i)], self.rot[(2, i)])
    }

    /// Returns a world vector along the shape's axes.
    #[inline(always)]
    pub fn to_local(&self, v: &V3<R>) -> V3<R> {
        V3::new(self.axis(0).dot(v), self.axis(1).dot(v), self.axis(2).dot(v))
    }

    /// The inverse of `to_local`.
    #[inline(always)]
    pub fn to_world(&self, v: &V3<R>) -> V3<R> {
        self.axis(0) * v.x + self.axis(1) * v.y + self.axis(2) * v.z
    }
}

/// A spatial motion: angular part, and the velocity of the point at the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion<R: Real> {
    pub ang: V3<R>,
    pub lin: V3<R>,
}

/// A spatial force: moment about the origin, and force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Force<R: Real> {
    pub ang: V3<R>,
    pub lin: V3<R>,
}

impl<R: Real> Motion<R> {
    #[inline(always)]
    pub fn zero() -> Self {
        Self { ang: V3::zeros(), lin: V3::zeros() }
    }
    #[inline(always)]
    pub fn add_scaled(&mut self, m: &Self, k: R) {
        self.ang += V3::new(m.ang.x * k, m.ang.y * k, m.ang.z * k);
        self.lin += V3::new(m.lin.x * k, m.lin.y * k, m.lin.z * k);
    }
    /// Rate of change of the motion `m` carried along by this one: v × m.
    #[inline(always)]
    pub fn cross(&self, m: &Self) -> Self {
        Self { ang: self.ang.cross(&m.ang), lin: self.ang.cross(&m.lin) + self.lin.cross(&m.ang) }
    }
    /// Rate of change of the force `f` carried along by this motion: v ×* f.
    #[inline(always)]
    pub fn cross_force(&self, f: &Force<R>) -> Force<R> {
        Force { ang: self.ang.cross(&f.ang) + self.lin.cross(&f.lin), lin: self.ang.cross(&f.lin) }
    }
    /// Power of the force on this motion.
    #[inline(always)]
    pub fn dot(&self, f: &Force<R>) -> R {
        self.ang.dot(&f.ang) + self.lin.dot(&f.lin)
    }
    /// Velocity of the body point at `r` from the origin.
    #[inline(always)]
    pub fn at(&self, r: &V3<R>) -> V3<R> {
        self.lin + self.ang.cross(r)
    }
    /// The largest possible square of a part of that, without cancellation.
    #[inline(always)]
    pub fn most_at(&self, r: &V3<R>) -> R {
        let turning = self.ang.dot(&self.ang) * r.dot(r);
        turning + self.lin.dot(&self.lin)
    }
}

impl<R: Real> Force<R> {
    #[inline(always)]
    pub fn zero() -> Self {
        Self { ang: V3::zeros(), lin: V3::zeros() }
    }
    #[inline(always)]
    pub fn add(&mut self, f: &Self) {
        self.ang += f.ang;
        self.lin += f.lin;
    }
}

/// Mass, first and second moment of mass about the origin.
#[derive(Clone, Copy, Debug)]
pub struct Inertia<R: Real> {
    pub mass: R,
    /// mass × centre of mass.
    pub h: V3<R>,
    /// xx, yy, zz, xy, xz, yz about the origin.
    pub i: [R; 6],
}

impl<R: Real> Inertia<R> {
    #[inline(always)]
    pub fn zero() -> Self {
        Self { mass: R::zero(), h: V3::zeros(), i: [R::zero(); 6] }
    }
    /// From the inertia about the centre of mass in world axes, centre at `c`.
    #[inline(always)]
    pub fn about_origin(mass: R, c: &V3<R>, i: &M3<R>) -> Self {
        let h = V3::new(c.x * mass, c.y * mass, c.z * mass);
        Self {
            mass,
            h,
            i: [
                i.m11 + h.y * c.y + h.z * c.z,
                i.m22 + h.x * c.x + h.z * c.z,
                i.m33 + h.x * c.x + h.y * c.y,
                i.m12 - h.x * c.y,
                i.m13 - h.x * c.z,
                i.m23 - h.y * c.z,
            ],
        }
    }
    #[inline(always)]
    pub fn add(&mut self, o: &Self) {
        self.mass += o.mass;
        self.h += o.h;
        for k in 0..6 {
            self.i[k] += o.i[k];
        }
    }
    /// Momentum of the motion `v`.
    #[inline(always)]
    pub fn mul(&self, v: &Motion<R>) -> Force<R> {
        let [xx, yy, zz, xy, xz, yz] = self.i;
        let a = &v.ang;
        let turned = V3::new(
            xx * a.x + xy * a.y + xz * a.z,
            xy * a.x + yy * a.y + yz * a.z,
            xz * a.x + yz * a.y + zz * a.z,
        );
        let carried = V3::new(v.lin.x * self.mass, v.lin.y * self.mass, v.lin.z * self.mass);
        Force { ang: turned + self.h.cross(&v.lin), lin: carried - self.h.cross(a) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotation_forms_agree() {
        let q = Quat::<f64>::exp(&V3::new(0.3, -1.2, 0.7));
        let v = V3::new(0.2, 0.5, -0.9);
        assert!((q.rotate(&v) - rotate(&q.matrix(), &v)).norm() < 1e-15);
        assert!((rotate_back(&q.matrix(), &q.rotate(&v)) - v).norm() < 1e-15);
        assert!((q.log() - V3::new(0.3, -1.2, 0.7)).norm() < 1e-15);
    }

    #[test]
    fn power_does_not_depend_on_the_order_of_crossing() {
        // d/dt (m · f) = 0 where both are carried along: (v × m)·f + m·(v ×* f) = 0
        let v = Motion { ang: V3::new(0.1, 0.2, 0.3), lin: V3::new(-0.4, 0.5, 0.6) };
        let m = Motion { ang: V3::new(0.7, -0.8, 0.9), lin: V3::new(1.0, 1.1, -1.2) };
        let f = Force { ang: V3::new(-0.3, 0.1, 0.2), lin: V3::new(0.4, 0.2, 0.5) };
        assert!((v.cross(&m).dot(&f) + m.dot(&v.cross_force(&f))).abs() < 1e-15);
    }
}
