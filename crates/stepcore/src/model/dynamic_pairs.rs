//! Models with too many geoms for a list of the possible pairs, which would fill their memory.
//!
//! Up to `MOST_FIXED` such pairs are listed when a model is compiled (`pairs.rs`), in a model of
//! few trees up to `MOST_OF_FEW`. Each listed pair keeps its dofs, its slots and its island, which
//! is quick for few pairs, and which worlds in lanes need. Above that a model is a pile:
//! `detect/near.rs` finds in every step the pairs whose boxes overlap, and makes them as they would
//! be in the list. The data that pairs share is kept by geom, and their materials by two classes of
//! geoms. A pair is identified by a number that counts up in the order of the list: by the two
//! bodies, then by the geoms.

use super::fixed_tangents::{loose, still};
use super::pairs::explicit;
use super::parts::{DynamicPairs, KINDS};
use super::{Material, Model, Pair, Span, NONE};
use crate::elements::text;
use crate::error::{Error, Result};
use crate::real::Constant;
use crate::scene::{Geom, GeomType, Scene};
use crate::shapes::{height_field, ShapeTest};
use crate::spatial::Pose;
use std::collections::{HashMap, HashSet};

/// The largest number of pairs of which all are listed.
const MOST_FIXED: usize = 2000;
/// The same if fewer than `MANY` trees move: a body of theirs is near few others, and most pairs
/// are skipped body by body (`body_pairs.rs`).
const MOST_OF_FEW: usize = 20_000;
/// The number of trees from which on contacts between them decide what is solved together.
pub const MANY: usize = 8;
/// Slots of a pair of a pile, whatever its test.
pub const MOST_TOUCHES: usize = 64;
const _: () = assert!(height_field::MOST <= MOST_TOUCHES);
/// The largest number of classes of geoms whose materials are mixed by two.
const MOST_CLASSES: usize = 2048;
/// The largest number of pairs of geoms without a free body that are searched for still tangents.
const MOST_STILL: usize = 100_000;

/// The largest number of pairs of a model that are all listed.
pub fn most_fixed(model: &Model) -> usize {
    if model.trees.len() < MANY {
        MOST_OF_FEW
    } else {
        MOST_FIXED
    }
}

/// The parameters from which a material is mixed, bit by bit.
fn key(geom: &Geom) -> Vec<u64> {
    let whole = [u64::from(geom.condim), geom.priority as u64];
    let numbers = [geom.margin, geom.gap, geom.solmix, geom.adhesion];
    let lists = numbers.iter().chain(&geom.friction).chain(&geom.soft.solref);
    whole.into_iter().chain(lists.chain(&geom.soft.solimp).map(|x| x.to_bits())).collect()
}

/// Makes the pairs of a model; extends its material list and marks its geoms.
pub fn of_geoms(scene: &Scene, model: &mut Model, poses: &[Pose<f64>]) -> Result<DynamicPairs> {
    let (class, heads) = classes(scene)?;
    let mut mixed = Vec::with_capacity(heads.len() * heads.len());
    for &one in &heads {
        for &two in &heads {
            let material = Material::of_geoms(scene, one, two);
            mixed.push(model.material_index(material) as u32);
        }
    }
    let mut first = vec![0; model.bodies.len()];
    let mut counts = vec![0; model.bodies.len()];
    for (index, geom) in model.geoms.iter().enumerate().rev() {
        first[geom.body] = index;
        counts[geom.body] += 1;
    }
    let kinds: [_; KINDS] = KIND;
    let tests = kinds.map(|one| kinds.map(|two| ShapeTest::of(one, two)));
    let mut heap = DynamicPairs {
        solid: vec![],
        moving: 0,
        listed: scene.geoms.iter().map(|geom| listed(scene, geom)).collect(),
        class,
        classes: heads.len(),
        mixed,
        tests,
        first,
        most: counts.into_iter().max().unwrap_or(0),
        still: HashMap::new(),
        explicit: HashMap::new(),
    };
    heap.check_numbers(model)?;
    heap.take_explicit(scene, model);
    heap.solid = solid(model, &heap)?;
    let stands = |geom: &usize| {
        let body = &model.bodies[model.geoms[*geom].body];
        body.tree == NONE && !body.carried
    };
    heap.solid.sort_by_key(stands);
    heap.moving = heap.solid.partition_point(|geom| !stands(geom));
    for &geom in &heap.solid {
        model.geoms[geom].collides = true;
        model.geoms[geom].by_axis = false;
    }
    heap.find_still(model, poses);
    Ok(heap)
}

/// The class of each geom, and a geom of each class.
fn classes(scene: &Scene) -> Result<(Vec<u32>, Vec<usize>)> {
    let (mut known, mut heads) = (HashMap::new(), vec![]);
    let class = |(index, geom): (usize, &Geom)| {
        *known.entry(key(geom)).or_insert_with(|| {
            heads.push(index);
            heads.len() as u32 - 1
        })
    };
    let class = scene.geoms.iter().enumerate().map(class).collect();
    if heads.len() > MOST_CLASSES {
        return Err(Error::Scene(text![format!(
            "{} geoms have {} different sets of contact parameters (condim, friction, solref, \
             solimp, solmix, priority, margin, gap, adhesion): a model whose pairs are found as they come \
             near can have {MOST_CLASSES}",
            scene.geoms.len(),
            heads.len(),
        )]));
    }
    Ok((class, heads))
}

const KIND: [GeomType; KINDS] = [
    GeomType::Plane,
    GeomType::HField,
    GeomType::Sphere,
    GeomType::Capsule,
    GeomType::Ellipsoid,
    GeomType::Cylinder,
    GeomType::Box,
    GeomType::Mesh,
];

/// A geom's part of the distance below which contacts are listed [m].
fn listed(scene: &Scene, geom: &Geom) -> f64 {
    geom.gap + scene.contact_override.as_ref().map_or(geom.margin, |by| 0.5 * by.margin)
}

/// Geoms that share a bit with a geom of another body, unless both bodies never move. Checks that
/// every two kinds that can meet have a test.
fn solid(model: &Model, heap: &DynamicPairs) -> Result<Vec<usize>> {
    // One geom represents all of its kind and set of bits, moving and fixed ones apart.
    let mut groups: HashMap<(GeomType, u32, u32, bool), (usize, bool)> = HashMap::new();
    let moves = |geom: &super::Geom| model.bodies[geom.body].tree != NONE;
    let bits = |geom: &super::Geom| (geom.kind, geom.contype, geom.conaffinity, moves(geom));
    for (index, geom) in model.geoms.iter().enumerate() {
        let group = groups.entry(bits(geom)).or_insert((index, false));
        group.1 |= model.geoms[group.0].body != geom.body;
    }
    let mut heads: Vec<(usize, bool)> = groups.values().copied().collect();
    heads.sort_unstable();
    let mut meets = HashMap::new();
    for &(one, several) in &heads {
        for &(two, _) in heads.iter().filter(|(two, _)| one != *two || several) {
            let [first, second] = [one, two].map(|geom| &model.geoms[geom]);
            if (moves(first) || moves(second)) && model.never_by_kind(one, two).is_none() {
                meets.insert(bits(&model.geoms[one]), ());
                let (a, b) = model.ordered(one, two);
                if heap.test(model, a, b).is_none() {
                    return Err(super::pairs::not_built(model, a, b));
                }
            }
        }
    }
    for &(a, b) in heap.explicit.keys() {
        let (a, b) = model.ordered(a, b);
        if heap.test(model, a, b).is_none() {
            return Err(super::pairs::not_built(model, a, b));
        }
    }
    let named: HashSet<usize> = heap.explicit.keys().flat_map(|(a, b)| [*a, *b]).collect();
    let solid = |at: &usize| meets.contains_key(&bits(&model.geoms[*at])) || named.contains(at);
    Ok((0..model.geoms.len()).filter(solid).collect())
}

impl DynamicPairs {
    /// Checks that 64 bits can count the slots.
    fn check_numbers(&self, model: &Model) -> Result<()> {
        let (bodies, most) = (model.bodies.len() as u128, self.most as u128);
        let numbers = bodies * bodies * 2 * most * most;
        if numbers * (MOST_TOUCHES as u128) < (1 << 62) {
            return Ok(());
        }
        Err(Error::Scene(text![format!(
            "{bodies} bodies of up to {most} geoms have too many pairs to number: \
             spread the geoms of one body over several"
        )]))
    }

    /// Adds explicit pairs, which have separate parameters.
    fn take_explicit(&mut self, scene: &Scene, model: &mut Model) {
        for (_, index) in explicit(scene, model) {
            let pair = &scene.pairs[index];
            let material = Material::of_pair(scene, pair);
            let listed: f64 = material.listed();
            let listed = 0.5 * listed;
            for geom in [pair.geom1, pair.geom2] {
                self.listed[geom] = self.listed[geom].max(listed);
            }
            let geoms = (pair.geom1.min(pair.geom2), pair.geom1.max(pair.geom2));
            self.explicit.insert(geoms, model.material_index(material));
        }
    }

    fn test<N: Constant>(&self, model: &Model<N>, one: usize, two: usize) -> Option<ShapeTest> {
        self.tests[model.geoms[one].kind as usize][model.geoms[two].kind as usize]
    }

    /// Finds tangents along which nothing moves, in pairs in which no part moves freely.
    fn find_still(&mut self, model: &Model, poses: &[Pose<f64>]) {
        let mut bound = self.solid.clone();
        bound.retain(|geom| !loose(model, model.geoms[*geom].body));
        bound.sort_unstable();
        if bound.len() * bound.len() > MOST_STILL {
            return;
        }
        for (k, &a) in bound.iter().enumerate() {
            for &b in &bound[k + 1..] {
                let (a, b) = model.ordered(a, b);
                let Some(test) = self.test(model, a, b) else { continue };
                let found = still(model, poses, test, a, b);
                if found != [false; 2] {
                    self.still.insert((a, b), found);
                }
            }
        }
    }

    /// One more than the highest number.
    pub fn numbers(&self) -> usize {
        self.first.len() * self.first.len() * 2 * self.most * self.most
    }
}

impl<N: Constant> Model<N> {
    /// The number of a pair of a pile; None if the two never meet.
    pub(crate) fn number(&self, heap: &DynamicPairs, a: usize, b: usize) -> Option<u64> {
        let (one, two) = (self.geoms[a].body, self.geoms[b].body);
        let own = !heap.explicit.is_empty() && self.explicit.contains(&(a.min(b), a.max(b)));
        let never = if own {
            // Nothing else keeps the geoms of an explicit pair apart.
            let moves = !self.stand_still(one, two);
            !(moves && self.features.contact && self.features.constraint)
        } else {
            self.never_by_kind(a, b).is_some()
                || self.never_between(one, two).is_some()
                || self.never(a, b).is_some()
        };
        if never {
            return None;
        }
        let (a, b) = self.ordered(a.min(b), a.max(b));
        let (from, to) = (self.geoms[a].body, self.geoms[b].body);
        let side = usize::from(from > to);
        let bodies = one.min(two) * self.bodies.len() + one.max(two);
        let within = (a - heap.first[from]) * heap.most + b - heap.first[to];
        Some(((bodies * 2 + side) * heap.most * heap.most + within) as u64)
    }

    /// A pair of a pile by its number, without its dofs. There is one world.
    pub(crate) fn near_pair(&self, heap: &DynamicPairs, number: u64, a: usize, b: usize) -> Pair {
        let (a, b) = self.ordered(a, b);
        let (x, y) = (&self.geoms[a], &self.geoms[b]);
        let classes = [a, b].map(|geom| heap.class[geom] as usize);
        let still = if heap.still.is_empty() { None } else { heap.still.get(&(a, b)) };
        let mixed = heap.mixed[classes[0] * heap.classes + classes[1]] as usize;
        let explicit =
            if heap.explicit.is_empty() { None } else { heap.explicit.get(&(a.min(b), a.max(b))) };
        let material = explicit.copied().unwrap_or(mixed);
        let condim = self.materials[material].condim;
        Pair {
            geom1: a,
            geom2: b,
            // Every two kinds that can meet have a test.
            test: heap.test(self, a, b).unwrap_or(ShapeTest::SphereSphere),
            material,
            index: number as usize,
            slot: number as usize * MOST_TOUCHES,
            invweight: self.bodies[x.body].invweight[0].lane(0)
                + self.bodies[y.body].invweight[0].lane(0),
            dofs: Span::default(),
            mass: super::pairs::touched_mass(self, x.body, y.body),
            still: still.filter(|_| condim > 1).copied().unwrap_or([false; 2]),
            apart: false,
        }
    }

    /// The two geoms of a contact's element; None: there is no such pair.
    pub fn contact_geoms(&self, index: usize) -> Option<(usize, usize)> {
        let Some(heap) = &self.dynamic_pairs else {
            return self.pairs.get(index).map(|pair| (pair.geom1, pair.geom2));
        };
        let square = heap.most * heap.most;
        let (bodies, within) = (index / (2 * square), index % square);
        let (one, two) = (bodies / self.bodies.len(), bodies % self.bodies.len());
        let (from, to) = if (index / square).is_multiple_of(2) { (one, two) } else { (two, one) };
        let geom = |body: usize, at: usize| {
            let index = heap.first.get(body)? + at;
            self.geoms.get(index).filter(|geom| geom.body == body).map(|_| index)
        };
        let found = (geom(from, within / heap.most)?, geom(to, within % heap.most)?);
        (self.number(heap, found.0, found.1) == Some(index as u64)).then_some(found)
    }

    /// A possible pair, by the index of its contacts' element; None: there is no such pair. In a
    /// pile it has no dofs.
    pub fn pair(&self, index: usize) -> Option<Pair> {
        match &self.dynamic_pairs {
            None => self.pairs.get(index).map(|pair| pair.lane(0)),
            Some(heap) => {
                let (a, b) = self.contact_geoms(index)?;
                Some(self.near_pair(heap, index as u64, a, b))
            }
        }
    }
}
