//! Contacts of two geoms at many poses, as a step's test of the pair finds them.

use crate::error::{Error, Result};
use crate::model::Model;
use crate::place::Placed;
use crate::real::{Mask, Real};
use crate::shapes::{self, ShapeTest};

/// Contacts by pose, then by slot.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PosedTouches {
    /// Slots of a pose.
    pub slots: usize,
    /// The slot has a contact, whatever the distance of the two.
    pub exists: Vec<bool>,
    /// Signed distance [m], negative = overlap.
    pub dist: Vec<f64>,
    /// Halfway between the surfaces.
    pub pos: Vec<[f64; 3]>,
    /// Unit, from the first geom to the second.
    pub normal: Vec<[f64; 3]>,
    /// See `shapes::Touch::feature`.
    pub feature: Vec<f64>,
}

impl Model {
    /// Finds the contacts of two geoms at positions `qpos`, `poses` times nq numbers, in any order of
    /// the two and whether or not a step lets them meet.
    pub fn touches<R: Real>(
        &self,
        geom1: usize,
        geom2: usize,
        poses: usize,
        qpos: &[f64],
    ) -> Result<PosedTouches> {
        // A step's order: by type, then by body.
        let rank = |geom: usize| (self.geoms[geom].kind, self.geoms[geom].body, geom);
        let swapped = rank(geom1) > rank(geom2);
        let (first, second) = if swapped { (geom2, geom1) } else { (geom1, geom2) };
        let (one, two) = (&self.geoms[first], &self.geoms[second]);
        let Some(test) = ShapeTest::of(one.kind, two.kind) else {
            let limit = format!("a pair that is built: {}", ShapeTest::built());
            let pair = format!("{}-{}", one.kind.word(), two.kind.word());
            return Err(Error::value("geom1, geom2", pair, limit));
        };
        let model = Model::<R::Value>::same(self);
        let mut found = PosedTouches::room(poses, test.most_touches());
        let mut placed = Placed::<R>::new(&model);
        let (bodies, geoms) = (self.chain_of([one.body, two.body]), [first, second]);
        let mut q = vec![R::zero(); self.nq];
        for start in (0..poses).step_by(R::LANES) {
            for lane in 0..R::LANES {
                // Lanes without a pose repeat the last one.
                let from = (start + lane).min(poses - 1) * self.nq;
                q.iter_mut().zip(&qpos[from..]).for_each(|(q, given)| q.set_lane(lane, *given));
            }
            placed.place_some(&model, &q, &bodies, &geoms);
            let (p1, p2) = (&placed.geom[first], &placed.geom[second]);
            let (a, b) = (model.geoms[first].shape(p1), model.geoms[second].shape(p2));
            shapes::meet(test, &a, &b, (|_| f64::INFINITY, &[]), |slot, touch| {
                for lane in 0..R::LANES.min(poses - start) {
                    let at = (start + lane) * found.slots + slot;
                    let normal: [f64; 3] = touch.normal.map(|x| x.lane(lane)).into();
                    found.exists[at] = touch.exists.lane(lane);
                    found.dist[at] = touch.dist.lane(lane);
                    found.pos[at] = touch.pos.map(|x| x.lane(lane)).into();
                    found.normal[at] = if swapped { normal.map(|x| -x) } else { normal };
                    found.feature[at] = touch.feature.lane(lane);
                }
            });
        }
        Ok(found)
    }

    /// Bodies and all that carry them, each after its parent.
    fn chain_of(&self, ends: [usize; 2]) -> Vec<usize> {
        let mut chain = vec![];
        for end in ends {
            let mut body = end;
            while body != 0 && !chain.contains(&body) {
                chain.push(body);
                body = self.bodies[body].parent;
            }
        }
        chain.sort_unstable();
        chain
    }
}

impl PosedTouches {
    fn room(poses: usize, slots: usize) -> Self {
        let n = poses * slots;
        Self {
            slots,
            exists: vec![false; n],
            dist: vec![f64::INFINITY; n],
            pos: vec![[f64::NAN; 3]; n],
            normal: vec![[f64::NAN; 3]; n],
            feature: vec![0.0; n],
        }
    }
}
