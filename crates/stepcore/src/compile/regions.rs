//! The order of execution: regions of entries, each behind one guard or none, and loops around some.

use std::collections::HashMap;

use super::list::{List, Path};
use super::needs::Needs;
use crate::real::traced::{Arg, Op};

/// Entries that are executed one after another; with a guard only where it holds in some lane.
#[derive(Debug)]
pub(super) struct Region {
    pub guard: Option<u32>,
    pub entries: Vec<u32>,
}

/// What is executed, in order.
#[derive(Debug)]
pub(super) enum Part {
    Region(Region),
    /// A loop begins: where no lane is live it is over.
    Begin(usize),
    End(usize),
}

/// The order, and where an entry stands in it: the part, and the place among all entries.
pub(super) struct Order {
    pub parts: Vec<Part>,
    pub part_of: Vec<usize>,
    pub place: Vec<usize>,
    /// By part: the place of its first entry.
    pub first: Vec<usize>,
    /// By loop: the parts at which it begins and ends.
    pub spans: Vec<(usize, usize)>,
}

/// A stretch of the list between two ends of loops.
struct Section {
    path: Path,
    begins: Option<usize>,
    ends: Option<usize>,
    regions: Vec<Region>,
    /// By guard: the regions that it has here.
    of: HashMap<Option<u32>, Vec<usize>>,
}

impl Section {
    fn new(path: Path) -> Self {
        Self { path, begins: None, ends: None, regions: vec![], of: HashMap::new() }
    }
}

impl Order {
    pub fn of(list: &List, needs: &Needs) -> Self {
        let (mut sections, section_of) = sections(list);
        // By entry: section and region; the loop that it must stay in.
        let n = list.nodes.len();
        let mut placed = vec![(0, 0); n];
        let mut depth = vec![0; n];
        for at in (0..n).filter(|at| needs.lives(*at)) {
            let op = list.nodes[at].op;
            if matches!(op, Op::Input(_)) {
                continue;
            }
            let home = section_of[at];
            if op.enters() || op.leaves() {
                // They are there before all others of their section.
                placed[at] = (home, 0);
                depth[at] = sections[home].path.len();
                continue;
            }
            let merged = needs.merged.get(&(at as u32));
            let guard = merged.map(|(guard, _)| *guard).or(needs.guard[at]);
            let args = list.nodes[at].args.iter().filter_map(|arg| needs.choices.of(*arg).node());
            let args: Vec<usize> = args.map(|node| node as usize).collect();
            let masks = guard.iter().map(|guard| *guard as usize);
            // It is made in the outermost loop that what it reads allows.
            let deep = args.iter().copied().chain(masks).map(|node| depth[node]).max().unwrap_or(0);
            let path = &sections[home].path[..deep];
            let own = (0..=home).rev().find(|s| sections[*s].path == path).unwrap_or(home);
            depth[at] = deep;
            let inputs = |node: &usize| matches!(list.nodes[*node].op, Op::Input(_));
            let after = args.iter().filter(|node| !inputs(node) && placed[**node].0 == own);
            let mut least = after.map(|node| placed[*node].1).max().unwrap_or(0);
            if let Some(guard) = guard {
                if placed[guard as usize].0 == own {
                    least = least.max(placed[guard as usize].1 + 1);
                }
            }
            if let Some((guard, Arg::Node(other))) = merged {
                let other = needs.choices.of(Arg::Node(*other)).node().unwrap_or(*other) as usize;
                let with = needs.merged.get(&(other as u32)).is_some_and(|(own, _)| own == guard);
                if placed[other].0 == own && !inputs(&other) && !with {
                    least = least.max(placed[other].1 + 1);
                }
            }
            let Section { regions, of, .. } = &mut sections[own];
            let known = of.entry(guard).or_default();
            let region = match known.iter().find(|region| **region >= least) {
                Some(region) => *region,
                None => {
                    regions.push(Region { guard, entries: vec![] });
                    known.push(regions.len() - 1);
                    regions.len() - 1
                }
            };
            regions[region].entries.push(at as u32);
            placed[at] = (own, region);
        }
        Self::flat(list, sections, &placed)
    }

    /// One section after another.
    fn flat(list: &List, sections: Vec<Section>, placed: &[(usize, usize)]) -> Self {
        let n = list.nodes.len();
        let mut parts = vec![];
        let mut spans = vec![(0, 0); list.loops.len()];
        let mut starts = vec![];
        for section in sections {
            if let Some(own) = section.ends {
                spans[own].1 = parts.len();
                parts.push(Part::End(own));
            }
            if let Some(own) = section.begins {
                spans[own].0 = parts.len();
                parts.push(Part::Begin(own));
            }
            starts.push(parts.len());
            parts.extend(section.regions.into_iter().map(Part::Region));
        }
        let (mut part_of, mut place) = (vec![0; n], vec![0; n]);
        let (mut first, mut next) = (vec![], 0);
        for part in &parts {
            first.push(next);
            if let Part::Region(region) = part {
                for entry in &region.entries {
                    place[*entry as usize] = next;
                    next += 1;
                }
            }
            // Ends of loops have places of their own.
            next += 1;
        }
        for at in 0..n {
            part_of[at] = starts[placed[at].0] + placed[at].1;
        }
        for (index, own) in list.loops.iter().enumerate() {
            for (enter, leave) in &own.changed {
                for (node, part) in [(*enter, spans[index].0), (*leave, spans[index].1)] {
                    part_of[node as usize] = part;
                    place[node as usize] = first[part];
                }
            }
        }
        Self { parts, part_of, place, first, spans }
    }
}

/// The sections of a list, and that of each entry.
fn sections(list: &List) -> (Vec<Section>, Vec<usize>) {
    let mut sections = vec![Section::new(vec![])];
    let mut of = Vec::with_capacity(list.nodes.len());
    let mut open: Path = vec![];
    let mut next = 0;
    for at in 0..=list.nodes.len() {
        while open.last().is_some_and(|own| list.loops[*own].entries.end <= at) {
            let ended = open.pop();
            sections.push(Section { ends: ended, ..Section::new(open.clone()) });
        }
        while next < list.loops.len() && list.loops[next].entries.start <= at {
            open.push(next);
            sections.push(Section { begins: Some(next), ..Section::new(open.clone()) });
            next += 1;
        }
        if at < list.nodes.len() {
            of.push(sections.len() - 1);
        }
    }
    (sections, of)
}
