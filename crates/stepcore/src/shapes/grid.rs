//! Points on a grid of integers, and exact tests of their side of a plane.

/// Coordinates of at most 2³⁹.
pub(super) type Point = [i64; 3];

/// Steps of the grid that rounding can produce: points nearer to a plane than this lie in it.
pub(super) const NOISE: f64 = 4.0;

/// Coordinates reach from −2^BITS to 2^BITS.
const BITS: i32 = 39;

/// The position of the grid: the centre of the points' box, and the steps per metre (a power of two, so
/// that scaling the points by one changes nothing here).
pub(super) struct Grid {
    centre: [f64; 3],
    pub steps: f64,
    /// Half of the largest extent [m].
    pub half: f64,
}

impl Grid {
    /// Creates the grid; None if the points have no finite nonzero extent.
    pub fn around(points: &[[f64; 3]]) -> Option<Self> {
        let bound = |axis: usize, pick: fn(f64, f64) -> f64| {
            points.iter().map(|p| p[axis]).reduce(pick).unwrap_or(0.0)
        };
        let low: [f64; 3] = crate::real::array::from_fn(|k| bound(k, f64::min));
        let high: [f64; 3] = crate::real::array::from_fn(|k| bound(k, f64::max));
        let half = (0..3).map(|k| 0.5 * high[k] - 0.5 * low[k]).fold(0.0, f64::max);
        if !half.is_normal() {
            return None;
        }
        // The power of two above `half`, from its exponent; it must not be subnormal or infinite.
        let exponent = (half.to_bits() >> 52) as i32 - 1022;
        let steps = 2.0_f64.powi(BITS - exponent);
        let centre = crate::real::array::from_fn(|k| 0.5 * low[k] + 0.5 * high[k]);
        (steps.is_normal() && half < 1e300).then_some(Self { centre, steps, half })
    }

    pub fn point(&self, p: &[f64; 3]) -> Point {
        crate::real::array::from_fn(|k| ((p[k] - self.centre[k]) * self.steps).round() as i64)
    }
}

/// A plane through three points, and its normal: |normal| is twice the area of their triangle.
pub(super) struct Plane {
    origin: Point,
    /// Components are below 2⁸².
    normal: [i128; 3],
    /// The same, rounded.
    rounded: [f64; 3],
}

/// Rounding of a sum of three products, relative to the sum of their magnitudes: three roundings of
/// 2⁻⁵³ each for the normal, the product and two sums.
const ROUNDING: f64 = 8.0 * f64::EPSILON;

impl Plane {
    /// Creates the plane, counter-clockwise from above.
    pub fn through(a: &Point, b: &Point, c: &Point) -> Self {
        let wide = |p: &Point, k: usize| i128::from(p[k] - a[k]);
        let minor = |i: usize, j: usize| wide(b, i) * wide(c, j) - wide(b, j) * wide(c, i);
        let normal = [minor(1, 2), minor(2, 0), minor(0, 1)];
        Self { origin: *a, normal, rounded: normal.map(|x| x as f64) }
    }

    pub fn distance_between(a: &Point, b: &Point) -> f64 {
        (0..3).map(|k| (b[k] - a[k]) as f64).map(|x| x * x).sum::<f64>().sqrt()
    }

    /// Returns the length of the normal.
    pub fn length(&self) -> f64 {
        self.rounded.iter().map(|x| x * x).sum::<f64>().sqrt()
    }

    /// Returns normal · (point − origin), rounded, and the sum of the magnitudes of its three products.
    fn product(&self, point: &Point) -> (f64, f64) {
        let term = |k: usize| self.rounded[k] * (point[k] - self.origin[k]) as f64;
        let (x, y, z) = (term(0), term(1), term(2));
        (x + y + z, x.abs() + y.abs() + z.abs())
    }

    /// Returns distance above the plane × length of the normal, rounded.
    pub fn height(&self, point: &Point) -> f64 {
        self.product(point).0
    }

    /// Returns the distance above the plane, in steps of the grid.
    pub fn distance(&self, point: &Point) -> f64 {
        self.height(point) / self.length()
    }

    /// Checks that a point is strictly above, exactly: products stay below 2¹²², sums below 2¹²⁴.
    pub fn above(&self, point: &Point) -> bool {
        let (sum, size) = self.product(point);
        if sum.abs() > ROUNDING * size {
            return sum > 0.0;
        }
        let term = |k: usize| self.normal[k] * i128::from(point[k] - self.origin[k]);
        term(0) + term(1) + term(2) > 0
    }

    /// Checks that a point is above by more than the grid's rounding.
    pub fn beyond_noise(&self, point: &Point) -> bool {
        let sum = self.product(point).0;
        sum > 0.0 && sum > NOISE * self.length() && self.above(point)
    }
}
