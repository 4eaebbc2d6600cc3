//! The contact parameters of two geoms: mixed from both, given by an explicit pair, or overridden
//! for all. MuJoCo documentation, "Contact parameters" and "Contact override".

use crate::real::{Constant, Real, Value};
use crate::scene::{ExplicitPair, Geom, Scene, Softness};

/// One for all pairs that mix to the same.
#[derive(Clone, Debug, PartialEq)]
pub struct Material<N = f64> {
    /// 1: no friction; 3: sliding; 4: and torsion; 6: and rolling.
    pub condim: u32,
    /// Coefficients of sliding along both tangents [1], torsion [m], rolling about both [m].
    pub friction: [N; 5],
    /// A contact has a row below `margin`, and is listed below `margin + gap` [m].
    pub margin: N,
    pub gap: N,
    pub soft: Softness<N>,
    /// The solref of friction rows of a cone. None: the one of `soft`.
    pub solreffriction: Option<[N; 2]>,
    /// The largest pulling force of a contact [N].
    pub adhesion: N,
}

impl<N: Constant> Material<N> {
    /// The distance below which contacts are listed [m].
    #[inline(always)]
    pub fn listed<R: Real>(&self) -> R
    where
        N: Value<R>,
    {
        N::calc([&self.margin, &self.gap], |[margin, gap]| margin + gap)
    }

    /// The same for one lane.
    pub fn listed_in(&self, lane: usize) -> f64 {
        self.margin.lane(lane) + self.gap.lane(lane)
    }
}

impl Material {
    /// The material of two geoms of a scene that no explicit pair names.
    pub fn of_geoms(scene: &Scene, a: usize, b: usize) -> Self {
        Self::mixed(&scene.geoms[a], &scene.geoms[b]).overridden(scene)
    }

    /// The geom of higher priority decides; equals are mixed: the larger condim and friction,
    /// softness by the share of solmix, and adhesion as the sum. Margins and gaps are distances,
    /// and add up.
    fn mixed(x: &Geom, y: &Geom) -> Self {
        let (margin, gap) = (x.margin + y.margin, x.gap + y.gap);
        let of = |condim, friction, soft, adhesion| Self {
            condim,
            friction: by_direction(friction),
            margin,
            gap,
            soft,
            solreffriction: None,
            adhesion,
        };
        if x.priority != y.priority {
            let g = if x.priority > y.priority { x } else { y };
            return of(g.condim, g.friction, g.soft.clone(), g.adhesion);
        }
        let larger = crate::real::array::from_fn(|i| f64::max(x.friction[i], y.friction[i]));
        of(x.condim.max(y.condim), larger, mixed_softness(x, y), x.adhesion + y.adhesion)
    }

    /// The material of an explicit pair: the parameters of its geoms do not count.
    pub fn of_pair(scene: &Scene, pair: &ExplicitPair) -> Self {
        let of = Self {
            condim: pair.condim,
            friction: pair.friction,
            margin: pair.margin,
            gap: pair.gap,
            soft: pair.soft.clone(),
            solreffriction: pair.solreffriction,
            adhesion: pair.adhesion,
        };
        of.overridden(scene)
    }

    /// Applies the parameters that override every contact's: all but condim, gap, adhesion.
    fn overridden(self, scene: &Scene) -> Self {
        let Some(by) = &scene.contact_override else { return self };
        let (margin, friction, soft) = (by.margin, by.friction, by.soft.clone());
        Self { margin, friction, soft, solreffriction: None, ..self }
    }
}

fn mixed_softness(x: &Geom, y: &Geom) -> Softness {
    let share = match (x.solmix > 0.0, y.solmix > 0.0) {
        (true, true) => x.solmix / (x.solmix + y.solmix),
        (false, false) => 0.5,
        (one, _) => f64::from(u8::from(one)),
    };
    let blend = |p: f64, q: f64| share * p + (1.0 - share) * q;
    let (p, q) = (&x.soft, &y.soft);
    // Stiffness and damping given directly are negative: the stiffer one counts.
    let direct = p.solref[0] <= 0.0 || q.solref[0] <= 0.0;
    let solref = crate::real::array::from_fn(|i| {
        let (p, q) = (p.solref[i], q.solref[i]);
        if direct {
            p.min(q)
        } else {
            blend(p, q)
        }
    });
    Softness { solref, solimp: crate::real::array::from_fn(|i| blend(p.solimp[i], q.solimp[i])) }
}

/// Sliding, torsional and rolling friction by direction.
fn by_direction([slide, torsion, roll]: [f64; 3]) -> [f64; 5] {
    [slide, slide, torsion, roll, roll]
}
