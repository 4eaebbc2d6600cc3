//! The nodes of an island: dofs that every row touches together, such as a free body's six.
//!
//! The Hessian of a pile consists of dense blocks between nodes. Nodes are ordered by minimum
//! degree (`order.rs`); local numbers of dofs follow that order, so that a node's dofs are adjacent
//! in every vector. Order and columns are reused while the same nodes touch each other, whichever
//! contacts connect them.

use super::order::Order;
use crate::model::Span;
use crate::solve::free_bodies::FreeBodies;

/// The class of a dof without one.
pub(super) const NOWHERE: usize = usize::MAX;

/// A node of a bundle's list.
#[derive(Clone, Copy, Debug)]
pub(super) struct Member {
    /// The node's turn.
    pub node: usize,
    /// Its dofs' places in the bundle's list: into `Nodes::entries`.
    pub entries: usize,
    /// The first of these, if they are consecutive.
    pub run: Option<usize>,
}

/// One bundle at one of its nodes: `node` is `members[member]`, and the bundle's later nodes follow
/// there up to `end`.
#[derive(Clone, Copy, Debug)]
pub(super) struct NodePair {
    pub bundle: usize,
    pub member: usize,
    pub end: usize,
}

#[derive(Default)]
pub(super) struct Nodes {
    /// Every bundle's list, one after another: the input of everything else.
    key: Vec<usize>,
    ends: Vec<usize>,
    pub order: Order,
    /// Dofs in the order of elimination, and by turn the start of a node's dofs; one more at the end.
    pub dofs: Vec<usize>,
    pub first: Vec<usize>,
    /// Per bundle: its nodes in `members`, by turn.
    pub bundles: Vec<Span>,
    pub members: Vec<Member>,
    pub entries: Vec<usize>,
    /// Every bundle's list in local numbers.
    pub lists: Vec<usize>,
    /// Per bundle: the same, if it is of free bodies.
    pub free: Vec<Option<FreeBodies>>,
    /// Per turn: the bundles that touch the node, `pairs[meets[k]..meets[k + 1]]`.
    pub meets: Vec<usize>,
    pub pairs: Vec<NodePair>,
    /// Per turn: the start of its column's entries of `order.rows`, as numbers: the diagonal block,
    /// then each row's block, pivot by pivot.
    pub places: Vec<usize>,
    /// Per entry of `order.rows`: the start of its block.
    pub offsets: Vec<usize>,
    pub numbers: usize,
    /// Per turn: the earlier columns that reach it, and the row in each that does.
    pub left_start: Vec<usize>,
    pub left: Vec<(usize, usize)>,
    /// Scratch.
    split: Vec<(usize, usize)>,
    seen: Vec<usize>,
    node_of: Vec<usize>,
    sizes: Vec<usize>,
    edges: Vec<(usize, usize)>,
    next: Vec<usize>,
}

room!(Nodes: key, ends, order, dofs, first, bundles, members, entries, lists, free, meets, pairs,
    places, offsets, numbers, left_start, left, split, seen, node_of, sizes, edges, next);

impl Nodes {
    /// Computes everything for bundles with these lists, unless it is up to date. `class`: scratch
    /// by dof, `NOWHERE` before and after.
    pub fn fit(&mut self, dof_lists: &[usize], spans: &[Span], class: &mut [usize]) {
        let lists = spans.iter().map(|span| span.of(dof_lists));
        let same = self.ends.len() == spans.len()
            && self
                .ends
                .iter()
                .scan(0, |start, end| {
                    let own = *start..*end;
                    *start = *end;
                    Some(own)
                })
                .zip(lists.clone())
                .all(|(own, list)| self.key[own] == *list);
        if same {
            return;
        }
        self.key.clear();
        self.ends.clear();
        for list in lists {
            self.key.extend_from_slice(list);
            self.ends.push(self.key.len());
        }
        self.classify(class);
        self.link();
        let Self { order, edges, sizes, .. } = self;
        order.fit(sizes.len(), edges.iter().copied());
        self.number(class);
        self.columns();
        self.meet();
        let mut free = std::mem::take(&mut self.free);
        free.clear();
        free.extend((0..self.ends.len()).map(|bundle| FreeBodies::of(self.local(bundle))));
        self.free = free;
    }

    /// Group dofs that are in the same lists into one class: each list splits the classes that it cuts.
    fn classify(&mut self, class: &mut [usize]) {
        self.seen.clear();
        self.split.clear();
        let mut start = 0;
        for (stamp, end) in self.ends.iter().enumerate() {
            let list = &self.key[start..*end];
            start = *end;
            // The class of dofs that first appear in this list.
            let mut fresh = NOWHERE;
            for k in list {
                let old = class[*k];
                if old == NOWHERE {
                    if fresh == NOWHERE {
                        fresh = self.split.len();
                        self.split.push((NOWHERE, NOWHERE));
                    }
                    self.seen.push(*k);
                    class[*k] = fresh;
                    continue;
                }
                if self.split[old].0 != stamp {
                    self.split[old] = (stamp, self.split.len());
                    self.split.push((NOWHERE, NOWHERE));
                }
                class[*k] = self.split[old].1;
            }
        }
        // Nodes by their first dof; `split` now holds each class's node.
        self.seen.sort_unstable();
        self.sizes.clear();
        self.split.iter_mut().for_each(|split| split.0 = NOWHERE);
        for k in &self.seen {
            let node = &mut self.split[class[*k]].0;
            if *node == NOWHERE {
                *node = self.sizes.len();
                self.sizes.push(0);
            }
            self.sizes[*node] += 1;
        }
        self.node_of.clear();
        self.node_of.extend(self.key.iter().map(|k| self.split[class[*k]].0));
    }

    /// Link the nodes of one list as neighbours. `members` hold each list's nodes, in its order.
    fn link(&mut self) {
        self.edges.clear();
        self.members.clear();
        self.bundles.clear();
        let mut start = 0;
        for end in &self.ends {
            let first = self.members.len();
            for node in &self.node_of[start..*end] {
                let own = &self.members[first..];
                if own.iter().all(|member| member.node != *node) {
                    self.edges.extend(own.iter().map(|member| (member.node, *node)));
                    self.members.push(Member { node: *node, entries: 0, run: None });
                }
            }
            self.bundles.push(Span { start: first, len: self.members.len() - first });
            start = *end;
        }
    }

    /// Number dofs in the order of elimination, and convert every list.
    fn number(&mut self, class: &mut [usize]) {
        let count = self.sizes.len();
        self.first.clear();
        let mut at = 0;
        for node in &self.order.sequence {
            self.first.push(at);
            at += self.sizes[*node];
        }
        self.first.push(at);
        self.next.clear();
        self.next.extend((0..count).map(|node| self.first[self.order.turn[node]]));
        self.dofs.clear();
        self.dofs.resize(at, 0);
        for k in &self.seen {
            let class = &mut class[*k];
            let local = &mut self.next[self.split[*class].0];
            self.dofs[*local] = *k;
            *class = *local;
            *local += 1;
        }
        self.lists.clear();
        self.lists.extend(self.key.iter().map(|k| class[*k]));
        for k in &self.seen {
            class[*k] = NOWHERE;
        }
        self.entries.clear();
        for bundle in 0..self.ends.len() {
            let start = if bundle == 0 { 0 } else { self.ends[bundle - 1] };
            let own = self.bundles[bundle].range();
            for member in &mut self.members[own.clone()] {
                let node = member.node;
                let first = self.entries.len();
                let nodes = self.node_of[start..self.ends[bundle]].iter();
                let places = nodes.enumerate().filter(|(_, other)| **other == node);
                self.entries.extend(places.map(|(place, _)| place));
                let own = &self.entries[first..];
                let straight = own.iter().enumerate().all(|(at, place)| *place == own[0] + at);
                let run = straight.then(|| own[0]);
                *member = Member { node: self.order.turn[node], entries: first, run };
            }
            self.members[own].sort_unstable_by_key(|member| member.node);
        }
    }

    /// Computes the place of each column among the numbers, and which columns reach which.
    fn columns(&mut self) {
        let (order, count) = (&self.order, self.sizes.len());
        let size = |k: usize| self.first[k + 1] - self.first[k];
        self.places.clear();
        self.offsets.clear();
        self.left_start.clear();
        self.left_start.resize(count + 1, 0);
        let mut numbers = 0;
        for k in 0..count {
            self.places.push(numbers);
            numbers += size(k) * size(k);
            for row in order.column(k) {
                self.offsets.push(numbers);
                numbers += size(k) * size(*row);
                self.left_start[row + 1] += 1;
            }
        }
        self.numbers = numbers;
        for k in 0..count {
            self.left_start[k + 1] += self.left_start[k];
        }
        self.left.clear();
        self.left.resize(order.rows.len(), (0, 0));
        self.next.clear();
        self.next.extend_from_slice(&self.left_start[..count]);
        for k in 0..count {
            for at in order.start[k]..order.start[k + 1] {
                let next = &mut self.next[order.rows[at]];
                self.left[*next] = (k, at);
                *next += 1;
            }
        }
    }

    /// Collects bundles by their nodes.
    fn meet(&mut self) {
        let count = self.sizes.len();
        self.meets.clear();
        self.meets.resize(count + 1, 0);
        for member in &self.members {
            self.meets[member.node + 1] += 1;
        }
        for k in 0..count {
            self.meets[k + 1] += self.meets[k];
        }
        self.next.clear();
        self.next.extend_from_slice(&self.meets[..count]);
        self.pairs.clear();
        self.pairs.resize(self.members.len(), NodePair { bundle: 0, member: 0, end: 0 });
        for (bundle, span) in self.bundles.iter().enumerate() {
            for member in span.range() {
                let next = &mut self.next[self.members[member].node];
                self.pairs[*next] = NodePair { bundle, member, end: span.range().end };
                *next += 1;
            }
        }
    }

    /// Returns a bundle's list in local numbers.
    pub fn local(&self, bundle: usize) -> &[usize] {
        let start = if bundle == 0 { 0 } else { self.ends[bundle - 1] };
        &self.lists[start..self.ends[bundle]]
    }

    /// Returns the number of dofs of a node.
    pub fn size(&self, node: usize) -> usize {
        self.first[node + 1] - self.first[node]
    }

    /// Returns the number of nodes.
    pub fn count(&self) -> usize {
        self.sizes.len()
    }
}
