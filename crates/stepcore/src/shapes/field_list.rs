//! The contacts of a height field and a shape as they are found, and the choice among them.

use super::by_lane::empty;
use super::height_field::{Prism, MOST};
use super::separation::Separation;
use super::touch::{Touch, Touches};
use crate::real::{Mask, Real};
use crate::spatial::V3;

/// Largest number of contacts at once; if there are more, `KEPT` that are far from each other stay.
const ROOM: usize = 256;
const KEPT: usize = 64;
/// Directions in the field's plane, none of them along a side or a diagonal of its cells.
const AROUND: [(f64, f64); 8] = [
    (0.92, 0.38),
    (0.38, 0.92),
    (-0.38, 0.92),
    (-0.92, 0.38),
    (-0.92, -0.38),
    (-0.38, -0.92),
    (0.38, -0.92),
    (0.92, -0.38),
];

/// Contacts found so far.
pub(super) struct List<R: Real> {
    touches: [Touch<R>; ROOM],
    count: usize,
    /// The field's x and y axes.
    axes: [V3<f64>; 2],
    /// The prism that the shape overlaps most, of the ones whose ways out lead into others, and the
    /// depth of the overlap, negative [m].
    pub sunk: Option<(Prism, f64)>,
}

impl<R: Real> List<R> {
    pub fn new(axes: [V3<f64>; 2]) -> Self {
        Self { touches: [empty(); ROOM], count: 0, axes, sunk: None }
    }

    /// Drops a prism whose way out leads into another one.
    pub fn drop_way(&mut self, prism: &Prism, way: &Separation, radius: f64) {
        let apart = way.apart - radius;
        if apart < self.sunk.as_ref().map_or(0.0, |sunk| sunk.1) {
            self.sunk = Some((*prism, apart));
        }
    }

    /// Adds the `wanted` contacts of a prism, and includes the prism in their names.
    pub fn add_all(
        &mut self,
        prism: &Prism,
        touches: &[Touch<R>],
        same: f64,
        wanted: impl Fn(&Touch<R>) -> bool,
    ) {
        for touch in touches.iter().filter(|touch| touch.exists.any() && wanted(touch)) {
            let name =
                touch.feature.lane(0) as u32 ^ (prism.number as u32).wrapping_mul(0x9E37_79B1);
            let feature = R::of(f64::from(name & 0x00FF_FFFF));
            self.add(Touch { feature, ..*touch }, same);
        }
    }

    fn add(&mut self, touch: Touch<R>, same: f64) {
        if self.count == ROOM {
            self.thin(same);
        }
        self.touches[self.count] = touch;
        self.count += 1;
    }

    /// Returns the least distance [m]; infinite without contacts.
    pub fn least(&self) -> f64 {
        let all = self.touches[..self.count].iter();
        all.fold(f64::INFINITY, |least, touch| least.min(touch.dist.lane(0)))
    }

    /// Makes room: `KEPT` of the contacts stay.
    fn thin(&mut self, same: f64) {
        let picked = self.spread(KEPT, same);
        let mut kept = 0;
        for i in 0..self.count {
            if picked[i] {
                self.touches[kept] = self.touches[i];
                kept += 1;
            }
        }
        self.count = kept;
    }

    /// Returns `MOST` of them: see the top of `height_field.rs`.
    pub fn chosen(&self, same: f64) -> Touches<R, MOST> {
        let mut out = [empty(); MOST];
        let picked = self.spread(MOST, same);
        let listed = self.touches[..self.count].iter().zip(picked).filter(|(_, picked)| *picked);
        for (to, (touch, _)) in out.iter_mut().zip(listed) {
            *to = *touch;
        }
        out
    }

    /// Returns the choice of at most `most` contacts.
    fn spread(&self, most: usize, same: f64) -> [bool; ROOM] {
        let all = &self.touches[..self.count];
        let mut picked = [false; ROOM];
        let depth = |i: usize| all[i].dist.lane(0);
        let Some(deepest) = (0..all.len()).min_by(|i, j| depth(*i).total_cmp(&depth(*j))) else {
            return picked;
        };
        let mut nearest = [f64::INFINITY; ROOM];
        let mut pick = |next: usize, nearest: &mut [f64; ROOM]| {
            picked[next] = true;
            for (i, touch) in all.iter().enumerate() {
                let way = touch.pos - all[next].pos;
                nearest[i] = nearest[i].min(way.dot(&way).lane(0));
            }
        };
        let mut kept = 0;
        for (x, y) in AROUND {
            let way = self.axes[0] * x + self.axes[1] * y;
            let out = |i: usize| way.dot(&all[i].pos.map(|x| x.lane(0)));
            let next = (1..all.len()).fold(0, |far, i| if out(i) > out(far) { i } else { far });
            if nearest[next] > same * same {
                pick(next, &mut nearest);
                kept += 1;
            }
        }
        while kept < most {
            let far = |best: usize, i: usize| if nearest[i] > nearest[best] { i } else { best };
            // The last place goes to the deepest contact, if it has not been chosen yet.
            let missing = kept + 1 == most && nearest[deepest] > same * same;
            let next = if missing { deepest } else { (1..all.len()).fold(0, far) };
            if nearest[next] <= same * same {
                break;
            }
            pick(next, &mut nearest);
            kept += 1;
        }
        picked
    }
}
