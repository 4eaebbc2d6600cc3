//! Sleep: islands at rest, which a step skips until something touches them.
//!
//! The rule is MuJoCo 4's ("Sleeping islands"). A tree is slow in a step that starts with every dof
//! below `sleep_tolerance`, rotations times a length of the body. An island, the trees that rows
//! tie together now, falls asleep when all its trees have been slow for `sleep_time` (MuJoCo: for
//! 10 steps) and may sleep. It then stays where that step started, its velocities are 0, and it
//! acts as a fixed body: it makes no rows, and meets nothing that does not move either.
//!
//! It wakes, as a whole, in a step in which it takes part in a row or a push with something awake
//! (mocap bodies always are), in which a force is applied to one of its trees, or in which one has
//! a velocity or positions other than it fell asleep in. That step is made as if it had been awake:
//! it starts from the impulses, and the slip of sticking friction, of its last step awake.

mod trees;

pub(crate) use trees::Sleeper;

use crate::commit::Next;
use crate::error::Result;
use crate::model::{Model, Tie, Tree, NONE};
use crate::real::{Constant, Mask, Real};
use crate::scene::SleepPolicy;
use crate::sim::{At, Effort, Sim};
use crate::state::State;
use crate::warm::{Sleep, Warm};
use std::sync::Arc;

impl<R: Real> Sleep<R> {
    /// For each body: whether it sleeps.
    pub fn bodies(&self, model: &Model<R::Value>) -> Vec<bool> {
        model.bodies.iter().map(|body| self.has(body.tree)).collect()
    }

    fn fill(&mut self, model: &Model<R::Value>) {
        if self.slow.len() != model.trees.len() {
            *self = Self::new();
            self.slow.resize(model.trees.len(), 0);
            self.island.resize(model.trees.len(), NONE);
            self.qpos.resize(model.nq, R::zero());
        }
    }

    /// Wakes a tree's island, slow for this many steps; its impulses join `warm`.
    fn wake(&mut self, tree: usize, steps: u64, warm: &mut Vec<Warm<R>>) {
        let woken = self.island[tree];
        for (slow, island) in self.slow.iter_mut().zip(&mut self.island) {
            if *island == woken {
                (*slow, *island) = (steps, NONE);
            }
        }
        warm.extend(self.kept.iter().filter(|(island, _)| *island == woken).map(|(_, w)| *w));
        self.kept.retain(|(island, _)| *island != woken);
        warm.sort_unstable_by_key(|w| w.slot);
    }
}

impl<R: Real> State<R> {
    /// Wakes all trees.
    pub fn wake(&mut self) {
        self.warm.extend(self.sleep.kept.drain(..).map(|(_, warm)| warm));
        self.warm.sort_by_key(|warm| warm.slot);
        self.sleep = Sleep::new();
    }
}

impl<R: Real> Sim<R> {
    /// For each body: whether it sleeps.
    pub fn asleep(&self) -> Vec<bool> {
        self.state.sleep.bodies(&self.model)
    }

    /// Wakes all trees under settings without sleep.
    pub(crate) fn wake_where_off(&mut self) {
        if !self.plan.sleeps && !self.state.sleep.slow.is_empty() {
            self.state.wake();
        }
    }

    /// Finds the trees that sleep in a new world: the islands of trees that are to sleep from the
    /// start. Islands that touch others are awake.
    pub(crate) fn sleep_from_start(&mut self) -> Result<()> {
        let starts = |tree: &Tree<R::Value>| tree.sleep == SleepPolicy::Init;
        if !self.plan.sleeps || !self.model.trees.iter().any(starts) {
            return Ok(());
        }
        self.place_and_make_rows(At::State)?;
        let model = self.model.clone();
        let slow = model.trees.iter().map(|tree| if starts(tree) { u64::MAX } else { 0 });
        self.next.sleep.fill(&model);
        self.next.sleep.slow.clear();
        self.next.sleep.slow.extend(slow);
        self.settle();
        for (tree, slow) in model.trees.iter().zip(&mut self.next.sleep.slow) {
            *slow = if starts(tree) { 0 } else { *slow };
        }
        let sleep = std::mem::take(&mut self.next.sleep);
        self.state.sleep = sleep.clone();
        self.sleeper.initial = Arc::new(sleep);
        self.placed.place_all();
        self.clear_solve();
        self.effort = Effort::default();
        Ok(())
    }

    /// The sleeping trees of a new world.
    pub fn initial_sleep(&self) -> &Arc<Sleep<R>> {
        &self.sleeper.initial
    }

    /// Writes the trees that sleep at the start of this step into `next`: without those that the
    /// user moved, and those that an equality ties to awake trees, or to others that sleep.
    pub(crate) fn begin_sleep(&mut self) {
        self.next.woken.clear();
        let Self { model, state, next, inputs, sleeper, .. } = self;
        state.sleep.copy_to(&mut next.sleep);
        next.sleep.fill(model);
        if !next.sleep.any() {
            return;
        }
        for (tree, [from, to]) in sleeper.qpos.iter().enumerate() {
            let mut qvel = state.qvel[model.trees[tree].dofs.range()].iter();
            let moves = qvel.any(|v| !v.is_zero());
            let moved = state.qpos[*from..*to] != next.sleep.qpos[*from..*to];
            if next.sleep.has(tree) && (moves || moved || pushed(model, inputs, tree)) {
                next.wake(tree, 0, &state.warm);
            }
        }
        for (index, equality) in model.equalities.iter().enumerate() {
            if !model.features.equality || inputs.eq_active(index).none() {
                continue;
            }
            let carried = match &equality.tie {
                Tie::Connect(ends) | Tie::Weld { ends, .. } => {
                    ends.bodies.iter().any(|body| model.is_mocap(*body))
                }
                Tie::Lengths(_) => false,
            };
            let trees = || equality.dofs.of(&model.dof_lists).iter().map(|k| model.dofs[*k].tree);
            let mut islands = trees().map(|tree| next.sleep.island[tree]);
            let first = islands.next();
            if carried || islands.any(|island| Some(island) != first) {
                for tree in trees() {
                    if next.sleep.has(tree) {
                        next.wake(tree, 0, &state.warm);
                    }
                }
            }
        }
    }

    /// Skips the placement of trees that slept in the same place at the last placement.
    pub(crate) fn rest_asleep(&mut self, at: At) {
        let Self { model, state, next, placed, sleeper, .. } = self;
        let (qpos, qvel) = at.of(state, next);
        let trees = sleeper.qpos.iter().enumerate().map(|(tree, own)| {
            let mut qvel = qvel[model.trees[tree].dofs.range()].iter();
            (next.sleep.has(tree) && qvel.all(|v| v.is_zero()), *own)
        });
        placed.rest(model, qpos, trees);
    }

    /// Keeps sleeping trees at rest, whatever pulls at them.
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

    /// Wakes the trees that take part in a new row or push, slow for as long as the trees they
    /// meet. Returns whether any woke.
    pub(crate) fn wake_touched(&mut self) -> bool {
        let Self { model, state, next, detected, rows, .. } = self;
        let lists = detected.lists.of(model);
        let slept = |tree: usize| detected.asleep.get(tree).is_some_and(|asleep| *asleep);
        let blocks = rows.blocks.iter().filter(|block| block.mask.any());
        let tied = blocks.map(|block| rows.rows[block.rows.start].dofs);
        let mut woke = false;
        for dofs in tied.chain(rows.pushes.iter().map(|push| push.dofs)) {
            let trees = || dofs.of(lists).iter().map(|k| model.dofs[*k].tree);
            if !trees().any(slept) {
                continue;
            }
            let waker = trees().filter(|tree| !slept(*tree)).map(|tree| next.sleep.slow[tree]);
            let steps = waker.min().unwrap_or(0);
            for tree in trees().filter(|tree| slept(*tree)) {
                if next.sleep.has(tree) {
                    next.wake(tree, steps, &state.warm);
                    woke = true;
                } else {
                    // It was woken by others, which may have been slow for longer.
                    next.sleep.slow[tree] = next.sleep.slow[tree].min(steps);
                }
            }
        }
        woke
    }

    /// Ends a step that is to be committed: sleeping trees stay, and trees that had been slow for
    /// long enough at its start fall asleep there.
    pub(crate) fn settle(&mut self) {
        let Self { model, state, next, rows, detected, sleeper, settings, plan, inputs, .. } = self;
        let lists = detected.lists.of(model);
        next.sleep.fill(model);
        let Sleeper { never, length, qpos, union, ready, .. } = sleeper;
        union.reset(model.trees.len());
        let tree_of = |k: usize| model.dofs[k].tree;
        let blocks = rows.blocks.iter().filter(|block| block.mask.any());
        let tied = blocks.map(|block| rows.rows[block.rows.start].dofs);
        for dofs in tied.chain(rows.pushes.iter().map(|push| push.dofs)) {
            for two in dofs.of(lists).windows(2) {
                union.join(tree_of(two[0]), tree_of(two[1]));
            }
        }
        // A tendon that pulls at one of its ends when the other moves.
        for tendon in
            model.tendons.iter().filter(|tendon| tendon.pulls() || !tendon.armature.vanishes())
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
            let below = |k: usize| {
                let v = state.qvel[k];
                v.is_zero() || (v.abs() * R::of(length[k])).lt(tolerance).all()
            };
            let slow = own.dofs.range().all(below) && !never[tree] && !pushed(model, inputs, tree);
            let count = &mut next.sleep.slow[tree];
            *count = if slow { count.saturating_add(1) } else { 0 };
            ready[union.of(tree)] &= slow && *count as f64 * settings.dt >= settings.sleep_time;
        }
        // The trees among these that fall asleep have no island yet.
        for (tree, own) in model.trees.iter().enumerate() {
            let island = union.of(tree);
            if ready[island] && !next.sleep.has(tree) {
                let [from, to] = qpos[tree];
                next.sleep.island[tree] = island;
                next.qvel[own.dofs.range()].fill(R::zero());
                next.qpos[from..to].copy_from_slice(&state.qpos[from..to]);
                next.sleep.qpos[from..to].copy_from_slice(&state.qpos[from..to]);
            }
        }
        // Elements that pull only at trees that slept all along are at rest with them.
        let slept = |dof: usize| detected.asleep[tree_of(dof)];
        if model.na > 0 && detected.asleep.contains(&true) {
            for (along, states) in model.along.iter().zip(&model.activations) {
                let mut rests = true;
                along.movers(model, |dof| rests &= slept(dof));
                if rests {
                    next.act[states.range()].copy_from_slice(&state.act[states.range()]);
                }
            }
        }
        if plan.keeps {
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

impl<R: Real> Next<R> {
    /// Wakes a tree's island, slow for this many steps; `warm`: the impulses of the awake trees.
    fn wake(&mut self, tree: usize, steps: u64, warm: &[Warm<R>]) {
        if self.woken.is_empty() {
            self.woken.extend_from_slice(warm);
        }
        self.sleep.wake(tree, steps, &mut self.woken);
    }
}

/// Whether a force is applied to a tree.
fn pushed<R: Real>(model: &Model<R::Value>, inputs: &crate::state::Inputs<R>, tree: usize) -> bool {
    let (dofs, bodies) = (model.trees[tree].dofs.range(), model.trees[tree].bodies.range());
    let acts = |forces: &[R]| forces.iter().any(|force| !force.is_zero());
    let xfrc = 6 * bodies.start..6 * bodies.end;
    inputs.applied() && (acts(&inputs.qfrc_applied()[dofs]) || acts(&inputs.xfrc_applied()[xfrc]))
}
