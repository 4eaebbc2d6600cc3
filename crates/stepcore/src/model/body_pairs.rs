//! What a step asks of its fixed pairs first: one number a pair, side by side, and one of all pairs
//! of two bodies.
//!
//! Most pairs of a robot are far apart in most steps. The numbers here are those of the spheres
//! that hold the geoms (`detect/apart.rs` tries more), packed so that hundreds of pairs are a short
//! loop; and of spheres that hold all geoms of a body, so that most of them are not looked at: all
//! of both bodies first, then one geom and all of the other body. What a step computes is the same,
//! to the bit, with and without them.

use super::{Model, Pair, Span};

/// By how much more the spheres of bodies are apart, of their size: more than rounding in single
/// precision, so that no pair is passed over that the spheres of its geoms would not.
const SURE: f64 = 1e-4;

/// Two spheres about the centres of two geoms.
#[derive(Clone, Copy, Debug)]
pub struct Spheres {
    pub geoms: [u32; 2],
    /// Square of the distance above which nothing in them is listed [m²]; infinite with a plane.
    pub square: f64,
    /// The ranges of joints keep everything in them apart: see `Pair::apart`.
    pub apart: bool,
}

/// So many pairs of a geom are worth a sphere of their own.
const RUN: usize = 4;

/// Consecutive pairs of the same two bodies, or those of them that share their first geom, and a
/// sphere about what each of the two has in them.
#[derive(Clone, Copy, Debug)]
pub struct BodyPair {
    pub spheres: Spheres,
    /// Into `Model::pairs`; none where they are in the body_pairs that follow.
    pub pairs: Span,
    /// Of the next pair that is no part of this one.
    pub next: usize,
}

/// Sets `Model::spheres` and `Model::body_pairs`.
pub fn fill(model: &mut Model) {
    model.spheres = model.pairs.iter().map(|pair| of_pair(model, pair)).collect();
    let mut body_pairs = vec![];
    let mut start = 0;
    let mut add = |start: usize, pairs: usize, len: usize, parts: usize| {
        let all = Span { start, len: pairs };
        let own = all.of(&model.pairs);
        let next = body_pairs.len() + 1 + parts;
        let spheres = of_bodies(model, own, sorted(model, &own[0]));
        body_pairs.push(BodyPair { spheres, pairs: Span { start, len }, next });
    };
    for own in model.pairs.chunk_by(|a, b| sorted(model, a) == sorted(model, b)) {
        let runs = || own.chunk_by(|a, b| a.geom1 == b.geom1);
        let count = runs().count();
        if count > 1 && own.len() >= RUN * count {
            add(start, own.len(), 0, count);
            let mut first = start;
            for run in runs() {
                add(first, run.len(), run.len(), 0);
                first += run.len();
            }
        } else {
            add(start, own.len(), own.len(), 0);
        }
        start += own.len();
    }
    model.body_pairs = body_pairs;
}

/// The two bodies of a pair, the smaller first: geoms stand in the order of their types.
fn sorted(model: &Model, pair: &Pair) -> [usize; 2] {
    let mut bodies = [pair.geom1, pair.geom2].map(|geom| model.geoms[geom].body);
    bodies.sort_unstable();
    bodies
}

fn of_pair(model: &Model, pair: &Pair) -> Spheres {
    let reach = model.geoms[pair.geom1].reach + model.geoms[pair.geom2].reach;
    let least = reach + model.material(pair).listed();
    let geoms = [pair.geom1, pair.geom2].map(|geom| geom as u32);
    Spheres { geoms, square: least * least, apart: pair.apart }
}

fn of_bodies(model: &Model, own: &[Pair], bodies: [usize; 2]) -> Spheres {
    let [one, two] = bodies.map(|body| sphere(model, own, body));
    let listed = own.iter().map(|pair| model.material(pair).listed()).fold(0.0, f64::max);
    let least = (one.1 + two.1 + listed) * (1.0 + SURE);
    let apart = own.iter().all(|pair| pair.apart);
    Spheres { geoms: [one.0 as u32, two.0 as u32], square: least * least, apart }
}

/// The smallest sphere about one of a body's geoms that holds all those of these pairs.
fn sphere(model: &Model, pairs: &[Pair], body: usize) -> (usize, f64) {
    let mut geoms: Vec<usize> = pairs.iter().flat_map(|pair| [pair.geom1, pair.geom2]).collect();
    geoms.retain(|geom| model.geoms[*geom].body == body);
    geoms.sort_unstable();
    geoms.dedup();
    let reach = |about: usize| {
        let far = |geom: &usize| {
            let geom = &model.geoms[*geom];
            (geom.pos - model.geoms[about].pos).norm() + geom.reach
        };
        geoms.iter().map(far).fold(0.0, f64::max)
    };
    let about = geoms.iter().map(|geom| (*geom, reach(*geom)));
    about.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, f64::INFINITY))
}
