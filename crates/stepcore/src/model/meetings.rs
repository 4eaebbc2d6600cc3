//! What a step asks of its fixed pairs first: one number a pair, side by side, and one of all pairs
//! of two bodies.
//!
//! Most pairs of a robot are far apart in most steps. The numbers here are those of the spheres
//! that hold the geoms (`detect/apart.rs` tries more), packed so that hundreds of pairs are a short
//! loop; and of spheres that hold all geoms of a body, so that most of them are not looked at. What
//! a step computes is the same, to the bit, with and without them.

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

/// Consecutive pairs of the same two bodies, and a sphere about what each of these has in them.
#[derive(Clone, Copy, Debug)]
pub struct Meeting {
    pub spheres: Spheres,
    /// Into `Model::pairs`.
    pub pairs: Span,
}

/// Sets `Model::spheres` and `Model::meetings`.
pub fn fill(model: &mut Model) {
    let bodies = |pair: &Pair| [pair.geom1, pair.geom2].map(|geom| model.geoms[geom].body);
    model.spheres = model.pairs.iter().map(|pair| of_pair(model, pair)).collect();
    let mut meetings = vec![];
    let mut start = 0;
    // Geoms stand in the order of their types: the two bodies may stand either way round.
    let sorted = |pair: &Pair| {
        let mut bodies = bodies(pair);
        bodies.sort_unstable();
        bodies
    };
    for own in model.pairs.chunk_by(|a, b| sorted(a) == sorted(b)) {
        let pairs = Span { start, len: own.len() };
        start += own.len();
        meetings.push(Meeting { spheres: of_bodies(model, pairs, sorted(&own[0])), pairs });
    }
    model.meetings = meetings;
}

fn of_pair(model: &Model, pair: &Pair) -> Spheres {
    let reach = model.geoms[pair.geom1].reach + model.geoms[pair.geom2].reach;
    let least = reach + model.material(pair).listed();
    let geoms = [pair.geom1, pair.geom2].map(|geom| geom as u32);
    Spheres { geoms, square: least * least, apart: pair.apart }
}

fn of_bodies(model: &Model, pairs: Span, bodies: [usize; 2]) -> Spheres {
    let own = pairs.of(&model.pairs);
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
