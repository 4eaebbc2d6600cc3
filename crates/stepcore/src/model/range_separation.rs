//! Pairs that the ranges of joints keep apart.
//!
//! Only the joints between their bodies move two geoms against each other. The box of those joints'
//! ranges is halved again and again. If the distance at the middle of a box is larger than the
//! largest motion that the joints can still give either geom, no configuration of that box lets the
//! geoms meet. A hinge that turns by δ moves no point by more than its chord 2 sin(δ/2) times the
//! point's distance from the hinge, which is at most the length of the links between them; a slide
//! moves a point by δ. So the test is sound. It gives up (the pair may meet) after too many boxes.
//!
//! Limits are soft, and a state can be set beyond them: ranges are widened by a tenth at both ends,
//! and while a joint is beyond that all pairs are tested (`Model::guards`). A step's result is the
//! same, to the bit, with and without this test.

use super::proofs::{self, Proof, Question};
use super::{Guard, Model, NONE};
use crate::detect;
use crate::place::Placed;
use crate::real::elementary::sin_cos;
use crate::scene::JointType;
use std::f64::consts::PI;

/// With more joints than this between them, two geoms are assumed to reach each other everywhere.
const JOINTS: usize = 5;
/// Boxes for a pair, and for a whole model.
const BOXES: usize = 200;
const ALL_BOXES: usize = 20_000;
/// A range is widened by this share of its width, at both ends.
const WIDER: f64 = 0.1;
/// A share of the lengths involved that rounding, even in single precision, cannot bridge.
const ROUNDING: f64 = 1e-4;

/// A joint between the two geoms of a pair.
struct Between {
    joint: usize,
    low: f64,
    high: f64,
    limited: bool,
    /// The largest distance of a point of the geom from the anchor; 1 for a slide.
    lever: f64,
    turns: bool,
}

impl Between {
    /// The largest motion of any point by a change of half the width.
    fn moves(&self, width: f64) -> f64 {
        if self.turns {
            2.0 * sin_cos((0.25 * width).min(0.5 * PI)).0 * self.lever
        } else {
            0.5 * width
        }
    }
}

/// Sets `Pair::apart` and `Model::guards`.
pub fn prove(model: &mut Model) {
    let pairs = 0..model.pairs.len();
    let asked: Vec<_> = pairs.filter_map(|pair| Some((pair, between(model, pair)?))).collect();
    if asked.is_empty() {
        return;
    }
    let question = Question::of(model);
    let proof = proofs::recalled(&question).unwrap_or_else(|| {
        let made = proved(model, &asked);
        proofs::keep(question, &made);
        made
    });
    for (pair, apart) in model.pairs.iter_mut().zip(proof.apart) {
        pair.apart = apart;
    }
    model.guards = proof.guards;
}

/// Runs the search for pairs with the joints between them.
fn proved(model: &Model, asked: &[(usize, Vec<Between>)]) -> Proof {
    let mut placed = Placed::<f64>::new(model);
    let mut left = ALL_BOXES;
    let mut proof = Proof { apart: vec![false; model.pairs.len()], guards: vec![] };
    for (index, between) in asked {
        let (index, placed) = (*index, &mut placed);
        let mut boxes = BOXES.min(left);
        let budget = boxes;
        let apart = Search::new(model, placed, index, between).apart(&mut boxes);
        left -= budget - boxes;
        proof.apart[index] = apart;
        for joint in between.iter().filter(|joint| apart && joint.limited) {
            let at = model.joints[joint.joint].qpos;
            let guard = Guard { joint: joint.joint, at, low: joint.low, high: joint.high };
            if !proof.guards.contains(&guard) {
                proof.guards.push(guard);
            }
        }
    }
    proof
}

/// The joints between a pair's geoms; None if one of them reaches everywhere.
fn between(model: &Model, pair: usize) -> Option<Vec<Between>> {
    let pair = &model.pairs[pair];
    let bodies = [model.geoms[pair.geom1].body, model.geoms[pair.geom2].body];
    if bodies.iter().any(|body| model.bodies[*body].carried) {
        return None;
    }
    let mut joints = walk(model, pair.geom1, bodies[1])?;
    joints.extend(walk(model, pair.geom2, bodies[0])?);
    // Two trees without a joint to the world reach each other everywhere.
    let fits = !joints.is_empty() && joints.len() <= JOINTS;
    (fits && joints.iter().any(|joint| joint.limited)).then_some(joints)
}

/// The joints from a geom up to the first body that carries `other` too.
fn walk(model: &Model, geom: usize, other: usize) -> Option<Vec<Between>> {
    let shape = &model.geoms[geom];
    let carries = |mut body: usize, above: usize| loop {
        if body == above {
            return true;
        }
        if body == 0 {
            return false;
        }
        body = model.bodies[body].parent;
    };
    let mut found = vec![];
    let mut body = shape.body;
    // From the current frame to the farthest point of the geom.
    let mut far = shape.pos.norm() + shape.reach;
    while !carries(other, body) {
        for index in model.bodies[body].joints.range().rev() {
            let joint = &model.joints[index];
            if matches!(joint.kind, JointType::Free | JointType::Ball) {
                return None;
            }
            let turns = joint.kind == JointType::Hinge;
            let on = model.features.limit && model.features.constraint;
            let range = joint.range.filter(|_| on);
            let wide = range.map(|[low, high]| {
                let more = WIDER * (high - low);
                [low - more, high + more]
            });
            let round = [joint.reference - PI, joint.reference + PI];
            let full = turns && wide.is_none_or(|[low, high]| high - low >= 2.0 * PI);
            let [low, high] = if full { round } else { wide? };
            let anchor = joint.pos.norm();
            let lever = if turns { far + anchor } else { 1.0 };
            found.push(Between { joint: index, low, high, limited: !full, lever, turns });
            far += if turns {
                2.0 * anchor
            } else {
                f64::max((low - joint.reference).abs(), (high - joint.reference).abs())
            };
        }
        if found.len() > JOINTS {
            return None;
        }
        far += model.bodies[body].pos.norm();
        body = model.bodies[body].parent;
    }
    // A plane has no far point, and no joint that could move it.
    (found.is_empty() || far.is_finite()).then_some(found)
}

/// The data that the test of one pair needs.
struct Search<'a> {
    model: &'a Model,
    placed: &'a mut Placed<f64>,
    between: &'a [Between],
    pair: usize,
    geoms: [usize; 2],
    bodies: Vec<usize>,
    least: f64,
    qpos: Vec<f64>,
}

impl<'a> Search<'a> {
    fn new(
        model: &'a Model,
        placed: &'a mut Placed<f64>,
        index: usize,
        between: &'a [Between],
    ) -> Self {
        let pair = &model.pairs[index];
        let material = model.material(pair);
        let geoms = [pair.geom1, pair.geom2];
        let mut bodies = vec![];
        for geom in geoms {
            let mut body = model.geoms[geom].body;
            while model.bodies[body].tree != NONE {
                bodies.push(body);
                body = model.bodies[body].parent;
            }
        }
        bodies.sort_unstable();
        bodies.dedup();
        let reach = geoms.map(|g| model.geoms[g].reach).into_iter().filter(|r| r.is_finite());
        let size = reach.chain(between.iter().map(|joint| joint.lever)).sum::<f64>();
        Self {
            model,
            placed,
            between,
            pair: index,
            geoms,
            bodies,
            least: material.listed_in(0) + ROUNDING * size,
            qpos: model.qpos0.clone(),
        }
    }

    /// Whether no configuration of the box lets the pair meet. `boxes`: how many may be examined.
    fn apart(&mut self, boxes: &mut usize) -> bool {
        let whole: Vec<[f64; 2]> = self.between.iter().map(|j| [j.low, j.high]).collect();
        let mut pending = vec![whole];
        while let Some(mut region) = pending.pop() {
            if *boxes == 0 {
                return false;
            }
            *boxes -= 1;
            let moves: Vec<f64> =
                self.between.iter().zip(&region).map(|(j, [lo, hi])| j.moves(hi - lo)).collect();
            match self.at_the_middle(&region, moves.iter().sum()) {
                Middle::Meets => return false,
                Middle::Apart => continue,
                Middle::Unknown => {}
            }
            let widest = (0..moves.len()).fold(0, |w, k| if moves[k] > moves[w] { k } else { w });
            let [low, high] = region[widest];
            let middle = 0.5 * (low + high);
            let mut half = region.clone();
            half[widest] = [low, middle];
            region[widest] = [middle, high];
            pending.extend([half, region]);
        }
        true
    }

    /// The conclusion from the middle of a box, if the joints can move the geoms by `moves` [m].
    /// The distance itself is expensive: it is computed only if boxes and centres do not decide.
    fn at_the_middle(&mut self, region: &[[f64; 2]], moves: f64) -> Middle {
        for (joint, [low, high]) in self.between.iter().zip(region) {
            self.qpos[self.model.joints[joint.joint].qpos] = 0.5 * (low + high);
        }
        self.placed.place_some(self.model, &self.qpos, &self.bodies, &self.geoms);
        let pair = &self.model.pairs[self.pair];
        if detect::boxes_apart(self.model, self.placed, pair, self.least + moves) {
            return Middle::Apart;
        }
        let [one, two] = self.geoms.map(|geom| self.placed.geom[geom].pos);
        let hollow = |g: &usize| self.model.geoms[*g].reach.is_infinite();
        let centres = (two - one).norm();
        if centres <= self.least + moves
            && !self.geoms.iter().any(hollow)
            && detect::boxes_apart(self.model, self.placed, pair, self.least)
        {
            return Middle::Unknown;
        }
        let distance = detect::distance(self.model, self.placed, pair) - self.least;
        // A distance that is not a number proves nothing.
        if distance.is_nan() || distance <= 0.0 {
            Middle::Meets
        } else if distance > moves {
            Middle::Apart
        } else {
            Middle::Unknown
        }
    }
}

/// The conclusion from one configuration about all near it.
enum Middle {
    /// The pair meets there.
    Meets,
    /// It is so far apart that it is apart in all of them.
    Apart,
    Unknown,
}
