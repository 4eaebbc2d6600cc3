//! Sleep: islands at rest, which a step leaves alone until something touches them.
//!
//! A tree is slow in a step that ends with every dof below `sleep_tolerance`, turning counted by the
//! speed that it gives the farthest point that it moves. An island, that is trees which rows tie
//! together now, falls asleep when all of its trees have been slow for `sleep_time` (MuJoCo 4,
//! "Sleeping islands": the same with 10 steps). Asleep, its velocities are 0, and it stands like a
//! fixed body: it makes no rows, and meets nothing that does not move either.
//!
//! It wakes, as a whole, in the step in which it takes part in a row or in a push with what is awake,
//! in which a force is applied to one of its trees, or in which one has a velocity or other positions
//! than those in which it fell asleep. That step is made as if it had been awake: it starts from the
//! impulses, and the slip of friction that holds, of its last step awake.

use crate::commit::Next;
use crate::model::{Model, Union, NONE};
use crate::real::{Mask, Real};
use crate::room::{listed, room, Room};
use crate::scene::JointType;
use crate::sim::{At, Sim};
use crate::state::{State, Warm};

/// Who sleeps; a part of the state. Empty lists: nobody ever was slow.
#[derive(Clone, Debug, PartialEq)]
pub struct Sleep<R: Real> {
    /// By tree: for how many steps it has been slow.
    pub slow: Vec<u64>,
    /// By tree: the lowest tree of the island with which it sleeps; `NONE` awake.
    pub island: Vec<usize>,
    /// By entry of qpos, where a tree sleeps: its position.
    pub qpos: Vec<R>,
    /// The impulses of each island's last step awake; ascending slots within one.
    pub kept: Vec<(usize, Warm<R>)>,
}

room!(Sleep<R>: slow, island, qpos, kept;);

impl<R: Real> Default for Sleep<R> {
    fn default() -> Self {
        Self::new()
    }
}

impl<R: Real> Sleep<R> {
    /// Nobody sleeps.
    pub fn new() -> Self {
        Self { slow: vec![], island: vec![], qpos: vec![], kept: vec![] }
    }

    /// Someone sleeps.
    pub fn any(&self) -> bool {
        self.island.iter().any(|island| *island != NONE)
    }

    /// Whether a tree sleeps.
    pub fn has(&self, tree: usize) -> bool {
        self.island.get(tree).is_some_and(|island| *island != NONE)
    }

    /// By body: whether it sleeps.
    pub fn bodies(&self, model: &Model) -> Vec<bool> {
        model.bodies.iter().map(|body| self.has(body.tree)).collect()
    }

    pub(crate) fn copy_to(&self, to: &mut Self) {
        to.slow.clone_from(&self.slow);
        to.island.clone_from(&self.island);
        to.qpos.clone_from(&self.qpos);
        to.kept.clone_from(&self.kept);
    }

    /// In other numbers; those of lane 0, as nobody sleeps in lanes.
    pub fn cast<Q: Real>(&self) -> Sleep<Q> {
        let number = |x: R| Q::of(x.lane(0));
        let warm = |w: &Warm<R>| Warm::of(&w.in_lane(0));
        Sleep {
            slow: self.slow.clone(),
            island: self.island.clone(),
            qpos: self.qpos.iter().map(|x| number(*x)).collect(),
            kept: self.kept.iter().map(|(island, w)| (*island, warm(w))).collect(),
        }
    }

    fn fill(&mut self, model: &Model) {
        if self.slow.len() != model.trees.len() {
            *self = Self::new();
            self.slow.resize(model.trees.len(), 0);
            self.island.resize(model.trees.len(), NONE);
            self.qpos.resize(model.nq, R::zero());
        }
    }

    /// Wakes a tree's island; its impulses join `warm`.
    fn wake(&mut self, tree: usize, warm: &mut Vec<Warm<R>>) {
        let woken = self.island[tree];
        for (slow, island) in self.slow.iter_mut().zip(&mut self.island) {
            if *island == woken {
                (*slow, *island) = (0, NONE);
            }
        }
        warm.extend(self.kept.iter().filter(|(island, _)| *island == woken).map(|(_, w)| *w));
        self.kept.retain(|(island, _)| *island != woken);
        warm.sort_unstable_by_key(|w| w.slot);
    }
}

impl<R: Real> State<R> {
    /// Wakes everybody.
    pub fn wake(&mut self) {
        self.warm.extend(self.sleep.kept.drain(..).map(|(_, warm)| warm));
        self.warm.sort_by_key(|warm| warm.slot);
        self.sleep = Sleep::new();
    }
}

/// What does not change of who may sleep, and working space.
#[derive(Default)]
pub(crate) struct Sleeper {
    /// By tree: it has an actuator, whose force may change at any time.
    driven: Vec<bool>,
    /// By dof: how fast the farthest point moves that a unit of its velocity moves.
    length: Vec<f64>,
    /// By tree: its entries of qpos.
    qpos: Vec<[usize; 2]>,
    union: Union,
    /// By island: all of it may sleep.
    ready: Vec<bool>,
}

impl Room for Sleeper {
    fn room(&self) -> usize {
        let lists = listed(&self.driven) + listed(&self.length) + listed(&self.qpos);
        lists + self.union.room() + listed(&self.ready)
    }
}

impl Sleeper {
    pub fn new(model: &Model) -> Self {
        let mut driven = vec![false; model.trees.len()];
        for along in &model.along {
            along.movers(model, |dof| driven[model.dofs[dof].tree] = true);
        }
        let mut qpos = vec![[usize::MAX, 0]; model.trees.len()];
        for joint in &model.joints {
            let [from, to] = &mut qpos[model.bodies[joint.body].tree];
            *from = joint.qpos.min(*from);
            *to = (joint.qpos + joint.kind.positions()).max(*to);
        }
        let length = lengths(model);
        Self { driven, length, qpos, union: Union::default(), ready: vec![] }
    }
}

/// By dof: 1 where it slides; else the distance of the farthest point that it turns, or more [m].
fn lengths(model: &Model) -> Vec<f64> {
    let mut extent: Vec<f64> = (model.bodies.iter())
        .map(|body| {
            let square = 0.5 * body.inertia.trace() / body.mass;
            body.ipos.norm() + if body.mass > 0.0 { square.sqrt() } else { 0.0 }
        })
        .collect();
    for geom in &model.geoms {
        extent[geom.body] = extent[geom.body].max(geom.pos.norm() + geom.reach);
    }
    for (index, body) in model.bodies.iter().enumerate().skip(1).rev() {
        extent[body.parent] = extent[body.parent].max(body.pos.norm() + extent[index]);
    }
    let length = |(k, dof): (usize, &crate::model::Dof)| {
        let joint = &model.joints[dof.joint];
        match joint.kind {
            JointType::Slide => 1.0,
            JointType::Free if k < joint.dof + 3 => 1.0,
            _ => extent[dof.body] + joint.pos.norm(),
        }
    };
    model.dofs.iter().enumerate().map(length).collect()
}

/// The impulses from which rows start.
pub(crate) fn last_impulses<'a, R: Real>(state: &'a State<R>, next: &'a Next<R>) -> &'a [Warm<R>] {
    if next.stage > 0 {
        &next.warm
    } else if next.woken.is_empty() {
        &state.warm
    } else {
        &next.woken
    }
}

impl<R: Real> Sim<R> {
    /// By body: whether it sleeps.
    pub fn asleep(&self) -> Vec<bool> {
        self.state.sleep.bodies(&self.model)
    }

    /// Nobody sleeps under settings without sleep.
    pub(crate) fn wake_where_off(&mut self) {
        if !self.settings.sleep && !self.state.sleep.slow.is_empty() {
            self.state.wake();
        }
    }

    /// Whoever sleeps at the start of this step, into `next`: without those that the user moved.
    pub(crate) fn begin_sleep(&mut self) {
        self.next.woken.clear();
        let Self { model, state, next, inputs, sleeper, .. } = self;
        state.sleep.copy_to(&mut next.sleep);
        // What a mocap body holds or touches may be anything.
        let carried = self.placed.mocap.iter().zip(inputs.mocap()).any(|(old, new)| *old != new);
        for (tree, [from, to]) in sleeper.qpos.iter().enumerate() {
            if !next.sleep.has(tree) {
                continue;
            }
            let mut qvel = state.qvel[model.trees[tree].dofs.range()].iter();
            let moves = qvel.any(|v| !v.is_zero());
            let moved = state.qpos[*from..*to] != next.sleep.qpos[*from..*to];
            if carried || moves || moved || pushed(model, inputs, tree) {
                if next.woken.is_empty() {
                    next.woken.clone_from(&state.warm);
                }
                next.sleep.wake(tree, &mut next.woken);
            }
        }
    }

    /// Trees that sleep where they slept when they were placed last need not be placed again.
    pub(crate) fn rest_asleep(&mut self, at: At) {
        let Self { model, state, next, placed, sleeper, .. } = self;
        let (qpos, qvel) = at.of(state, next);
        let trees = sleeper.qpos.iter().enumerate().map(|(tree, own)| {
            let mut qvel = qvel[model.trees[tree].dofs.range()].iter();
            (next.sleep.has(tree) && qvel.all(|v| v.is_zero()), *own)
        });
        placed.rest(model, qpos, trees);
    }

    /// Sleeping trees do not move, whatever pulls at them.
    pub(crate) fn hold_asleep(&mut self) {
        for (tree, own) in self.model.trees.iter().enumerate() {
            if self.next.sleep.has(tree) {
                self.placed.u[own.dofs.range()].fill(R::zero());
                self.placed.guess[own.dofs.range()].fill(R::zero());
            }
        }
        self.detected.asleep.clear();
        let sleep = &self.next.sleep;
        self.detected.asleep.extend(sleep.island.iter().map(|island| *island != NONE));
    }

    /// Wakes whoever takes part in a row or push that was made; says whether anybody did.
    pub(crate) fn wake_touched(&mut self) -> bool {
        let lists = self.detected.lists.of(&self.model);
        let blocks = self.rows.blocks.iter().filter(|block| block.mask.any());
        let tied = blocks.map(|block| self.rows.rows[block.rows.start].dofs);
        let tied = tied.chain(self.rows.pushes.iter().map(|push| push.dofs));
        let (next, mut woke) = (&mut self.next, false);
        for dofs in tied {
            for &k in dofs.of(lists) {
                let tree = self.model.dofs[k].tree;
                if next.sleep.has(tree) {
                    if next.woken.is_empty() {
                        next.woken.clone_from(&self.state.warm);
                    }
                    next.sleep.wake(tree, &mut next.woken);
                    woke = true;
                }
            }
        }
        woke
    }

    /// The end of a step that is to be committed: who sleeps stays, and who was slow for long
    /// enough falls asleep.
    pub(crate) fn settle(&mut self) {
        let Self { model, state, next, rows, detected, sleeper, settings, inputs, .. } = self;
        let lists = detected.lists.of(model);
        next.sleep.fill(model);
        let Sleeper { driven, length, qpos, union, ready } = sleeper;
        union.reset(model.trees.len());
        let tree_of = |k: usize| model.dofs[k].tree;
        let blocks = rows.blocks.iter().filter(|block| block.mask.any());
        let tied = blocks.map(|block| rows.rows[block.rows.start].dofs);
        for dofs in tied.chain(rows.pushes.iter().map(|push| push.dofs)) {
            for two in dofs.of(lists).windows(2) {
                union.join(tree_of(two[0]), tree_of(two[1]));
            }
        }
        // What pulls at one of its ends when the other moves.
        for tendon in model.tendons.iter().filter(|tendon| tendon.pulls() || tendon.armature > 0.0)
        {
            for two in tendon.dofs.of(&model.dof_lists).windows(2) {
                union.join(tree_of(two[0]), tree_of(two[1]));
            }
        }
        ready.clear();
        ready.resize(model.trees.len(), true);
        for (tree, own) in model.trees.iter().enumerate() {
            if next.sleep.has(tree) {
                let [from, to] = qpos[tree];
                next.qvel[own.dofs.range()].fill(R::zero());
                next.qpos[from..to].copy_from_slice(&state.qpos[from..to]);
                continue;
            }
            let tolerance = R::of(settings.sleep_tolerance);
            let below = |k: usize| (next.qvel[k].abs() * R::of(length[k])).lt(tolerance).all();
            let slow = own.dofs.range().all(below) && !driven[tree] && !pushed(model, inputs, tree);
            let count = &mut next.sleep.slow[tree];
            *count = if slow { *count + 1 } else { 0 };
            ready[union.of(tree)] &= slow && *count as f64 * settings.dt >= settings.sleep_time;
        }
        // Whoever of these falls asleep has no island yet.
        for (tree, own) in model.trees.iter().enumerate() {
            let island = union.of(tree);
            if ready[island] && !next.sleep.has(tree) {
                let [from, to] = qpos[tree];
                next.sleep.island[tree] = island;
                next.qvel[own.dofs.range()].fill(R::zero());
                next.sleep.qpos[from..to].copy_from_slice(&next.qpos[from..to]);
            }
        }
        if settings.keeps() {
            // One for each block, in order.
            let mut blocks = rows.blocks.iter();
            let kept = &mut next.sleep;
            next.warm.retain(|warm| {
                let dofs = blocks.next().map(|block| rows.rows[block.rows.start].dofs.of(lists));
                let Some(k) = dofs.and_then(|dofs| dofs.first()) else { return true };
                let island = kept.island[tree_of(*k)];
                if island != NONE {
                    kept.kept.push((island, *warm));
                }
                island == NONE
            });
        }
    }
}

/// A force is applied to a tree.
fn pushed<R: Real>(model: &Model, inputs: &crate::state::Inputs<R>, tree: usize) -> bool {
    let (dofs, bodies) = (model.trees[tree].dofs.range(), model.trees[tree].bodies.range());
    let acts = |forces: &[R]| forces.iter().any(|force| !force.is_zero());
    let xfrc = 6 * bodies.start..6 * bodies.end;
    inputs.applied() && (acts(&inputs.qfrc_applied()[dofs]) || acts(&inputs.xfrc_applied()[xfrc]))
}
