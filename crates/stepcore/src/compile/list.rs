//! What a step computes, as a list with loops; and which of its entries anybody needs.

use std::collections::HashMap;

use crate::real::traced::{Arg, Loop, Node, Op};

/// A step: what its entries do, what it leaves, and where it is right.
#[derive(Clone, Debug, Default)]
pub(crate) struct List {
    pub nodes: Vec<Node>,
    pub loops: Vec<Loop>,
    /// What it leaves, by place in the state; and the size up to which the list is right for that.
    pub wanted: Vec<(Arg, f64)>,
    /// By place: the mask without which nobody reads what it leaves there.
    pub under: HashMap<usize, u32>,
    /// Masks that hold in no lane of a step that the list is right for.
    pub assumed: Vec<u32>,
    /// By entry that hands a number over: the masks without all of which nobody reads it.
    pub puts: HashMap<u32, Vec<u32>>,
    /// Entries before which somebody else works, with what was handed over.
    pub cuts: Vec<usize>,
}

/// The loops around a section of the list, from outside in.
pub(super) type Path = Vec<usize>;

impl List {
    /// How many numbers the state has: what is read of it, and what is left.
    pub fn places(&self) -> usize {
        let read = self.nodes.iter().filter_map(|node| match node.op {
            Op::Input(place) | Op::Put(place) => Some(place as usize + 1),
            _ => None,
        });
        read.max().unwrap_or(0).max(self.wanted.len())
    }

    /// By entry: the innermost loop whose turns execute it.
    pub fn loop_of(&self) -> Vec<Option<usize>> {
        let mut own = vec![None; self.nodes.len()];
        // Loops inside begin later.
        for (index, inside) in self.loops.iter().enumerate() {
            own[inside.entries.clone()].fill(Some(index));
        }
        for (own, node) in own.iter_mut().zip(&self.nodes) {
            if let Op::Input(_) = node.op {
                *own = None;
            }
        }
        own
    }

    /// By loop: the loop around it.
    pub fn parents(&self) -> Vec<Option<usize>> {
        let around = |index: usize| {
            let own = &self.loops[index].entries;
            (0..index).rev().find(|outer| {
                let outer = &self.loops[*outer].entries;
                outer.start <= own.start && own.end <= outer.end
            })
        };
        (0..self.loops.len()).map(around).collect()
    }

    /// By entry that stands for what a loop changes: the loop, and the other one of its two entries.
    pub fn partners(&self) -> Vec<Option<(usize, u32)>> {
        let mut partners = vec![None; self.nodes.len()];
        for (index, own) in self.loops.iter().enumerate() {
            for (enter, leave) in &own.changed {
                partners[*enter as usize] = Some((index, *leave));
                partners[*leave as usize] = Some((index, *enter));
            }
        }
        partners
    }

    /// Entries that what is left, or what must not hold, depends on.
    pub fn used(&self, choices: &Choices) -> Vec<bool> {
        let partners = self.partners();
        let loops = self.loop_of();
        let mut used = vec![false; self.nodes.len()];
        let mut asked = vec![false; self.loops.len()];
        let wanted = self.wanted.iter().filter_map(|(arg, _)| choices.of(*arg).node());
        let others = self.assumed.iter().chain(self.puts.keys()).chain(self.under.values());
        let mut left: Vec<u32> = wanted.chain(others.copied()).collect();
        let parents = self.parents();
        while let Some(node) = left.pop() {
            let at = node as usize;
            if std::mem::replace(&mut used[at], true) {
                continue;
            }
            left.extend(self.nodes[at].args.iter().filter_map(|arg| choices.of(*arg).node()));
            left.extend(partners[at].map(|(_, other)| other));
            // A loop that runs needs to know how long.
            let mut around = partners[at].map(|(own, _)| own).or(loops[at]);
            while let Some(own) = around {
                if !std::mem::replace(&mut asked[own], true) {
                    let Loop { changed, live, .. } = &self.loops[own];
                    left.extend([changed[*live].0, changed[*live].1]);
                }
                around = parents[own];
            }
        }
        used
    }

    /// Whether an entry outside a loop reads one of its turns, which it cannot.
    pub fn leaks(&self) -> bool {
        let loops = self.loop_of();
        let parents = self.parents();
        let partners = self.partners();
        let within = |mut inner: Option<usize>, outer: usize| loop {
            match inner {
                Some(own) if own == outer => return true,
                Some(own) => inner = parents[own],
                None => return false,
            }
        };
        let nodes = self.nodes.iter().enumerate();
        let read =
            nodes.flat_map(|(at, node)| node.args.iter().map(move |arg| (at, node.op, *arg)));
        let inside = read.filter_map(|(at, op, arg)| Some((at, op, loops[arg.node()? as usize]?)));
        inside.into_iter().any(|(at, op, own)| {
            let reader = if op.leaves() { partners[at].map(|(own, _)| own) } else { loops[at] };
            !within(reader, own)
        }) || self.assumed.iter().any(|mask| loops[*mask as usize].is_some())
            || self
                .wanted
                .iter()
                .any(|(arg, _)| arg.node().is_some_and(|node| loops[node as usize].is_some()))
    }
}

/// Choices that are made: where an entry matters a mask holds that it asks.
#[derive(Default)]
pub(crate) struct Choices(pub HashMap<u32, Arg>);

impl Choices {
    pub fn of(&self, mut arg: Arg) -> Arg {
        while let Some(other) = arg.node().and_then(|node| self.0.get(&node)) {
            arg = *other;
        }
        arg
    }
}
