//! Where numbers lie in memory between the regions that make and read them.
//!
//! A number and what takes its place, as the sum that goes on behind a guard or what a turn of a loop
//! makes of it, share a slot where nobody reads the old one any more: then there is nothing to do where
//! the guard does not hold, and nothing to carry from turn to turn.

use std::collections::BTreeSet;

use super::list::List;
use super::needs::Needs;
use super::regions::{Order, Part};
use crate::real::traced::{Arg, Op};

/// Where an entry's number is when its region is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Home {
    /// Nobody asks.
    None,
    Input(u32),
    Slot(u32),
}

pub(super) struct Slots {
    pub homes: Vec<Home>,
    pub count: u32,
}

impl Slots {
    pub fn of(list: &List, needs: &Needs, order: &Order) -> Self {
        let reads = Reads::of(list, needs, order);
        let mut sharing = Sharing::new(list, needs, order, &reads);
        sharing.share();
        sharing.slots()
    }
}

fn is_input(list: &List, at: usize) -> bool {
    matches!(list.nodes[at].op, Op::Input(_))
}

/// By entry: the place of its last reader, and whether that is in another region.
struct Reads {
    last: Vec<usize>,
    shared: Vec<bool>,
}

impl Reads {
    fn of(list: &List, needs: &Needs, order: &Order) -> Self {
        let n = list.nodes.len();
        let around = around(order);
        let mut own = Self { last: order.place.clone(), shared: vec![false; n] };
        let mut read = |arg: Arg, part: usize, place: usize| {
            let Some(at) = needs.choices.of(arg).node().map(|node| node as usize) else { return };
            let made = order.part_of[at];
            own.shared[at] |= made != part;
            // What is read in a loop in which it was not made is read until that ends.
            let other = around[part]
                .iter()
                .find(|inside| !around[made].contains(inside) && order.spans[**inside].0 != made);
            let until = other.map_or(place, |inside| order.first[order.spans[*inside].1]);
            own.last[at] = own.last[at].max(until);
        };
        for at in (0..n).filter(|at| needs.lives(*at)) {
            let node = &list.nodes[at];
            if node.op.enters() || node.op.leaves() {
                continue;
            }
            let (part, place) = (order.part_of[at], order.place[at]);
            node.args.iter().for_each(|arg| read(*arg, part, place));
            if let Some((_, other)) = needs.merged.get(&(at as u32)) {
                read(*other, part, order.first[part]);
            }
        }
        for (part, own) in order.parts.iter().enumerate() {
            if let Part::Region(region) = own {
                region
                    .guard
                    .iter()
                    .for_each(|mask| read(Arg::Node(*mask), part, order.first[part]));
            }
        }
        for (inside, (begin, end)) in list.loops.iter().zip(&order.spans) {
            for (enter, leave) in inside.changed.iter().filter(|both| needs.lives(both.0 as usize))
            {
                read(list.nodes[*enter as usize].args[0], *begin, order.first[*begin]);
                read(list.nodes[*leave as usize].args[0], *end, order.first[*end]);
            }
        }
        let never = usize::MAX;
        let wanted = list.wanted.iter().filter_map(|(arg, _)| needs.choices.of(*arg).node());
        let masks = list.assumed.iter().chain(list.under.values()).copied();
        for node in wanted.chain(masks) {
            (own.shared[node as usize], own.last[node as usize]) = (true, never);
        }
        for node in list.loops.iter().flat_map(|inside| &inside.changed) {
            (own.shared[node.0 as usize], own.shared[node.1 as usize]) = (true, true);
        }
        own
    }
}

/// By part: the loops around it.
fn around(order: &Order) -> Vec<Vec<usize>> {
    let (mut open, mut all) = (vec![], vec![]);
    for part in &order.parts {
        all.push(open.clone());
        match part {
            Part::Begin(own) => open.push(*own),
            Part::End(_) => {
                open.pop();
            }
            Part::Region(_) => {}
        }
    }
    all
}

/// Which entries share a slot.
struct Sharing<'a> {
    list: &'a List,
    needs: &'a Needs,
    order: &'a Order,
    reads: &'a Reads,
    /// Of entries that share a slot one stands for all: from where to where it is theirs.
    parent: Vec<u32>,
    span: Vec<(usize, usize)>,
    /// Nothing has taken its place yet.
    newest: Vec<bool>,
}

impl<'a> Sharing<'a> {
    fn new(list: &'a List, needs: &'a Needs, order: &'a Order, reads: &'a Reads) -> Self {
        let n = list.nodes.len();
        let span = |at: usize| {
            let merged = needs.merged.contains_key(&(at as u32));
            let from = if merged { order.first[order.part_of[at]] } else { order.place[at] };
            (from, reads.last[at])
        };
        let (parent, span) = ((0..n as u32).collect(), (0..n).map(span).collect());
        let mut own = Self { list, needs, order, reads, parent, span, newest: vec![true; n] };
        // What a loop changes lies in one place, from its first turn to its last.
        for (inside, (begin, end)) in list.loops.iter().zip(&order.spans) {
            for (enter, leave) in &inside.changed {
                own.join(*enter, *leave);
                let span = &mut own.span[*enter as usize];
                *span = (order.first[*begin], span.1.max(order.first[*end]));
            }
        }
        own
    }

    fn find(&mut self, mut node: u32) -> u32 {
        while self.parent[node as usize] != node {
            let next = self.parent[node as usize];
            self.parent[node as usize] = self.parent[next as usize];
            node = next;
        }
        node
    }

    fn join(&mut self, a: u32, b: u32) {
        let [a, b] = [a, b].map(|node| self.find(node));
        if a != b {
            let ((from, to), (start, end)) = (self.span[a as usize], self.span[b as usize]);
            self.parent[b as usize] = a;
            self.span[a as usize] = (from.min(start), to.max(end));
        }
    }

    fn share(&mut self) {
        let (list, needs, order) = (self.list, self.needs, self.order);
        // (where the new one is written, old, new)
        let mut steps: Vec<(usize, u32, u32)> = vec![];
        for at in needs.merged.keys().filter(|at| needs.lives(**at as usize)) {
            let place = order.place[*at as usize];
            steps.extend(self.before_merged(*at).map(|old| (place, old, *at)));
        }
        for (inside, (begin, _)) in list.loops.iter().zip(&order.spans) {
            for (enter, leave) in inside.changed.iter().filter(|both| needs.lives(both.0 as usize))
            {
                let source = |node: u32| needs.choices.of(list.nodes[node as usize].args[0]).node();
                steps.extend(source(*enter).map(|old| (order.first[*begin], old, *enter)));
                let made = source(*leave).filter(|made| order.part_of[*made as usize] > *begin);
                steps.extend(made.map(|made| (order.place[made as usize], *enter, made)));
            }
        }
        steps.sort_unstable();
        for (written, old, new) in steps {
            self.take_place(written, old, new);
        }
    }

    /// What a merged entry takes the place of: the nearest that has a slot.
    fn before_merged(&self, at: u32) -> Option<u32> {
        let (mut own, part) = (at, self.order.part_of[at as usize]);
        loop {
            let (_, other) = self.needs.merged.get(&own)?;
            let other = self.needs.choices.of(*other).node()?;
            let here = self.order.part_of[other as usize] == part;
            if !here || self.reads.shared[other as usize] {
                return Some(other);
            }
            own = other;
        }
    }

    /// `new` takes the place of `old`, if nobody reads that any more.
    fn take_place(&mut self, written: usize, old: u32, new: u32) {
        let (o, n) = (old as usize, new as usize);
        let with_slot = self.reads.shared[o] && self.reads.shared[n] && !is_input(self.list, o);
        // Nothing has come to share its slot yet but what a loop leaves there.
        let fresh = self.list.nodes[n].op.enters() || self.find(new) == new && self.newest[n];
        if with_slot
            && fresh
            && self.newest[o]
            && self.reads.last[o] <= written
            && self.find(old) != self.find(new)
        {
            self.newest[o] = false;
            self.join(old, new);
        }
    }

    /// Slots, given out in the order in which they are first written.
    fn slots(mut self) -> Slots {
        let n = self.list.nodes.len();
        let (list, needs, reads) = (self.list, self.needs, self.reads);
        let kept = |at: &usize| needs.lives(*at) && reads.shared[*at] && !is_input(list, *at);
        let mut seen = vec![false; n];
        let mut roots: Vec<usize> = vec![];
        for at in (0..n).filter(kept) {
            let root = self.find(at as u32) as usize;
            if !std::mem::replace(&mut seen[root], true) {
                roots.push(root);
            }
        }
        roots.sort_by_key(|root| self.span[*root].0);
        let (mut free, mut count) = (vec![], 0);
        let mut busy: BTreeSet<(usize, u32)> = BTreeSet::new();
        let mut slot = vec![0; n];
        for root in roots {
            let (from, to) = self.span[root];
            while let Some((end, own)) = busy.first().copied().filter(|(end, _)| *end < from) {
                busy.remove(&(end, own));
                free.push(own);
            }
            let own = free.pop().unwrap_or_else(|| {
                count += 1;
                count - 1
            });
            slot[root] = own;
            busy.insert((to, own));
        }
        let home = |at: usize| match list.nodes[at].op {
            Op::Input(place) => Home::Input(place),
            _ if kept(&at) => Home::Slot(slot[self.find(at as u32) as usize]),
            _ => Home::None,
        };
        Slots { homes: (0..n).map(home).collect(), count }
    }
}
