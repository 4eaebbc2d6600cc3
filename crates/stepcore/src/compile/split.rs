//! A step in parts, between which somebody else works.
//!
//! Each part is a list of its own. What one makes and a later one reads goes through the memory of the
//! state, where it is needed only.

use std::collections::{BTreeMap, HashMap};

use super::list::List;
use super::needs::Needs;
use crate::real::traced::{Arg, Node, Op};

/// The parts of a list, in order. `first`: the first place in the memory that nobody uses.
pub(super) fn split(list: List, first: u32) -> Vec<List> {
    if list.cuts.is_empty() {
        return vec![list];
    }
    let mut places =
        Places { needs: Needs::of(&list), next: first, list: &list, of: HashMap::new() };
    let ends: Vec<usize> = list.cuts.iter().copied().chain([list.nodes.len()]).collect();
    let mut parts: Vec<Part> = (0..ends.len()).map(|part| places.part(part, &ends)).collect();
    for (node, place) in &places.of {
        places.leave(&mut parts[list.part_of(*node)], *node, *place);
    }
    parts.into_iter().map(|part| part.list).collect()
}

/// A part, and by how much its own entries have moved down from where they were.
struct Part {
    list: List,
    start: u32,
    front: u32,
}

impl Part {
    fn moved(&self, node: u32) -> u32 {
        node - self.start + self.front
    }
}

impl List {
    fn part_of(&self, node: u32) -> usize {
        self.cuts.partition_point(|cut| *cut <= node as usize)
    }

    fn start(&self, part: usize) -> usize {
        part.checked_sub(1).map_or(0, |before| self.cuts[before])
    }
}

/// Where numbers are between the parts.
struct Places<'a> {
    list: &'a List,
    needs: Needs,
    next: u32,
    /// By entry that a later part reads.
    of: HashMap<u32, u32>,
}

impl Places<'_> {
    /// A part; what it reads of others is there first.
    fn part(&mut self, part: usize, ends: &[usize]) -> Part {
        let (list, start, end) = (self.list, self.list.start(part), ends[part]);
        let inside = |node: u32| (start..end).contains(&(node as usize));
        let last = part + 1 == ends.len();
        let wanted = if last { &list.wanted[..] } else { &[] };
        let assumed = list.assumed.iter().copied().filter(|mask| inside(*mask));
        // By entry of another part: what stands for it here.
        let mut read: BTreeMap<u32, u32> = BTreeMap::new();
        let lives = (start..end).filter(|at| self.needs.lives(*at));
        let args =
            lives.flat_map(|at| &list.nodes[at].args).chain(wanted.iter().map(|(arg, _)| arg));
        let under = list.under.values().filter(|_| last).map(|mask| Arg::Node(*mask));
        let args = args.copied().chain(under);
        for node in args.filter_map(|arg| self.needs.choices.of(arg).node()) {
            if !inside(node) {
                read.insert(node, 0);
            }
        }
        let mut nodes: Vec<Node> = vec![];
        for (node, own) in &mut read {
            let Node { op, facts, .. } = list.nodes[*node as usize].clone();
            let op = match op {
                Op::Input(_) => op,
                _ => Op::Input(self.place(*node)),
            };
            nodes.push(Node { op, args: vec![], facts });
            if list.nodes[*node as usize].op.is_mask() {
                let args = vec![Arg::Known(0.5), Arg::Node(nodes.len() as u32 - 1)];
                nodes.push(Node { op: Op::Lt, args, facts });
            }
            *own = nodes.len() as u32 - 1;
        }
        let mut own =
            Part { list: List::default(), start: start as u32, front: nodes.len() as u32 };
        let moved = |node: u32| own.moved(node);
        let here = |arg: &Arg| match self.needs.choices.of(*arg) {
            Arg::Node(node) if inside(node) => Arg::Node(moved(node)),
            // Who reads what is not there is not executed.
            Arg::Node(node) => read.get(&node).map_or(Arg::Known(0.0), |own| Arg::Node(*own)),
            known => known,
        };
        nodes.extend(
            list.nodes[start..end]
                .iter()
                .map(|node| Node { args: node.args.iter().map(here).collect(), ..node.clone() }),
        );
        let loops = list.loops.iter().filter(|inside| (start..end).contains(&inside.entries.start));
        let loops = loops.cloned().map(|mut inside| {
            let at = |at: usize| moved(at as u32) as usize;
            inside.entries = at(inside.entries.start)..at(inside.entries.end);
            for (enter, leave) in &mut inside.changed {
                (*enter, *leave) = (moved(*enter), moved(*leave));
            }
            inside
        });
        let puts = list.puts.iter().filter(|(put, _)| inside(**put)).map(|(put, masks)| {
            let masks = masks.iter().filter(|mask| inside(**mask)).map(|mask| moved(*mask));
            (moved(*put), masks.collect())
        });
        let under = list.under.iter().filter(|_| last).map(|(at, mask)| (at, Arg::Node(*mask)));
        let list = List {
            loops: loops.collect(),
            wanted: wanted.iter().map(|(arg, most)| (here(arg), *most)).collect(),
            under: under.filter_map(|(place, mask)| Some((*place, here(&mask).node()?))).collect(),
            assumed: assumed.map(moved).collect(),
            puts: puts.collect(),
            cuts: vec![],
            nodes,
        };
        own.list = list;
        own
    }

    fn place(&mut self, node: u32) -> u32 {
        *self.of.entry(node).or_insert_with(|| {
            self.next += 1;
            self.next - 1
        })
    }

    /// A part leaves an entry for others, where somebody needs it.
    fn leave(&self, part: &mut Part, node: u32, place: u32) {
        let Node { op, facts, .. } = self.list.nodes[node as usize].clone();
        let masks = self.needs.masks[node as usize].iter().flat_map(|masks| masks.iter().copied());
        let inside = |mask: &u32| self.list.part_of(*mask) == self.list.part_of(node);
        let masks = masks.filter(inside).map(|mask| part.moved(mask)).collect();
        let mut number = Arg::Node(part.moved(node));
        let nodes = &mut part.list.nodes;
        if op.is_mask() {
            let args = vec![number, Arg::Known(1.0), Arg::Known(0.0)];
            nodes.push(Node { op: Op::Select, args, facts });
            number = Arg::Node(nodes.len() as u32 - 1);
        }
        nodes.push(Node { op: Op::Put(place), args: vec![number], facts });
        part.list.puts.insert(nodes.len() as u32 - 1, masks);
    }
}
