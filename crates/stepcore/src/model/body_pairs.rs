//! The first test of a step's fixed pairs: one number for each pair, packed, and one for all pairs
//! of two bodies.
//!
//! Most pairs of a robot are far apart in most steps. The numbers here belong to the spheres that
//! contain the geoms (`detect/apart.rs` tests more), packed so that hundreds of pairs are a short
//! loop; and to spheres that contain all geoms of a body, so that most pairs are skipped: first all
//! of both bodies, then one geom and all of the other body. A step's result is the same, to the
//! bit, with and without them.

use super::{BodyPair, Model, Pair, Span, Spheres};

/// By how much farther apart the spheres of bodies must be, relative to their size: more than
/// single-precision rounding, so that no pair is skipped that the spheres of its geoms would keep.
const SURE: f64 = 1e-4;

/// The number of pairs of a geom that justifies a sphere for them.
const RUN: usize = 4;

/// The spheres by pair, and by two bodies.
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

/// The two bodies of a pair, the smaller first: geoms are in the order of their types.
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

/// The smallest sphere about one of a body's geoms that contains all its geoms in these pairs.
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
