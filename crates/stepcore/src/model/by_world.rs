//! Models of worlds that stand side by side: the same but for numbers, each of which is one for all of
//! them or one for each.

use std::any::Any;
use std::ops::Deref;
use std::slice;
use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};

use super::lengths::{Limited, Rubbing};
use super::parts::{FlatBody, FlatGeom, FlatJoint};
use super::{
    Body, BodyPair, Coupling, Dof, Ends, Equality, Geom, Guard, Joint, Material, Model, Pair,
    Plane, Spheres, Tendon, Tie, Tree,
};
use crate::elements::spin::isotropic;
use crate::error::{Error, Result};
use crate::plan::acting::{Acting, Acts, ActuatorAt, DamperAt, MassAt, SpringAt, TendonAt};
use crate::real::{Constant, Real};
use crate::room::Room;
use crate::scene::{Actuator, Softness};
use crate::solve::law::impedance_form;

/// A part of several models as one; None where more than numbers differs.
trait Together<V> {
    type Out;
    fn together(of: &[&Self]) -> Option<Self::Out>;
}

/// What a step may ask of a number without looking at it in every lane.
fn class(x: f64) -> (bool, bool) {
    (x == 0.0, x.is_infinite())
}

impl<V: Constant> Together<V> for f64 {
    type Out = V;
    fn together(of: &[&f64]) -> Option<V> {
        let alike = |x: &&f64| class(**x) == class(*of[0]);
        let same = of.iter().all(|x| x.to_bits() == of[0].to_bits());
        if same {
            return Some(V::by_lane(&[*of[0]]));
        }
        of.iter().all(alike).then(|| V::by_lane(&of.iter().map(|x| **x).collect::<Vec<_>>()))
    }
}

/// The same of what stands at one place in each of them.
fn each<'a, V, T: 'a, P: Together<V> + 'a>(
    of: &[&'a T],
    part: impl Fn(&'a T) -> &'a P,
) -> Option<P::Out> {
    P::together(&of.iter().map(|whole| part(whole)).collect::<Vec<_>>())
}

impl<V, T: Together<V>> Together<V> for Vec<T> {
    type Out = Vec<T::Out>;
    fn together(of: &[&Self]) -> Option<Self::Out> {
        if of.iter().any(|list| list.len() != of[0].len()) {
            return None;
        }
        (0..of[0].len()).map(|k| each(of, |list| &list[k])).collect()
    }
}

impl<V, T: Together<V>, const N: usize> Together<V> for [T; N] {
    type Out = [T::Out; N];
    fn together(of: &[&Self]) -> Option<Self::Out> {
        let all: Option<Vec<T::Out>> = (0..N).map(|k| each(of, |list| &list[k])).collect();
        all?.try_into().ok()
    }
}

impl<V, T: Together<V>> Together<V> for Option<T> {
    type Out = Option<T::Out>;
    fn together(of: &[&Self]) -> Option<Self::Out> {
        if of.iter().any(|some| some.is_some() != of[0].is_some()) {
            return None;
        }
        let some: Vec<&T> = of.iter().filter_map(|some| some.as_ref()).collect();
        if some.is_empty() {
            return Some(None);
        }
        T::together(&some).map(Some)
    }
}

impl<V, T: Together<V>> Together<V> for Box<T> {
    type Out = Box<T::Out>;
    fn together(of: &[&Self]) -> Option<Self::Out> {
        each(of, |own| &**own).map(Box::new)
    }
}

impl<V, T: Together<V>> Together<V> for (usize, T) {
    type Out = (usize, T::Out);
    fn together(of: &[&Self]) -> Option<Self::Out> {
        let same = of.iter().all(|own| own.0 == of[0].0);
        same.then(|| each(of, |own| &own.1).map(|out| (of[0].0, out)))?
    }
}

impl<V: Constant> Together<V> for Vector3<f64> {
    type Out = Vector3<V>;
    fn together(of: &[&Self]) -> Option<Self::Out> {
        let all: Option<Vec<V>> = (0..3).map(|k| each(of, |own| &own[k])).collect();
        Some(Vector3::from_vec(all?))
    }
}

impl<V: Constant> Together<V> for Matrix3<f64> {
    type Out = Matrix3<V>;
    fn together(of: &[&Self]) -> Option<Self::Out> {
        let all: Option<Vec<V>> = (0..9).map(|k| each(of, |own| &own[k])).collect();
        Some(Matrix3::from_vec(all?))
    }
}

impl<V, A: Together<V>> Together<V> for Acts<A> {
    type Out = Acts<A::Out>;
    fn together(of: &[&Self]) -> Option<Self::Out> {
        let same = of.iter().all(|own| own.index == of[0].index);
        same.then(|| each(of, |own| &own.at).map(|at| Acts { index: of[0].index, at }))?
    }
}

/// A struct: its fields that hold numbers; those that are the same in all; what else has to be, as
/// steps ask it of one of them; and fields that a function of that name makes of all.
macro_rules! parts {
    ($type:ident: $($number:ident),*; $($same:ident),* $(; $ask:expr)* $(=> $($made:ident),*)?) => {
        impl<V: Constant> Together<V> for $type {
            type Out = $type<V>;
            fn together(of: &[&Self]) -> Option<Self::Out> {
                let first = of[0];
                for other in &of[1..] {
                    let same = true $(&& other.$same == first.$same)*;
                    $(let ask: fn(&$type) -> _ = $ask;
                    let same = same && ask(other) == ask(first);)*
                    if !same {
                        return None;
                    }
                }
                Some($type {
                    $($number: each(of, |own| &own.$number)?,)*
                    $($same: first.$same.clone(),)*
                    $($($made: $made(of)?,)*)?
                })
            }
        }
    };
}

parts!(Softness: solref, solimp; ; |soft| soft.solref[0] > 0.0; |soft| impedance_form(&soft.solimp));
parts!(Body: pos, mass, ipos, iquat, inertia, invweight;
    name, parent, weld, tree, quat, joints, dofs, chain, closed, gravcomp, mocap, carried, turns;
    isotropic);
parts!(Joint: pos, range, stiffness, damping, actuatorfrcrange, limit;
    name, kind, body, qpos, dof, axis, margin, reference, actuatorgravcomp);
parts!(Dof: armature, frictionloss, friction, invweight; joint, body, tree, parent, closed, row);
parts!(Tree: mass, plane; bodies, dofs, slides_only, constant, seen, sleep);
parts!(Plane: bodies, joints; normal, first_joint);
parts!(FlatBody: moment, pos, centre; rot, quat);
parts!(FlatGeom: pos; axes, rot);
parts!(FlatJoint: anchor; turns, axis);
parts!(Geom: size, pos, reach, half, in_plane;
    name, body, kind, quat, axis, contype, conaffinity, hull, field, surface, group, hidden,
    collides, by_axis, belt);
parts!(Pair: invweight, mass; geom1, geom2, test, index, slot, dofs, still, apart => material);
parts!(Material: friction, margin, gap, soft, solreffriction, adhesion; condim;
    |own| own.friction.map(|mu| mu > 0.0); |own| own.adhesion > 0.0);
parts!(Tendon: range, margin, springlength, stiffness, damping, armature, frictionloss,
    actuatorfrcrange, limit, friction, length0, arms0, invweight, mass;
    name, course, dofs, closed, arms, used; |own| own.springlength[0] == own.springlength[1]);
parts!(Limited: range, margin, soft, invweight, mass; along, kind, index, sides, dofs);
parts!(Rubbing: most, soft, invweight, mass; along, element, dofs);
parts!(Equality: tie, soft, mass; name, active, dofs);
parts!(Ends: pos, invweight; bodies, quat);
parts!(Coupling: rest, polycoef, invweight; first, second);
parts!(DamperAt: law; first, count);
parts!(SpringAt: law; kind, qpos, dof);
parts!(TendonAt: law; tendon);
parts!(MassAt: mass; body);
parts!(ActuatorAt: ctrlrange, bounds;
    drive, feeds_back, gain_varies, biased, elsewhere);
parts!(Acting: damper, spring, tendon_spring, tendon_damper, compensation, driven_compensation,
    gravity, held; fluid, actuator, joint_force, body_force, left_out, passive, driven);
parts!(Actuator: gear, gain, bias, dynprm, ctrlrange, actrange, forcerange, damping, armature;
    name, target, muscle_gain, muscle_bias, dampratio, controller, orientation, input, feeds,
    dynamics, actearly, lengthrange, delay, nsample, interp, enabled; |own| own.dynprm[2] < 1e-15);
parts!(Model: gears, clamps, gravity, bodies, joints, dofs, trees, geoms, tendons, equalities, actuators, qpos_spring, limited, rubbing, acting, drives;
    name, nq, nv, na, activations, nhistory, histories, along, circles, feeders, linkages, adheres,
    sticks, magnetic, features, mocaps, carried, sites, compensates, fluid, sensors, dynamic_pairs,
    explicit, excludes, keys, qpos0, dof_lists, row_dofs, couples, slots, makers, places;
    |model| model.trees.iter().map(|tree| model.free_ball(tree)).collect::<Vec<_>>()
    => pairs, materials, spheres, body_pairs, guards);

/// Which materials two pairs share may differ from world to world: a pair's own place, by its index in
/// the first of them, until `pairs` finds it.
fn material(of: &[&Pair]) -> Option<usize> {
    Some(of[0].material)
}

/// By pair: its place among the different sets of materials that pairs have in the models; and these.
fn sets(of: &[&Model]) -> (Vec<usize>, Vec<Vec<usize>>) {
    let mut known: Vec<Vec<usize>> = vec![];
    let own = |pair: usize| of.iter().map(|model| model.pairs[pair].material).collect();
    let places = (0..of[0].pairs.len()).map(|pair| {
        let own: Vec<usize> = own(pair);
        known.iter().rposition(|other| *other == own).unwrap_or_else(|| {
            known.push(own);
            known.len() - 1
        })
    });
    (places.collect(), known)
}

fn pairs<V: Constant>(of: &[&Model]) -> Option<Vec<Pair<V>>> {
    let mut pairs = each(of, |model| &model.pairs)?;
    if of.len() > 1 {
        let places = sets(of).0;
        pairs
            .iter_mut()
            .zip(places)
            .for_each(|(pair, place): (&mut Pair<V>, _)| pair.material = place);
    }
    Some(pairs)
}

fn materials<V: Constant>(of: &[&Model]) -> Option<Vec<Material<V>>> {
    if of.len() == 1 {
        return each(of, |model| &model.materials);
    }
    let own = |set: &Vec<usize>| {
        let own = of.iter().zip(set).map(|(model, at)| &model.materials[*at]);
        Material::together(&own.collect::<Vec<_>>())
    };
    sets(of).1.iter().map(own).collect()
}

/// What is apart by the largest distance is apart in all of them.
fn spheres(of: &[&Model]) -> Option<Vec<Spheres>> {
    let list: Vec<&[Spheres]> = of.iter().map(|model| &model.spheres[..]).collect();
    let count = list[0].len();
    let own = |k: usize| largest(list.iter().map(|list| &list[k]));
    list.iter().all(|list| list.len() == count).then(|| (0..count).map(own).collect())?
}

fn body_pairs(of: &[&Model]) -> Option<Vec<BodyPair>> {
    let list: Vec<&[BodyPair]> = of.iter().map(|model| &model.body_pairs[..]).collect();
    let first = list[0];
    let own = |k: usize| {
        let same = |own: &BodyPair| own.pairs == first[k].pairs && own.next == first[k].next;
        let spheres = largest(list.iter().map(|list| &list[k].spheres))?;
        list.iter().all(|list| same(&list[k])).then_some(BodyPair { spheres, ..first[k] })
    };
    let all = || (0..first.len()).map(own).collect();
    list.iter().all(|list| list.len() == first.len()).then(all)?
}

fn largest<'a>(mut all: impl Iterator<Item = &'a Spheres>) -> Option<Spheres> {
    let first = *all.next()?;
    all.try_fold(first, |most, own| {
        let same = (own.geoms, own.apart) == (most.geoms, most.apart);
        same.then_some(Spheres { square: most.square.max(own.square), ..most })
    })
}

/// Within the narrowest bounds the two are apart in all of them.
fn guards(of: &[&Model]) -> Option<Vec<Guard>> {
    let list: Vec<&[Guard]> = of.iter().map(|model| &model.guards[..]).collect();
    let first = list[0];
    let own = |k: usize| {
        list.iter().try_fold(first[k], |most, list| {
            let (low, high) = (most.low.max(list[k].low), most.high.min(list[k].high));
            let same = (list[k].joint, list[k].at) == (most.joint, most.at);
            same.then_some(Guard { low, high, ..most })
        })
    };
    let all = || (0..first.len()).map(own).collect();
    list.iter().all(|list| list.len() == first.len()).then(all)?
}

impl<V: Constant> Together<V> for Tie {
    type Out = Tie<V>;
    fn together(of: &[&Self]) -> Option<Tie<V>> {
        let ends = || {
            let own = |tie: &&'_ Self| match tie {
                Tie::Connect(ends) | Tie::Weld { ends, .. } => Some(ends.clone()),
                Tie::Lengths(_) => None,
            };
            let all: Option<Vec<Ends>> = of.iter().map(own).collect();
            Ends::together(&all?.iter().collect::<Vec<_>>())
        };
        match of[0] {
            Tie::Connect(_) => {
                let same = of.iter().all(|tie| matches!(tie, Tie::Connect(_)));
                same.then(ends)?.map(Tie::Connect)
            }
            Tie::Weld { torquescale, .. } => {
                let own = |tie: &&Self| match tie {
                    Tie::Weld { torquescale: own, .. } => own == torquescale,
                    _ => false,
                };
                let torquescale = *torquescale;
                of.iter().all(own).then(ends)?.map(|ends| Tie::Weld { ends, torquescale })
            }
            Tie::Lengths(_) => {
                let own = |tie: &&Self| match tie {
                    Tie::Lengths(own) => Some(own.clone()),
                    _ => None,
                };
                let all: Option<Vec<Coupling>> = of.iter().map(own).collect();
                Coupling::together(&all?.iter().collect::<Vec<_>>()).map(Tie::Lengths)
            }
        }
    }
}

/// The models of the worlds in lanes: one for all, or one a lane; the last one is that of the lanes that
/// follow, too.
#[derive(Clone)]
pub(crate) enum ByLane {
    One(Arc<Model>),
    Each(Arc<[Arc<Model>]>),
}

impl Deref for ByLane {
    type Target = [Arc<Model>];
    fn deref(&self) -> &[Arc<Model>] {
        match self {
            Self::One(model) => slice::from_ref(model),
            Self::Each(models) => models,
        }
    }
}

/// Shared: counted by whoever made it.
impl Room for ByLane {
    fn room(&self) -> usize {
        0
    }
}

/// The models of worlds that stand side by side, by lane and as one.
#[derive(Clone)]
pub struct SideBySide<R: Real> {
    pub(crate) models: ByLane,
    pub(crate) model: Arc<Model<R::Value>>,
}

room!(SideBySide<R>: models, model);

impl<R: Real> SideBySide<R> {
    /// Refuses those that differ in more than numbers.
    pub fn new(models: Vec<Arc<Model>>) -> Result<Self> {
        match Model::of_worlds(&models) {
            Some(model) => {
                let one = models.iter().all(|own| Arc::ptr_eq(own, &models[0]));
                let models = match one {
                    true => ByLane::One(models[0].clone()),
                    false => ByLane::Each(models.into()),
                };
                Ok(Self { models, model })
            }
            None => {
                let limit =
                    "models that differ in numbers alone, of which none is zero in one only";
                Err(Error::value("models", models.len(), limit))
            }
        }
    }

    /// That of the first world.
    pub(crate) fn first(&self) -> &Arc<Model> {
        &self.models[0]
    }

    /// That of a lane.
    pub(crate) fn of(&self, lane: usize) -> &Arc<Model> {
        &self.models[lane.min(self.models.len() - 1)]
    }

    /// All lanes are worlds of this model.
    pub(crate) fn all_are(&self, model: &Arc<Model>) -> bool {
        self.models.iter().all(|own| Arc::ptr_eq(own, model))
    }
}

/// Two models are the same but for numbers.
pub(crate) fn differ_in_numbers(one: &Arc<Model>, other: &Arc<Model>) -> bool {
    let all = || <Model as Together<f64>>::together(&[one, other]);
    Arc::ptr_eq(one, other) || one.dynamic_pairs.is_none() && all().is_some()
}

impl<V: Constant> Model<V> {
    /// One model as numbers of this kind have it.
    pub fn same(model: &Model) -> Self {
        match Model::together(&[model]) {
            Some(model) => model,
            None => unreachable!("a model is like itself"),
        }
    }

    /// The models of worlds that stand side by side, as one; None where they differ in more than
    /// numbers.
    fn of_worlds(models: &[Arc<Model>]) -> Option<Arc<Self>> {
        let first: Arc<dyn Any + Send + Sync> = models[0].clone();
        if let Ok(plain) = first.downcast::<Self>() {
            return Some(plain);
        }
        if models.iter().all(|model| Arc::ptr_eq(model, &models[0])) {
            return Some(Arc::new(Self::same(&models[0])));
        }
        if models[0].dynamic_pairs.is_some() {
            return None;
        }
        Model::together(&models.iter().map(|model| &**model).collect::<Vec<_>>()).map(Arc::new)
    }
}

impl<V: Constant> Model<V> {
    /// Memory of its longest lists [bytes].
    pub(crate) fn bytes(&self) -> usize {
        let lists = [
            self.bodies.len() * size_of::<Body<V>>(),
            self.joints.len() * size_of::<Joint<V>>(),
            self.dofs.len() * size_of::<Dof<V>>(),
            self.geoms.len() * size_of::<Geom<V>>(),
            self.pairs.len() * size_of::<Pair<V>>(),
            self.materials.len() * size_of::<Material<V>>(),
            self.actuators.len() * size_of::<Actuator<V>>(),
        ];
        size_of::<Self>() + lists.iter().sum::<usize>()
    }

    /// Nothing that is placed once and for all is elsewhere than in another model of this kind.
    pub(crate) fn stands_as(&self, other: &Self) -> bool {
        let constant = self.trees.iter().any(|tree| tree.constant);
        let bodies = self.bodies.iter().zip(&other.bodies).all(|(a, b)| a.pos == b.pos);
        let joints = self.joints.iter().zip(&other.joints).all(|(a, b)| a.pos == b.pos);
        let geoms = self.geoms.iter().zip(&other.geoms).all(|(a, b)| a.pos == b.pos);
        !constant && bodies && joints && geoms
    }
}
