//! Proofs that ranges keep pairs apart, kept for the next compilation of the same geometry.
//!
//! Measurements compile a robot with other gains, dampings and masses some hundred times, and none
//! of these moves a geom. A question is recognised by all that the proof reads, to the bit, so a
//! recalled proof equals a new one.

use super::lru::Lru;
use super::{Guard, Model};
use crate::pool::lock;
use crate::shapes::height_field::HeightField;
use crate::shapes::hull::Hull;
use std::sync::{Arc, Mutex, Weak};

/// The largest number of words kept for all questions: a few robots with some variants, 2 MB.
const MOST: usize = 1 << 18;

static KEPT: Mutex<Lru<Question, Proof>> =
    Mutex::new(Lru::new(MOST, |question| question.words.len()));

/// For each pair, whether its geoms never meet, and the positions of joints for which that holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Proof {
    pub apart: Vec<bool>,
    pub guards: Vec<Guard>,
}

/// Everything that a proof depends on.
#[derive(Clone)]
pub struct Question {
    words: Vec<u64>,
    /// No other hull can get the address of one of these.
    hulls: Vec<Option<Weak<Hull>>>,
    fields: Vec<Option<Weak<HeightField>>>,
}

impl Question {
    pub fn of(model: &Model) -> Self {
        let features = &model.features;
        let mut words = Words(vec![]);
        words.count(usize::from(features.limit && features.constraint));
        words.numbers(&model.qpos0);
        for body in &model.bodies {
            words.count(body.parent);
            words.count(body.tree);
            words.count(body.joints.start);
            words.count(body.joints.len);
            words.count(usize::from(body.carried));
            words.numbers(body.pos.as_slice());
            words.numbers(&body.quat);
        }
        for joint in &model.joints {
            words.count(joint.kind as usize);
            words.count(joint.body);
            words.count(joint.qpos);
            words.numbers(joint.pos.as_slice());
            words.numbers(joint.axis.as_slice());
            words.count(usize::from(joint.range.is_some()));
            words.numbers(&joint.range.unwrap_or_default());
            words.numbers(&[joint.reference]);
        }
        for geom in &model.geoms {
            words.count(geom.body);
            words.count(geom.kind as usize);
            words.numbers(&geom.size);
            words.numbers(geom.pos.as_slice());
            words.numbers(&geom.quat);
            words.numbers(&geom.half);
            words.numbers(&[geom.reach]);
        }
        for pair in &model.pairs {
            let material = model.material(pair);
            words.count(pair.geom1);
            words.count(pair.geom2);
            words.numbers(&[material.margin, material.gap]);
        }
        Self {
            words: words.0,
            hulls: model.geoms.iter().map(|geom| geom.hull.as_ref().map(Arc::downgrade)).collect(),
            fields: model
                .geoms
                .iter()
                .map(|geom| geom.field.as_ref().map(Arc::downgrade))
                .collect(),
        }
    }

    fn same(&self, other: &Self) -> bool {
        self.words == other.words
            && are_one(&self.hulls, &other.hulls)
            && are_one(&self.fields, &other.fields)
    }
}

/// Equal hulls are one hull where meshes are recalled (`meshes.rs`). Two hulls of equal content
/// count as different here, which costs only a proof.
fn are_one<T>(a: &[Option<Weak<T>>], b: &[Option<Weak<T>>]) -> bool {
    let one = |(x, y): (&Option<Weak<T>>, &Option<Weak<T>>)| match (x, y) {
        (Some(x), Some(y)) => Weak::ptr_eq(x, y),
        (None, None) => true,
        _ => false,
    };
    a.len() == b.len() && a.iter().zip(b).all(one)
}

/// Numbers by their bits.
struct Words(Vec<u64>);

impl Words {
    fn count(&mut self, count: usize) {
        self.0.push(count as u64);
    }

    fn numbers(&mut self, numbers: &[f64]) {
        self.0.extend(numbers.iter().map(|x| x.to_bits()));
    }
}

/// The proof of the same question, if it is still kept.
pub fn recalled(question: &Question) -> Option<Proof> {
    lock(&KEPT).recalled(|other| other.same(question))
}

/// Keeps a proof.
pub fn keep(question: Question, proof: &Proof) {
    lock(&KEPT).keep(question, proof.clone(), Question::same);
}

/// Empties the cache.
pub fn forget() {
    lock(&KEPT).clear();
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Body, Geom, Joint, JointType, Scene};

    /// An arm of two links on a post, whose ranges keep the outer one off the post.
    fn arm() -> Scene {
        let mut scene = Scene::default();
        let size = [0.05; 3];
        scene.geoms.push(Geom { size, ..Geom::default() });
        for (body, x) in [(1, 0.0), (2, 0.5)] {
            let (pos, axis) = ([x, 0.0, 0.0], [0.0, 1.0, 0.0]);
            scene.bodies.push(Body { parent: body - 1, pos, ..Body::default() });
            let range = Some([-0.4, 0.4]);
            let kind = JointType::Hinge;
            scene.joints.push(Joint { body, kind, axis, range, ..Joint::default() });
            scene.geoms.push(Geom { body, size, pos, ..Geom::default() });
        }
        // The inner link is around the post, and has only a mass.
        (scene.geoms[1].contype, scene.geoms[1].conaffinity) = (0, 0);
        scene
    }

    fn question(scene: &Scene) -> Question {
        Question::of(&Model::compile(scene).unwrap())
    }

    #[test]
    fn what_moves_no_geom_is_the_same_question() {
        let (first, mut scene) = (question(&arm()), arm());
        scene.joints[0].damping = [3.0, 0.0, 0.0];
        scene.joints[1].armature = 0.5;
        assert!(first.same(&question(&scene)));
        let (one, two) = (Model::compile(&arm()).unwrap(), Model::compile(&scene).unwrap());
        assert!(one.pairs[0].apart && two.pairs[0].apart);
        assert_eq!((one.guards.len(), &one.guards), (2, &two.guards));
    }

    #[test]
    fn any_other_bit_is_another_question() {
        let first = question(&arm());
        let next = |x: f64| f64::from_bits(x.to_bits() + 1);
        type Change = fn(&mut Scene, &dyn Fn(f64) -> f64);
        let changes: [Change; 6] = [
            |s, next| s.joints[0].range = Some([-0.4, next(0.4)]),
            |s, next| s.joints[1].pos[2] = next(0.0),
            |s, next| s.bodies[2].pos[0] = next(0.5),
            |s, next| s.geoms[0].size = [next(0.05); 3],
            |s, next| s.geoms[2].pos[0] = next(0.5),
            |s, next| s.geoms[2].margin = next(0.0),
        ];
        for change in changes {
            let mut scene = arm();
            change(&mut scene, &next);
            assert!(!first.same(&question(&scene)));
        }
        let mut scene = arm();
        scene.features.limit = false;
        assert!(!first.same(&question(&scene)));
    }
}
