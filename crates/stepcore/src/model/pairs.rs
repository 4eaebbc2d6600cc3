//! Which geoms can ever meet, and what their contacts share. MuJoCo's filter and
//! mixing rules; the filter is applied once, here, and never during a step.

use super::pose::Pose;
use super::still::still;
use super::tree::Unions;
use super::{Equality, Material, Model, Pair, NONE};
use crate::elements::{text, Kind, Text};
use crate::error::{Error, Result};
use crate::scene::{Geom, GeomType, Scene, Softness};
use crate::shapes::ShapeTest;
use nalgebra::Vector3;

/// A plane is fixed to the world, as in MuJoCo.
pub fn planes_stand_still(model: &Model) -> Result<()> {
    for (i, g) in model.geoms.iter().enumerate() {
        if g.kind == GeomType::Plane && model.bodies[g.body].tree != NONE {
            return Err(Error::Scene(text![
                Text::label(Kind::Geom, &g.name, i),
                " is a plane on ",
                Text::label(Kind::Body, &model.bodies[g.body].name, g.body),
                ", which moves: a plane must be on a fixed body"
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
    /// No joint stands between their bodies.
    Fixed,
    /// One body is the parent of the other.
    Family,
    Excluded,
    /// No bit of one's contype is in the other's conaffinity.
    Bits,
    /// Two planes.
    Planes,
}

impl Model {
    /// Why no geom of these two bodies can meet one of the other, or None.
    pub fn never_between(&self, body1: usize, body2: usize) -> Option<Never> {
        let (weld1, weld2) = (self.bodies[body1].weld, self.bodies[body2].weld);
        let above = |weld: usize| self.bodies[self.bodies[weld].parent].weld;
        let family = weld1 != 0 && weld2 != 0 && (weld1 == above(weld2) || weld2 == above(weld1));
        if !(self.features.contact && self.features.constraint) {
            Some(Never::Off)
        } else if body1 == body2 {
            Some(Never::SameBody)
        } else if weld1 == weld2 {
            Some(Never::Fixed)
        } else if self.excludes.contains(&(body1.min(body2), body1.max(body2))) {
            Some(Never::Excluded)
        } else {
            // The world is no one's family.
            (self.features.filterparent && family).then_some(Never::Family)
        }
    }

    /// Why these two geoms cannot meet although their bodies may, or None.
    pub fn never(&self, a: usize, b: usize) -> Option<Never> {
        let (x, y) = (&self.geoms[a], &self.geoms[b]);
        if x.contype & y.conaffinity | y.contype & x.conaffinity == 0 {
            return Some(Never::Bits);
        }
        let planes = x.kind == GeomType::Plane && y.kind == GeomType::Plane;
        planes.then_some(Never::Planes)
    }

    /// Where a material stands in the list; it is added if it is new.
    fn material_index(&mut self, material: Material) -> usize {
        // Neighbours are mostly alike.
        let known = self.materials.iter().rposition(|known| *known == material);
        known.unwrap_or_else(|| {
            self.materials.push(material);
            self.materials.len() - 1
        })
    }

    /// Two geoms in the order of their types.
    fn ordered(&self, a: usize, b: usize) -> (usize, usize) {
        if self.geoms[a].kind > self.geoms[b].kind {
            (b, a)
        } else {
            (a, b)
        }
    }
}

/// Pairs in MuJoCo's order of contacts: by the two bodies, then by the geoms.
pub fn fill(scene: &Scene, model: &mut Model, poses: &[Pose], unions: &mut Unions) -> Result<()> {
    let mut geoms = vec![vec![]; scene.bodies.len()];
    for (i, g) in scene.geoms.iter().enumerate() {
        if g.contype != 0 || g.conaffinity != 0 {
            geoms[g.body].push(i);
        }
    }
    let full: Vec<usize> = (0..geoms.len()).filter(|b| !geoms[*b].is_empty()).collect();
    for (k, &body1) in full.iter().enumerate() {
        for &body2 in &full[k + 1..] {
            if model.never_between(body1, body2).is_some() {
                continue;
            }
            let mut found = vec![];
            for &a in &geoms[body1] {
                let others = geoms[body2].iter().filter(|b| model.never(a, **b).is_none());
                found.extend(others.map(|&b| model.ordered(a, b)));
            }
            found.sort_unstable();
            for (a, b) in found {
                let pair = pair(scene, model, poses, unions, (a, b))?;
                model.pairs.push(pair);
                model.geoms[a].collides = true;
                model.geoms[b].collides = true;
            }
        }
    }
    Ok(())
}

fn pair(
    scene: &Scene,
    model: &mut Model,
    poses: &[Pose],
    unions: &mut Unions,
    (a, b): (usize, usize),
) -> Result<Pair> {
    let (x, y) = (&scene.geoms[a], &scene.geoms[b]);
    let names =
        || text![Text::label(Kind::Geom, &x.name, a), " and ", Text::label(Kind::Geom, &y.name, b)];
    let Some(test) = ShapeTest::of(x.kind, y.kind) else {
        return Err(Error::Scene(text![
            names(),
            format!(
                " can meet, but {} against {} is not built yet; built are {} (exclude the pair, or \
                 clear bits of contype and conaffinity)",
                x.kind.word(),
                y.kind.word(),
                ShapeTest::built()
        )
        ]));
    };
    let material = mix(x, y);
    let condim = material.condim;
    let dofs = unions.of(model, x.body, y.body);
    Ok(Pair {
        geom1: a,
        geom2: b,
        test,
        material: model.material_index(material),
        slot: model.pairs.last().map_or(0, |last| last.slot + last.test.most_touches()),
        invweight: model.bodies[x.body].invweight[0] + model.bodies[y.body].invweight[0],
        dofs,
        mass: touched_mass(model, x.body, y.body),
        still: if condim == 1 { [false; 2] } else { still(model, poses, test, a, b) },
        apart: false,
    })
}

/// The geom of higher priority decides; equals are mixed: the larger condim and
/// friction, softness by the share of solmix.
fn mix(x: &Geom, y: &Geom) -> Material {
    let (margin, gap) = (x.margin + y.margin, x.gap + y.gap);
    if x.priority != y.priority {
        let g = if x.priority > y.priority { x } else { y };
        let friction = by_direction(g.friction);
        let soft = g.soft.clone();
        return Material { condim: g.condim, friction, margin, gap, soft, solreffriction: None };
    }
    let share = match (x.solmix > 0.0, y.solmix > 0.0) {
        (true, true) => x.solmix / (x.solmix + y.solmix),
        (false, false) => 0.5,
        (one, _) => f64::from(u8::from(one)),
    };
    let blend = |p: f64, q: f64| share * p + (1.0 - share) * q;
    let (p, q) = (&x.soft, &y.soft);
    // Stiffness and damping given directly are negative: the stiffer one counts.
    let direct = p.solref[0] <= 0.0 || q.solref[0] <= 0.0;
    let solref = std::array::from_fn(|i| {
        let (p, q) = (p.solref[i], q.solref[i]);
        if direct {
            p.min(q)
        } else {
            blend(p, q)
        }
    });
    let larger = std::array::from_fn(|i| f64::max(x.friction[i], y.friction[i]));
    Material {
        condim: x.condim.max(y.condim),
        friction: by_direction(larger),
        margin,
        gap,
        soft: Softness { solref, solimp: std::array::from_fn(|i| blend(p.solimp[i], q.solimp[i])) },
        solreffriction: None,
    }
}

/// Sliding, torsional and rolling friction by direction.
fn by_direction([slide, torsion, roll]: [f64; 3]) -> [f64; 5] {
    [slide, slide, torsion, roll, roll]
}

/// Mass of the trees of both bodies, each once.
fn touched_mass(model: &Model, body1: usize, body2: usize) -> f64 {
    let (one, two) = (model.bodies[body1].tree, model.bodies[body2].tree);
    let mass = |tree: usize| if tree == NONE { 0.0 } else { model.trees[tree].mass };
    mass(one) + if one == two { 0.0 } else { mass(two) }
}

/// `connect`: the point is given on body 1; where it lies on body 2 follows from qpos0.
pub fn fill_equalities(
    scene: &Scene,
    model: &mut Model,
    poses: &[Pose],
    unions: &mut Unions,
) -> Result<()> {
    for (i, q) in scene.equalities.iter().enumerate() {
        let dofs = unions.of(model, q.body1, q.body2);
        if dofs.len == 0 {
            let name = Text::label(Kind::Equality, &q.name, i);
            return Err(Error::Scene(text![name, " connects two bodies that cannot move"]));
        }
        let anchor1 = Vector3::from(q.anchor);
        let (one, two) = (&poses[q.body1], &poses[q.body2]);
        let equality = Equality {
            name: q.name.clone(),
            body1: q.body1,
            body2: q.body2,
            anchor1,
            anchor2: two.rot.transpose() * (one.point(anchor1) - two.pos),
            active: q.active,
            soft: q.soft.clone(),
            invweight: model.bodies[q.body1].invweight[0] + model.bodies[q.body2].invweight[0],
            dofs,
            mass: touched_mass(model, q.body1, q.body2),
        };
        model.equalities.push(equality);
    }
    Ok(())
}
