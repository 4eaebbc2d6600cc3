//! Sleeping trees stay as they were placed: all placed quantities of a tree follow from its positions
//! and velocities, which are then the same in every step.

use super::Placed;
use crate::model::Model;
use crate::real::Real;

/// The trees that were placed asleep.
pub(super) struct Resting<R: Real> {
    /// By tree: it slept, without velocities, when last placed; by entry of qpos its position then.
    asleep: Vec<bool>,
    qpos: Vec<R>,
    /// By tree: the next placing may skip it. Empty: it places all.
    skipped: Vec<bool>,
}

room!(Resting<R>: asleep, qpos, skipped);

impl<R: Real> Resting<R> {
    pub fn new() -> Self {
        Self { asleep: vec![], qpos: vec![], skipped: vec![] }
    }

    #[inline(always)]
    pub fn skips(&self, tree: usize) -> bool {
        self.skipped.get(tree).is_some_and(|skipped| *skipped)
    }

    /// Forgets the sleeping trees, as others are placed or will be.
    pub fn forget(&mut self) {
        self.asleep.clear();
        self.skipped.clear();
    }

    /// Starts a placing.
    pub fn begin(&mut self) {
        if self.skipped.is_empty() {
            self.forget();
        }
    }

    /// Ends a placing.
    pub fn end(&mut self) {
        self.skipped.clear();
    }
}

impl<R: Real> Placed<R> {
    /// Prepares a placing: by tree whether it sleeps and has no velocities, and its entries of qpos.
    pub(crate) fn rest(
        &mut self,
        model: &Model<R::Value>,
        qpos: &[R],
        trees: impl Iterator<Item = (bool, [usize; 2])>,
    ) {
        // Tendon armature and the metric's spring and damper terms are added tree by tree.
        if self.effective.is_some() || !model.tendons.is_empty() {
            return;
        }
        let Resting { asleep, qpos: last, skipped } = &mut self.resting;
        asleep.resize(model.trees.len(), false);
        last.resize(model.nq, R::zero());
        skipped.clear();
        for (tree, (sleeps, [from, to])) in trees.enumerate() {
            if sleeps {
                let (own, last) = (&qpos[from..to], &mut last[from..to]);
                skipped.push(asleep[tree] && own == last);
                last.copy_from_slice(own);
            } else {
                skipped.push(false);
            }
            asleep[tree] = sleeps;
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::model::Model;
    use crate::scene::{Body, Geom, GeomType, Joint, JointType, Scene};
    use crate::settings::Settings;
    use crate::sim::Sim;
    use std::sync::Arc;

    /// Balls, one of which falls on two at rest.
    fn balls() -> Scene {
        let mut scene = Scene::default();
        let plane = Geom { kind: GeomType::Plane, ..Geom::default() };
        scene.geoms.push(plane);
        for (x, z) in [(0.0, 0.1), (0.3, 0.1), (0.05, 3.0)] {
            scene.bodies.push(Body { pos: [x, 0.0, z], ..Body::default() });
            let body = scene.bodies.len() - 1;
            scene.joints.push(Joint { body, kind: JointType::Free, ..Joint::default() });
            let pos = [0.0, 0.0, 0.01];
            scene.geoms.push(Geom { body, size: [0.1, 0.0, 0.0], pos, ..Geom::default() });
        }
        scene
    }

    /// Steps and all placed quantities equal a world's whose trees are all placed in each step: while
    /// some sleep, when one is touched, and after a snapshot.
    #[test]
    fn who_sleeps_stays_as_placed() {
        let model = Arc::new(Model::compile(&balls()).unwrap());
        let settings = Settings { sleep: true, sleep_time: 0.1, ..Settings::default() };
        let mut sims = [0; 2].map(|_| Sim::<f64>::new(model.clone(), settings.clone()).unwrap());
        let (mut skipped, mut kept) = (0, None);
        for step in 0..900 {
            if step == 200 {
                kept = Some(sims[0].state.clone());
            }
            if step == 800 {
                // Positions that differ from the last placed ones.
                for sim in &mut sims {
                    sim.state = kept.clone().unwrap();
                }
            }
            sims[1].placed.place_all();
            for sim in &mut sims {
                sim.step(1).unwrap();
            }
            let [one, all] = &sims;
            skipped += one.placed.resting.asleep.iter().filter(|asleep| **asleep).count();
            assert_eq!(one.state, all.state, "step {step}");
            let (a, b) = (&one.placed, &all.placed);
            assert_eq!((&a.xpos, &a.xmat, &a.motion), (&b.xpos, &b.xmat, &b.motion));
            assert_eq!((&a.mass, &a.bias, &a.force), (&b.mass, &b.bias, &b.force));
            assert_eq!((&a.u, &a.guess, &a.metric.inv_d), (&b.u, &b.guess, &b.metric.inv_d));
        }
        assert!(skipped > 300, "{skipped}");
        let still = sims[0].state.sleep.island.iter().filter(|i| **i != crate::model::NONE).count();
        assert!(still < 3, "the ball that fell wakes those that it touches");
    }
}
