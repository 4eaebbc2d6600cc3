//! The models of several worlds that differ only in numbers. Each number is stored once for all
//! worlds, or once for each.

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
use crate::scene::{Actuator, Muscle, Softness};
use crate::solve::law::impedance_form;

/// A part of a model whose numbers may differ from world to world.
trait Part {
    /// The same part with another number type.
    type In<V: Constant>;
    /// Whether it differs from another only in numbers, none of them zero or infinite in one only.
    fn like(&self, other: &Self) -> bool;
    /// Appends its numbers, always in one order.
    fn list(&self, numbers: &mut Vec<f64>);
    /// The same part with the numbers of all worlds, in that order.
    fn with<V: Constant>(&self, numbers: &mut Numbers) -> Self::In<V>;
}

/// The properties of a number that a step may use without testing every lane.
fn class(x: f64) -> (bool, bool) {
    (x == 0.0, x.is_infinite())
}

/// The numbers of several models, and the data that depends on all of them.
struct Numbers {
    /// One entry for each model.
    lists: Vec<Vec<f64>>,
    /// How many numbers of each model were taken.
    taken: usize,
    /// For each pair: its place among the pairs' distinct sets of materials; and these sets.
    places: Vec<usize>,
    sets: Vec<Vec<usize>>,
    spheres: Vec<Spheres>,
    body_pairs: Vec<BodyPair>,
    guards: Vec<Guard>,
}

impl Numbers {
    /// The next number of each model.
    fn next<V: Constant>(&mut self) -> V {
        let column: Vec<f64> = self.lists.iter().map(|list| list[self.taken]).collect();
        self.taken += 1;
        let same = column.iter().all(|x| x.to_bits() == column[0].to_bits());
        V::by_lane(if same { &column[..1] } else { &column })
    }
}

impl Part for f64 {
    type In<V: Constant> = V;
    fn like(&self, other: &Self) -> bool {
        class(*self) == class(*other)
    }
    fn list(&self, numbers: &mut Vec<f64>) {
        numbers.push(*self);
    }
    fn with<V: Constant>(&self, numbers: &mut Numbers) -> V {
        numbers.next()
    }
}

/// A list of parts of any kind, whose `like` and `list` are the slice's.
macro_rules! list_of_parts {
    () => {
        fn like(&self, other: &Self) -> bool {
            self.len() == other.len() && self.iter().zip(other.iter()).all(|(a, b)| a.like(b))
        }
        fn list(&self, numbers: &mut Vec<f64>) {
            self.iter().for_each(|part| part.list(numbers));
        }
    };
}

impl<T: Part> Part for Vec<T> {
    type In<V: Constant> = Vec<T::In<V>>;
    list_of_parts!();
    fn with<V: Constant>(&self, numbers: &mut Numbers) -> Vec<T::In<V>> {
        let mut all = Vec::with_capacity(self.len());
        for part in self {
            all.push(part.with(numbers));
        }
        all
    }
}

impl<T: Part, const N: usize> Part for [T; N] {
    type In<V: Constant> = [T::In<V>; N];
    list_of_parts!();
    fn with<V: Constant>(&self, numbers: &mut Numbers) -> [T::In<V>; N] {
        self.each_ref().map(|part| part.with(numbers))
    }
}

impl<T: Part> Part for Option<T> {
    type In<V: Constant> = Option<T::In<V>>;
    fn like(&self, other: &Self) -> bool {
        match (self, other) {
            (Some(own), Some(other)) => own.like(other),
            (own, other) => own.is_none() && other.is_none(),
        }
    }
    fn list(&self, numbers: &mut Vec<f64>) {
        self.iter().for_each(|part| part.list(numbers));
    }
    fn with<V: Constant>(&self, numbers: &mut Numbers) -> Option<T::In<V>> {
        self.as_ref().map(|part| part.with(numbers))
    }
}

impl<T: Part> Part for Box<T> {
    type In<V: Constant> = Box<T::In<V>>;
    fn like(&self, other: &Self) -> bool {
        (**self).like(other)
    }
    fn list(&self, numbers: &mut Vec<f64>) {
        (**self).list(numbers);
    }
    fn with<V: Constant>(&self, numbers: &mut Numbers) -> Box<T::In<V>> {
        Box::new((**self).with(numbers))
    }
}

impl<T: Part> Part for (usize, T) {
    type In<V: Constant> = (usize, T::In<V>);
    fn like(&self, other: &Self) -> bool {
        self.0 == other.0 && self.1.like(&other.1)
    }
    fn list(&self, numbers: &mut Vec<f64>) {
        self.1.list(numbers);
    }
    fn with<V: Constant>(&self, numbers: &mut Numbers) -> (usize, T::In<V>) {
        (self.0, self.1.with(numbers))
    }
}

impl Part for Vector3<f64> {
    type In<V: Constant> = Vector3<V>;
    list_of_parts!();
    fn with<V: Constant>(&self, numbers: &mut Numbers) -> Vector3<V> {
        Vector3::from_fn(|_, _| numbers.next())
    }
}

impl Part for Matrix3<f64> {
    type In<V: Constant> = Matrix3<V>;
    list_of_parts!();
    /// Column after column, as they are stored and listed.
    fn with<V: Constant>(&self, numbers: &mut Numbers) -> Matrix3<V> {
        Matrix3::from_fn(|_, _| numbers.next())
    }
}

impl<A: Part> Part for Acts<A> {
    type In<V: Constant> = Acts<A::In<V>>;
    fn like(&self, other: &Self) -> bool {
        self.index == other.index && self.at.like(&other.at)
    }
    fn list(&self, numbers: &mut Vec<f64>) {
        self.at.list(numbers);
    }
    fn with<V: Constant>(&self, numbers: &mut Numbers) -> Acts<A::In<V>> {
        Acts { index: self.index, at: self.at.with(numbers) }
    }
}

/// A struct: its fields that hold numbers; the fields that are equal in all models; the properties
/// that have to be equal, since steps test them in one model; and fields computed from all models.
macro_rules! parts {
    ($type:ident: $($number:ident),*; $($same:ident),* $(; $ask:expr)*
        $(=> $($made:ident: $make:expr),*)?) => {
        impl Part for $type {
            type In<V: Constant> = $type<V>;
            fn like(&self, other: &Self) -> bool {
                true $(&& self.$same == other.$same)*
                    $(&& self.$number.like(&other.$number))*
                    $(&& {
                        let ask: fn(&$type) -> _ = $ask;
                        ask(self) == ask(other)
                    })*
            }
            fn list(&self, numbers: &mut Vec<f64>) {
                $(self.$number.list(numbers);)*
            }
            fn with<V: Constant>(&self, numbers: &mut Numbers) -> $type<V> {
                $type {
                    $($number: self.$number.with(numbers),)*
                    $($same: self.$same.clone(),)*
                    $($($made: $make(self, numbers),)*)?
                }
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
parts!(Pair: invweight, mass; geom1, geom2, test, index, slot, dofs, still, apart
    => material: |pair: &Pair, _: &mut Numbers| pair.material);
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
parts!(Muscle: force; range, scale, lmin, lmax, vmax, fpmax, fvmax);
parts!(Actuator: gear, gain, bias, muscle_gain, muscle_bias, dynprm, ctrlrange, actrange, forcerange,
    lengthrange, damping, armature;
    name, target, dampratio, controller, orientation, input, feeds,
    dynamics, actearly, delay, nsample, interp, enabled; |own| own.dynprm[2] < 1e-15);
parts!(Model: pairs, gears, clamps, gravity, bodies, joints, dofs, trees, geoms, tendons, equalities, actuators, qpos_spring, limited, rubbing, acting, drives;
    name, nq, nv, na, activations, nhistory, histories, along, circles, feeders, linkages, adheres,
    sticks, magnetic, features, mocaps, carried, sites, compensates, fluid, sensors, dynamic_pairs,
    explicit, excludes, keys, qpos0, dof_lists, row_dofs, couples, slots, makers, places;
    |model| model.trees.iter().map(|tree| model.free_ball(tree)).collect::<Vec<_>>()
    => materials: |model: &Model, all: &mut Numbers| {
        let first: Vec<usize> = all.sets.iter().map(|set| set[0]).collect();
        first.into_iter().map(|at| model.materials[at].with(all)).collect()
    }, spheres: |_: &Model, all: &mut Numbers| std::mem::take(&mut all.spheres),
    body_pairs: |_: &Model, all: &mut Numbers| std::mem::take(&mut all.body_pairs),
    guards: |_: &Model, all: &mut Numbers| std::mem::take(&mut all.guards));

/// For each pair: its place among the distinct sets of materials of the models' pairs; and these
/// sets. The materials that two pairs share may differ from world to world.
fn sets(of: &[&Model]) -> (Vec<usize>, Vec<Vec<usize>>) {
    if let [one] = of {
        let own = one.pairs.iter().map(|pair| pair.material).collect();
        return (own, (0..one.materials.len()).map(|at| vec![at]).collect());
    }
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

/// The numbers of models that differ in numbers alone; else None.
fn numbers(of: &[&Model]) -> Option<Numbers> {
    let first = of[0];
    if !of[1..].iter().all(|other| first.like(other)) {
        return None;
    }
    let (places, sets) = sets(of);
    let mut lists = vec![];
    for (nth, model) in of.iter().enumerate() {
        let mut list = vec![];
        model.list(&mut list);
        for set in &sets {
            let own = &model.materials[set[nth]];
            if !first.materials[set[0]].like(own) {
                return None;
            }
            own.list(&mut list);
        }
        lists.push(list);
    }
    let (spheres, body_pairs, guards) = (spheres(of)?, body_pairs(of)?, guards(of)?);
    Some(Numbers { lists, taken: 0, places, sets, spheres, body_pairs, guards })
}

/// Several models as one; None if they differ in more than numbers.
fn together<V: Constant>(of: &[&Model]) -> Option<Model<V>> {
    let mut numbers = numbers(of)?;
    let mut model: Model<V> = of[0].with(&mut numbers);
    for (pair, place) in model.pairs.iter_mut().zip(numbers.places) {
        pair.material = place;
    }
    Some(model)
}

/// Spheres with the largest distance of any model: pairs farther apart are apart in all models.
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

/// The narrowest bounds of any model: within them the two are apart in all models.
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

impl Part for Tie {
    type In<V: Constant> = Tie<V>;
    fn like(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Connect(own), Self::Connect(other)) => own.like(other),
            (Self::Weld { ends, torquescale }, Self::Weld { ends: other, torquescale: scale }) => {
                torquescale == scale && ends.like(other)
            }
            (Self::Lengths(own), Self::Lengths(other)) => own.like(other),
            _ => false,
        }
    }
    fn list(&self, numbers: &mut Vec<f64>) {
        match self {
            Self::Connect(ends) | Self::Weld { ends, .. } => ends.list(numbers),
            Self::Lengths(own) => own.list(numbers),
        }
    }
    fn with<V: Constant>(&self, numbers: &mut Numbers) -> Tie<V> {
        match self {
            Self::Connect(ends) => Tie::Connect(ends.with(numbers)),
            Self::Weld { ends, torquescale } => {
                Tie::Weld { ends: ends.with(numbers), torquescale: *torquescale }
            }
            Self::Lengths(own) => Tie::Lengths(own.with(numbers)),
        }
    }
}

/// The models of the worlds in lanes: one for all lanes, or one for each. The last one also serves
/// the lanes that follow.
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

/// Shared: counted by the owner.
impl Room for ByLane {
    fn room(&self) -> usize {
        0
    }
}

/// The models of the worlds in lanes, by lane and as one.
#[derive(Clone)]
pub struct SideBySide<R: Real> {
    pub(crate) models: ByLane,
    pub(crate) model: Arc<Model<R::Value>>,
}

room!(SideBySide<R>: models, model);

impl<R: Real> SideBySide<R> {
    /// Combines models; refuses those that differ in more than numbers.
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

    /// The model of the first world.
    pub(crate) fn first(&self) -> &Arc<Model> {
        &self.models[0]
    }

    /// The model of a lane.
    pub(crate) fn of(&self, lane: usize) -> &Arc<Model> {
        &self.models[lane.min(self.models.len() - 1)]
    }

    /// Whether all lanes are worlds of this model.
    pub(crate) fn all_are(&self, model: &Arc<Model>) -> bool {
        self.models.iter().all(|own| Arc::ptr_eq(own, model))
    }
}

/// Whether two models differ only in numbers.
pub(crate) fn differ_in_numbers(one: &Arc<Model>, other: &Arc<Model>) -> bool {
    Arc::ptr_eq(one, other) || one.dynamic_pairs.is_none() && numbers(&[one, other]).is_some()
}

impl<V: Constant> Model<V> {
    /// One model in this number type.
    pub fn same(model: &Model) -> Self {
        match together(&[model]) {
            Some(model) => model,
            None => unreachable!("a model is like itself"),
        }
    }

    /// The models of worlds in lanes, as one; None if they differ in more than numbers.
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
        together(&models.iter().map(|model| &**model).collect::<Vec<_>>()).map(Arc::new)
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

    /// Whether everything that is placed only once is in the same place as in another such model.
    pub(crate) fn stands_as(&self, other: &Self) -> bool {
        let constant = self.trees.iter().any(|tree| tree.constant);
        let bodies = self.bodies.iter().zip(&other.bodies).all(|(a, b)| a.pos == b.pos);
        let joints = self.joints.iter().zip(&other.joints).all(|(a, b)| a.pos == b.pos);
        let geoms = self.geoms.iter().zip(&other.geoms).all(|(a, b)| a.pos == b.pos);
        !constant && bodies && joints && geoms
    }
}
