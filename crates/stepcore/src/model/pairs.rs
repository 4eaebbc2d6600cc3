//! The geoms that can ever meet, and the data that their contacts share. MuJoCo's filter and mixing
//! rules; the filter is applied once, here, and never during a step.

use super::fixed_tangents::still;
use super::tree::Unions;
use super::{Material, Model, Pair, NONE};
use crate::elements::{text, Kind, Text};
use crate::error::{Error, Result};
use crate::interrupt::{Meter, ROW};
use crate::real::Constant;
use crate::scene::{ExplicitPair, GeomType, Scene};
use crate::shapes::ShapeTest;
use crate::spatial::Pose;

/// A plane is fixed to the world, as in MuJoCo.
pub fn planes_stand_still(model: &Model) -> Result<()> {
    for (i, g) in model.geoms.iter().enumerate() {
        let still = matches!(g.kind, GeomType::Plane | GeomType::HField);
        if still && model.bodies[g.body].tree != NONE {
            let word = g.kind.word();
            return Err(Error::Scene(text![
                Text::label(Kind::Geom, &g.name, i),
                format!(" is a {word} on "),
                Text::label(Kind::Body, &model.bodies[g.body].name, g.body),
                format!(", which moves: a {word} must be on a fixed body")
            ]));
        }
    }
    Ok(())
}

/// Why two geoms never meet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Never {
    /// Contacts are switched off.
    Off,
    SameBody,
    /// No joint is between their bodies.
    Fixed,
    /// One body is the parent of the other.
    Family,
    Excluded,
    /// No bit of one's contype is in the other's conaffinity.
    Bits,
    /// Two planes.
    Planes,
    /// An explicit pair replaces this one.
    Explicit,
}

impl<N: Constant> Model<N> {
    /// Whether nothing in a step moves two bodies against each other.
    pub(super) fn stand_still(&self, body1: usize, body2: usize) -> bool {
        let (one, two) = (&self.bodies[body1], &self.bodies[body2]);
        one.weld == two.weld || (one.tree == NONE && two.tree == NONE)
    }

    /// The reason why no geom of these two bodies can meet one of the other, or None.
    pub fn never_between(&self, body1: usize, body2: usize) -> Option<Never> {
        let (weld1, weld2) = (self.bodies[body1].weld, self.bodies[body2].weld);
        let above = |weld: usize| self.bodies[self.bodies[weld].parent].weld;
        let family = weld1 != 0 && weld2 != 0 && (weld1 == above(weld2) || weld2 == above(weld1));
        if !(self.features.contact && self.features.constraint) {
            Some(Never::Off)
        } else if body1 == body2 {
            Some(Never::SameBody)
        } else if self.stand_still(body1, body2) {
            Some(Never::Fixed)
        } else if self.excludes.contains(&(body1.min(body2), body1.max(body2))) {
            Some(Never::Excluded)
        } else {
            // The parent filter never applies to the world.
            (self.features.filterparent && family).then_some(Never::Family)
        }
    }

    /// The reason why these two geoms cannot meet although their bodies may, or None.
    pub fn never(&self, a: usize, b: usize) -> Option<Never> {
        let explicit = || self.explicit.contains(&(a.min(b), a.max(b))).then_some(Never::Explicit);
        self.never_by_kind(a, b).or_else(explicit)
    }

    /// The reason why two geoms of such kinds, with such bits, cannot meet, or None.
    pub(super) fn never_by_kind(&self, a: usize, b: usize) -> Option<Never> {
        let (x, y) = (&self.geoms[a], &self.geoms[b]);
        if x.contype & y.conaffinity | y.contype & x.conaffinity == 0 {
            return Some(Never::Bits);
        }
        if x.kind == GeomType::Plane && y.kind == GeomType::Plane {
            return Some(Never::Planes);
        }
        None
    }

    /// Two geoms in the order of their types.
    pub(super) fn ordered(&self, a: usize, b: usize) -> (usize, usize) {
        if self.geoms[a].kind > self.geoms[b].kind {
            (b, a)
        } else {
            (a, b)
        }
    }
}

/// Lists pairs in MuJoCo's order of contacts: by the two bodies, then by the geoms. Returns false,
/// and no pairs, if there are more than `most`.
pub fn list(
    scene: &Scene,
    model: &mut Model,
    poses: &[Pose<f64>],
    unions: &mut Unions,
    most: usize,
) -> Result<bool> {
    let lists = model.dof_lists.len();
    let mut geoms = vec![vec![]; scene.bodies.len()];
    for (i, g) in scene.geoms.iter().enumerate() {
        if g.contype != 0 || g.conaffinity != 0 {
            geoms[g.body].push(i);
        }
    }
    let mut explicit = explicit(scene, model).into_iter().peekable();
    let mut list = List { scene, model, poses, unions };
    let full: Vec<usize> = (0..geoms.len()).filter(|b| !geoms[*b].is_empty()).collect();
    let mut meter = Meter::default();
    for (k, &body1) in full.iter().enumerate() {
        for &body2 in &full[k + 1..] {
            meter.count(geoms[body1].len() * geoms[body2].len() + ROW);
            while let Some((_, index)) = explicit.next_if(|(bodies, _)| *bodies <= [body1, body2]) {
                list.add_explicit(index)?;
            }
            if list.model.never_between(body1, body2).is_some() {
                continue;
            }
            let mut found = vec![];
            for &a in &geoms[body1] {
                let others = geoms[body2].iter().filter(|b| list.model.never(a, **b).is_none());
                found.extend(others.map(|&b| list.model.ordered(a, b)));
            }
            if list.model.pairs.len() + found.len() > most {
                model.pairs.clear();
                model.materials.clear();
                model.dof_lists.truncate(lists);
                *unions = Unions::default();
                model.geoms.iter_mut().for_each(|geom| geom.collides = false);
                return Ok(false);
            }
            found.sort_unstable();
            for (a, b) in found {
                list.add((a, b), Material::of_geoms(scene, a, b))?;
            }
        }
    }
    for (_, index) in explicit {
        list.add_explicit(index)?;
    }
    Ok(true)
}

/// The list of pairs while it is made.
struct List<'a> {
    scene: &'a Scene,
    model: &'a mut Model,
    poses: &'a [Pose<f64>],
    unions: &'a mut Unions,
}

impl List<'_> {
    fn add_explicit(&mut self, index: usize) -> Result<()> {
        let own = &self.scene.pairs[index];
        let by_body = |geom: usize| (self.scene.geoms[geom].body, geom);
        let (a, b) = (own.geom1, own.geom2);
        let (a, b) = if by_body(a) > by_body(b) { (b, a) } else { (a, b) };
        self.add(self.model.ordered(a, b), Material::of_pair(self.scene, own))
    }

    fn add(&mut self, (a, b): (usize, usize), material: Material) -> Result<()> {
        let Self { scene, model, poses, unions } = self;
        let (x, y) = (&scene.geoms[a], &scene.geoms[b]);
        let test = ShapeTest::of(x.kind, y.kind).ok_or_else(|| not_built(model, a, b))?;
        let condim = material.condim;
        let pair = Pair {
            geom1: a,
            geom2: b,
            test,
            dofs: unions.of(model, x.body, y.body),
            material: model.material_index(material),
            index: model.pairs.len(),
            slot: model.pairs.last().map_or(0, |last| last.slot + last.test.most_touches()),
            invweight: model.bodies[x.body].invweight[0] + model.bodies[y.body].invweight[0],
            mass: touched_mass(model, x.body, y.body),
            still: if condim == 1 { [false; 2] } else { still(model, poses, test, a, b) },
            apart: false,
        };
        model.pairs.push(pair);
        for at in [a, b] {
            model.geoms[at].collides = true;
            model.geoms[at].by_axis &= test.by_axes();
        }
        Ok(())
    }
}

/// Explicit pairs by their bodies, which decide their place among the others; without the pairs
/// whose geoms cannot move against each other.
pub(super) fn explicit(scene: &Scene, model: &Model) -> Vec<([usize; 2], usize)> {
    if !(model.features.contact && model.features.constraint) {
        return vec![];
    }
    let body = |geom: usize| scene.geoms[geom].body;
    let moving = |(_, p): &(usize, &ExplicitPair)| !model.stand_still(body(p.geom1), body(p.geom2));
    let all = scene.pairs.iter().enumerate().filter(moving);
    let mut list: Vec<_> = all
        .map(|(index, p)| {
            let mut bodies = [p.geom1, p.geom2].map(|geom| scene.geoms[geom].body);
            bodies.sort_unstable();
            (bodies, index)
        })
        .collect();
    list.sort_unstable();
    list
}

/// The error for two geoms that can meet although their shapes have no test.
pub(super) fn not_built(model: &Model, a: usize, b: usize) -> Error {
    let (x, y) = (&model.geoms[a], &model.geoms[b]);
    Error::Scene(text![
        Text::label(Kind::Geom, &x.name, a),
        " and ",
        Text::label(Kind::Geom, &y.name, b),
        format!(
            " can meet, but {} against {} is not built yet; built are {} (exclude the pair, or \
             clear bits of contype and conaffinity)",
            x.kind.word(),
            y.kind.word(),
            ShapeTest::built()
        )
    ])
}

/// The total mass of the trees of both bodies, each counted once.
pub(super) fn touched_mass<N: Constant>(model: &Model<N>, body1: usize, body2: usize) -> f64 {
    let (one, two) = (model.bodies[body1].tree, model.bodies[body2].tree);
    let mass = |tree: usize| if tree == NONE { 0.0 } else { model.trees[tree].mass.lane(0) };
    mass(one) + if one == two { 0.0 } else { mass(two) }
}
