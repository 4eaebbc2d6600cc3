//! What a step asks of its fixed pairs first: one number a pair, side by side, and one of all pairs
//! of two bodies.
//!
//! Most pairs of a robot are far apart in most steps. The numbers here are those of the spheres
//! that hold the geoms (`detect/apart.rs` tries more), packed so that hundreds of pairs are a short
//! loop; and of spheres that hold all geoms of a body, so that most of them are not looked at: all
//! of both bodies first, then one geom and all of the other body. What a step computes is the same,
//! to the bit, with and without them.

use super::{BodyPair, Model, Pair, Span, Spheres};

/// By how much more the spheres of bodies are apart, of their size: more than rounding in single
/// precision, so that no pair is passed over that the spheres of its geoms would not.
const SURE: f64 = 1e-4;

/// So many pairs of a geom are worth a sphere of their own.
const RUN: usize = 4;

/// By pair, and by two bodies.
pub fn of_pairs(model: &Model) -> (Vec<Spheres>, Vec<BodyPair>) {
    let spheres = model.pairs.iter().map(|pair| of_pair(model, pair)).collect();
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
    (spheres, body_pairs)
}

/// The two bodies of a pair, the smaller first: geoms stand in the order of their types.
fn sorted(model: &Model, pair: &Pair) -> [usize; 2] {
    let mut bodies = [pair.geom1, pair.geom2].map(|geom| model.geoms[geom].body);
    bodies.sort_unstable();
    bodies
}

fn of_pair(model: &Model, pair: &Pair) -> Spheres {
    let reach = model.geoms[pair.geom1].reach + model.geoms[pair.geom2].reach;
    let listed: f64 = model.material(pair).listed();
    let least = reach + listed;
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
