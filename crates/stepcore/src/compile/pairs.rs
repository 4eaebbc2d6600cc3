//! Pairs that machine code does not test (`compile/`).
//!
//! A step that is written down has the contacts that are likely, each with its rows: of shapes with tests by
//! formula, against what stands still first, up to so many. Others are asked of the stages where they are near: pairs
//! whose tests go lane by lane (`shapes/by_lane.rs`), and those of a robot's links that hardly ever meet.
//! Where such a pair touches, the whole step is left to the stages.

use super::handed::{Handed, HandedList, HandedPairs};
use super::memory::Aligned;
use crate::detect::{Detected, Elsewhere};
use crate::model::{Model, NONE};
use crate::pool::lock;
use crate::real::traced::{Recorder, Traced, TracedMask};
use crate::real::{Constant, Mask, Real};
use crate::spatial::{Pose, M3, V3};

/// The most contacts that code has rows for.
const MOST: usize = 64;

/// Takes pairs aside while a step is written down.
pub(crate) struct TakesAside {
    /// By pair.
    aside: Vec<bool>,
    noted: HandedPairs,
    handed: HandedList,
}

impl TakesAside {
    /// None where every pair is tested in place.
    pub fn of<N: Constant>(model: &Model<N>, handed: HandedList) -> Option<Self> {
        let stands = |geom: usize| model.bodies[model.geoms[geom].body].tree == NONE;
        let order = |index: &usize| {
            let pair = &model.pairs[*index];
            let stands = stands(pair.geom1) || stands(pair.geom2);
            (pair.test.by_lane(), !stands, pair.test.most_touches())
        };
        let mut pairs: Vec<usize> = (0..model.pairs.len()).collect();
        pairs.sort_by_key(order);
        let mut aside = vec![false; model.pairs.len()];
        let mut touches = 0;
        for index in pairs {
            let test = model.pairs[index].test;
            touches += test.most_touches();
            aside[index] = test.by_lane() || touches > MOST;
        }
        let noted = HandedPairs::default();
        aside.contains(&true).then_some(Self { aside, noted, handed })
    }
}

impl Elsewhere<Traced> for TakesAside {
    fn takes(&self, pair: usize) -> bool {
        self.aside[pair]
    }

    fn note(&mut self, pair: usize, near: TracedMask, geoms: [usize; 2], poses: &[Pose<Traced>]) {
        if near == TracedMask::Known(false) {
            return;
        }
        self.noted.pairs.push((pair, near.handed()));
        for geom in geoms {
            if self.noted.geoms.iter().any(|(own, _)| *own == geom) {
                continue;
            }
            let number = |x: Traced| x.handed(TracedMask::Known(true));
            let Pose { pos, rot } = &poses[geom];
            self.noted.geoms.push((geom, Pose { pos: pos.map(number), rot: rot.map(number) }));
        }
    }

    fn meet(&mut self) {
        let noted = std::mem::take(&mut self.noted);
        if !noted.pairs.is_empty() {
            Recorder::cut();
            lock(&self.handed).push(Handed::Pairs(Box::new(noted)));
        }
    }
}

/// Tests the pairs that code asks about.
pub(crate) struct Meeting<R: Real> {
    detected: Option<Detected<R>>,
    poses: Vec<Pose<R>>,
}

room!(Meeting<R>: detected, poses);

impl<R: Real> Meeting<R> {
    pub fn new() -> Self {
        Self { detected: None, poses: vec![] }
    }

    /// None of them touches in any lane.
    pub fn none(
        &mut self,
        handed: &HandedPairs,
        model: &Model<R::Value>,
        memory: &Aligned,
    ) -> bool {
        let Self { detected, poses } = self;
        let detected = detected.get_or_insert_with(|| Detected::new(model, 0));
        poses.resize(model.geoms.len(), Pose { pos: V3::zeros(), rot: M3::identity() });
        detected.contacts.clear();
        let mut there = false;
        for (pair, near) in &handed.pairs {
            if memory.lanes::<R>(*near).none() {
                continue;
            }
            if !std::mem::replace(&mut there, true) {
                for (geom, from) in &handed.geoms {
                    let to = &mut poses[*geom];
                    let all = to.pos.iter_mut().chain(to.rot.iter_mut());
                    from.pos
                        .iter()
                        .chain(&from.rot)
                        .zip(all)
                        .for_each(|(x, to)| memory.read(*x, to));
                }
            }
            detected.meet_fixed(model, poses, &model.pairs[*pair], false);
            if !detected.contacts.is_empty() {
                return false;
            }
        }
        true
    }
}
