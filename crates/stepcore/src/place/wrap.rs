//! The shortest path from one point to another round a sphere or an infinite cylinder.
//!
//! In the plane of the circle, with the points a and b at distances A, B ≥ r from its centre and
//! φ the angle from a to b, the way touches the circle where φ > α₁ + α₂, cos α₁ = r/A,
//! cos α₂ = r/B; then it is √(A² − r²) + r (φ − α₁ − α₂) + √(B² − r²) long. Without a side, φ is
//! the smaller angle; with a side point s it is the angle of the way a → s → b, which may be more
//! than half a turn: the path keeps the way round on which s lies (MuJoCo 4, `sidesite`). Round a
//! sphere the plane contains both points and the centre; on a cylinder the path is a straight line of
//! the unrolled surface, so that it rises in proportion to its way in the plane.
//!
//! If s lies within r of the centre the path goes *through* the geom. It passes the disc, and if the
//! straight line misses the disc, it bends at the point t of the circle with the least
//! |a − t| + |t − b|.
//!
//! For points on the surface, rounding decides on which side they are. So that it decides as in MuJoCo,
//! the same numbers are compared: |s|, A and B with r, and A² and B² with r² for a way round.

use crate::real::{Mask, Real};
use crate::spatial::{Pose, V3};

/// The points at which a path touches, first and second, in the world, and its length between them.
pub struct Wrap<R: Real> {
    /// Lanes in which it touches at all.
    pub touches: R::Mask,
    pub points: [V3<R>; 2],
    pub length: R,
}

/// The geom that a path goes round.
pub struct Obstacle<'a, R: Real> {
    pub pose: &'a Pose<R>,
    pub sphere: bool,
    pub radius: R,
    pub side: Option<V3<R>>,
}

/// A vector of the plane of the circle.
type Flat<R> = [R; 2];

fn dot<R: Real>(a: Flat<R>, b: Flat<R>) -> R {
    a[0] * b[0] + a[1] * b[1]
}

fn cross<R: Real>(a: Flat<R>, b: Flat<R>) -> R {
    a[0] * b[1] - a[1] * b[0]
}

/// Returns the angle from a to b, counter-clockwise.
fn angle<R: Real>(a: Flat<R>, b: Flat<R>) -> R {
    cross(a, b).atan2(dot(a, b))
}

/// Two points of the circle, and the way along it from one to the other.
struct Touch<R: Real> {
    mask: R::Mask,
    points: [Flat<R>; 2],
    arc: R,
}

pub fn wrap<R: Real>(ends: [V3<R>; 2], obstacle: &Obstacle<R>) -> Wrap<R> {
    let &Obstacle { pose, sphere, radius, side } = obstacle;
    let local = |p: V3<R>| pose.to_local(&(p - pose.pos));
    let [p, q] = ends.map(local);
    let axes = if sphere { plane_of(&p, &q) } else { [V3::x(), V3::y()] };
    let flat = |v: &V3<R>| [axes[0].dot(v), axes[1].dot(v)];
    let (a, b) = (flat(&p), flat(&q));
    let none = || Wrap { touches: R::Mask::of(false), points: [V3::zeros(); 2], length: R::zero() };
    let past = side.map(local).map(|s| (s.dot(&s).sqrt().lt(radius), flat(&s)));
    let mut clear = misses(a, b, radius);
    if let Some((within, s)) = past {
        clear = clear.and(within.not()).and(on_short_way(a, s, b));
    }
    if clear.all() {
        return none();
    }
    let touch = match past {
        None => outside(a, b, angle(a, b), radius),
        Some((within, s)) => {
            let around = outside(a, b, angle(a, s) + angle(s, b), radius);
            if within.none() {
                around
            } else {
                choose(within, &inside(a, b, radius), &around)
            }
        }
    };
    let touches = touch.mask.and(clear.not());
    if touches.none() {
        return none();
    }
    let [mut first, mut second] = touch.points.map(|[x, y]| axes[0] * x + axes[1] * y);
    let mut length = touch.arc;
    if !sphere {
        let way = |from: Flat<R>, to: Flat<R>| {
            let apart = [to[0] - from[0], to[1] - from[1]];
            dot(apart, apart).sqrt()
        };
        let before = way(a, touch.points[0]);
        let all = before + touch.arc + way(touch.points[1], b);
        let slope = (q.z - p.z) * all.recip_or_zero();
        first.z = p.z + slope * before;
        second.z = p.z + slope * (before + touch.arc);
        let rise = slope * touch.arc;
        length = (touch.arc * touch.arc + rise * rise).sqrt();
    }
    let points = [first, second].map(|v| pose.pos + pose.to_world(&v));
    Wrap { touches, points, length }
}

/// Margin, as a part of r², by which a squared distance is certainly larger than r².
const CLEAR: f64 = 1e-4;

/// Checks that the straight line clearly misses the circle: it needs no angles.
fn misses<R: Real>(a: Flat<R>, b: Flat<R>, radius: R) -> R::Mask {
    let apart = [b[0] - a[0], b[1] - a[1]];
    let share = -dot(apart, a) * dot(apart, apart).recip_or_zero();
    let share = share.max(R::zero()).min(R::one());
    let near = [a[0] + share * apart[0], a[1] + share * apart[1]];
    dot(near, near).gt(R::of(1.0 + CLEAR) * radius * radius)
}

/// Checks that the way a → s → b is certainly no more than half a turn.
fn on_short_way<R: Real>(a: Flat<R>, s: Flat<R>, b: Flat<R>) -> R::Mask {
    let [first, second, whole] = [cross(a, s), cross(s, b), cross(a, b)];
    let zero = R::zero();
    let back = (first * second).lt(zero);
    back.or((first * whole).gt(zero).and((second * whole).gt(zero)))
}

fn choose<R: Real>(mask: R::Mask, yes: &Touch<R>, no: &Touch<R>) -> Touch<R> {
    let number = |y: R, n: R| R::select(mask, y, n);
    let point = |k: usize| {
        [number(yes.points[k][0], no.points[k][0]), number(yes.points[k][1], no.points[k][1])]
    };
    Touch {
        mask: yes.mask.and(mask).or(no.mask.and(mask.not())),
        points: [point(0), point(1)],
        arc: number(yes.arc, no.arc),
    }
}

/// Returns axes of the plane through the centre and two points; the first is along p. If both points
/// are on one line with the centre, any plane through them is as good: MuJoCo's is used.
fn plane_of<R: Real>(p: &V3<R>, q: &V3<R>) -> [V3<R>; 2] {
    let (zero, one) = (R::zero(), R::one());
    let along = *p * p.dot(p).sqrt().recip_or_zero();
    let across = p.cross(q);
    let square = across.dot(&across);
    let least = R::of(R::epsilon() * R::epsilon()) * p.dot(p) * q.dot(q);
    let [x, y, z] = [along.x.abs(), along.y.abs(), along.z.abs()];
    let (second, third) = (y.gt(x).and(y.gt(z)), z.gt(x).and(z.gt(y)));
    let first = second.or(third).not();
    let but = |largest: R::Mask| R::select(largest, zero, one);
    let other = along.cross(&V3::new(but(first), but(second), but(third)));
    let pick = square.gt(least);
    let normal = V3::from_fn(|k, _| R::select(pick, across[k], other[k]));
    let unit = |v: V3<R>| v * v.dot(&v).sqrt().recip_or_zero();
    [along, unit(unit(normal).cross(&along))]
}

/// Squared distance, over the squared radius, below which two points count as one.
const SAME_POINT: f64 = 1e-15;

/// Returns the path round the circle by the signed angle `turn` from a to b.
fn outside<R: Real>(a: Flat<R>, b: Flat<R>, turn: R, radius: R) -> Touch<R> {
    let zero = R::zero();
    let square = radius * radius;
    let (aa, bb) = (dot(a, a), dot(b, b));
    let (left, right) = ((aa - square).max(zero).sqrt(), (bb - square).max(zero).sqrt());
    let sign = R::select(turn.lt(zero), -R::one(), R::one());
    let angle = turn * sign - left.atan2(radius) - right.atan2(radius);
    // For coincident points the angle may be a whole turn by rounding.
    let apart = [b[0] - a[0], b[1] - a[1]];
    let two = dot(apart, apart).gt(R::of(SAME_POINT) * square);
    let mask = aa.ge(square).and(bb.ge(square)).and(two).and(angle.gt(zero));
    if mask.none() {
        return Touch { mask, points: [a, b], arc: zero };
    }
    // r/A of the way from the centre, turned by ±α: cos α = r/A, sin α = l/A.
    let tangent = |v: Flat<R>, vv: R, l: R, sign: R| {
        let k = radius * vv.recip_or_zero();
        [k * (radius * v[0] - sign * l * v[1]), k * (radius * v[1] + sign * l * v[0])]
    };
    let points = [tangent(a, aa, left, sign), tangent(b, bb, right, -sign)];
    Touch { mask, points, arc: R::select(mask, radius * angle, zero) }
}

/// Largest number of steps of the search for a bend, which bisects if Newton's step leaves the bracket.
const STEPS: usize = 100;

/// Returns the path through the circle: its point with the shortest way from a to b.
fn inside<R: Real>(a: Flat<R>, b: Flat<R>, radius: R) -> Touch<R> {
    let (zero, one) = (R::zero(), R::one());
    let far = [a, b].map(|v| dot(v, v).sqrt());
    // The point of the straight line that is nearest to the centre.
    let apart = [b[0] - a[0], b[1] - a[1]];
    let share = -dot(apart, a) * dot(apart, apart).recip_or_zero();
    let near = [a[0] + share * apart[0], a[1] + share * apart[1]];
    let within = share.gt(zero).and(share.lt(one));
    let crosses = within.and(dot(near, near).sqrt().le(radius));
    let mask = far[0].gt(radius).and(far[1].gt(radius)).and(crosses.not());
    let turn = angle(a, b);
    let sign = R::select(turn.lt(zero), -one, one);
    let bend = Bend { far, radius, whole: turn * sign };
    let at = if mask.any() { bend.solve(mask) } else { zero };
    let (sin, cos) = at.sin_cos();
    let (k, sin) = (radius * bend.far[0].recip_or_zero(), sin * sign);
    let point = [k * (cos * a[0] - sin * a[1]), k * (cos * a[1] + sin * a[0])];
    Touch { mask, points: [point, point], arc: zero }
}

/// The bend of a path through a circle: at the angle x from its first end, with
/// f(x) = A sin x / |a − t| − B sin(φ − x) / |b − t| = 0, which is the slope of the way over r.
struct Bend<R: Real> {
    /// A and B, and φ ≥ 0.
    far: [R; 2],
    radius: R,
    whole: R,
}

impl<R: Real> Bend<R> {
    /// Returns A sin x / |a − t|, and its slope.
    fn part(&self, far: R, x: R) -> [R; 2] {
        let (sin, cos) = x.sin_cos();
        let (across, r) = (far * sin, self.radius);
        let apart = (far * far + r * r - R::of(2.0) * far * r * cos).sqrt();
        let inverse = apart.recip_or_zero();
        let rate = across * inverse;
        [rate, (far * cos - r * rate * rate) * inverse]
    }

    /// Returns f and its slope.
    fn miss(&self, x: R) -> [R; 2] {
        let ([one, up], [two, down]) =
            (self.part(self.far[0], x), self.part(self.far[1], self.whole - x));
        [one - two, up + down]
    }

    fn newton(&self, x: R) -> R {
        let [miss, slope] = self.miss(x);
        x - miss * slope.recip_or_zero()
    }

    /// Finds the root of f, which grows along the arc that both a and b see, and changes sign there.
    fn solve(&self, mask: R::Mask) -> R {
        let (zero, half) = (R::zero(), R::of(0.5));
        let sees = |far: R| {
            let r = self.radius;
            (far * far - r * r).max(zero).sqrt().atan2(r)
        };
        let mut low = (self.whole - sees(self.far[1])).max(zero);
        let mut high = sees(self.far[0]).min(self.whole);
        let mut x = half * (low + high);
        let mut open = mask;
        let small = R::of(2.0 * R::epsilon()) * self.whole;
        for _ in 0..STEPS {
            let [miss, slope] = self.miss(x);
            let above = miss.gt(zero);
            high = R::select(open.and(above), x, high);
            low = R::select(open.and(above.not()), x, low);
            let guess = x - miss * slope.recip_or_zero();
            let kept = guess.ge(low).and(guess.le(high)).and(slope.gt(zero));
            let next = R::select(kept, guess, half * (low + high));
            let done = (next - x).abs().le(small);
            x = R::select(open, next, x);
            open = open.and(done.not());
            if open.none() {
                break;
            }
        }
        let [x] = R::implicit([x], |[x]| [self.newton(x)]);
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::real::Dual;
    use std::f64::consts::PI;

    fn round<R: Real>(ends: [V3<f64>; 2], sphere: bool, side: Option<V3<f64>>) -> R {
        let vector = |v: V3<f64>| v.map(R::of);
        let pose = Pose { pos: V3::zeros(), rot: crate::spatial::M3::identity() };
        let side = side.map(vector);
        let obstacle = Obstacle { pose: &pose, sphere, radius: R::of(0.5), side };
        let ends = ends.map(vector);
        let found = wrap(ends, &obstacle);
        let way = |a: V3<R>, b: V3<R>| (b - a).dot(&(b - a)).sqrt();
        let [one, two] = found.points;
        let wrapped = way(ends[0], one) + found.length + way(two, ends[1]);
        R::select(found.touches, wrapped, way(ends[0], ends[1]))
    }

    fn at(radius: f64, angle: f64, z: f64) -> V3<f64> {
        V3::new(radius * angle.cos(), radius * angle.sin(), z)
    }

    /// Half a turn from tangent to tangent, a turn and a half past a side, a helix, no touch.
    #[test]
    fn closed_forms() {
        let [down, up] = [V3::new(0.5, -1.0, 0.0), V3::new(-0.5, -1.0, 0.0)];
        let half: f64 = round([down, up], false, Some(V3::new(0.0, 2.0, 0.0)));
        assert!((half - (2.0 + 0.5 * PI)).abs() < 1e-14);
        let short: f64 = round([down, up], false, None);
        assert!((short - 1.0).abs() < 1e-15, "below the drum the line is straight");
        let ball: f64 = round([down, up], true, Some(V3::new(0.0, 2.0, 0.3)));
        assert!((ball - half).abs() < 1e-14);
        let rise = V3::new(-0.5, -1.0, 0.7);
        let helix: f64 = round([down, rise], false, Some(V3::new(0.0, 2.0, 0.0)));
        assert!((helix - half.hypot(0.7)).abs() < 1e-14);
        let (turn, reach) = (0.9, (0.5f64 / 2.0).acos());
        let wide = [at(2.0, -turn, 0.0), at(2.0, turn, 0.0)];
        let far: f64 = round(wide, false, Some(V3::new(-1.0, 0.0, 0.0)));
        let arc = 2.0 * PI - 2.0 * turn - 2.0 * reach;
        assert!((far - (2.0 * 3.75f64.sqrt() + 0.5 * arc)).abs() < 1e-14);
    }

    /// Through the disc: a path that bends at the point of the circle that makes it shortest.
    #[test]
    fn a_bend_is_the_shortest() {
        for (one, two) in [(0.4, 1.1), (0.2, 0.3), (1.2, 0.1)] {
            let ends = [at(1.3, one, 0.0), at(0.9, -two, 0.0)];
            for sphere in [true, false] {
                let found: f64 = round(ends, sphere, Some(V3::new(0.1, 0.0, 0.0)));
                let way = |angle: f64| {
                    let bend = at(0.5, angle, 0.0);
                    (ends[0] - bend).norm() + (bend - ends[1]).norm()
                };
                let least = (0..=4000).map(|k| way(-1.3 + k as f64 * 6.5e-4)).fold(9.0, f64::min);
                let straight = (ends[0] - ends[1]).norm();
                assert!(found <= least + 1e-12 && found >= straight - 1e-15);
                assert!(
                    found > least - 1e-6 || (found - straight).abs() < 1e-15,
                    "{found} {least}"
                );
            }
        }
    }

    /// The slopes of dual numbers are differences of lengths, also if an iteration found the bend.
    #[test]
    fn dual_numbers_follow() {
        let sides = [None, Some(V3::new(0.0, 2.0, 0.0)), Some(V3::new(0.1, 0.0, 0.0))];
        for side in sides {
            let length =
                |y: f64| -> f64 { round([at(0.8, 0.3, 0.1), V3::new(0.7, y, -0.2)], false, side) };
            let pose = Pose { pos: V3::zeros(), rot: crate::spatial::M3::identity() };
            let number = |v: V3<f64>| v.map(Dual::of);
            let mut end = number(V3::new(0.7, -0.6, -0.2));
            end.y.slopes[0] = 1.0;
            let start = number(at(0.8, 0.3, 0.1));
            let obstacle = Obstacle {
                pose: &pose,
                sphere: false,
                radius: Dual::of(0.5),
                side: side.map(number),
            };
            let found = wrap([start, end], &obstacle);
            let way = |a: V3<Dual>, b: V3<Dual>| (b - a).dot(&(b - a)).sqrt();
            let [one, two] = found.points;
            let wrapped = way(start, one) + found.length + way(two, end);
            let got = if found.touches { wrapped } else { way(start, end) };
            let h = 1e-6;
            let want = (length(-0.6 + h) - length(-0.6 - h)) / (2.0 * h);
            assert!((got.slopes[0] - want).abs() < 1e-8, "{side:?}: {} {want}", got.slopes[0]);
        }
    }
}
