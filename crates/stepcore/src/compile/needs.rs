//! Where an entry matters: in lanes where all of some masks hold.
//!
//! Found backwards from what a step leaves. What a choice takes where its mask holds matters there
//! alone, and so does all that is computed for it and nothing else. A contact's rows, and what they do
//! to the impulses, matter where there is the contact: machine code jumps over them where no lane has
//! it, which is what the stages do by asking.

use std::collections::HashMap;
use std::rc::Rc;

use super::list::{Choices, List};
use crate::real::traced::{Arg, Op};

/// Entries that one mask must guard to be worth a jump.
const WORTH: usize = 24;
/// Rounds after which choices are left as they are, and passes after which loops are.
const ROUNDS: usize = 8;
const PASSES: usize = 40;

/// Some masks, ascending.
pub(super) type Masks = Rc<[u32]>;

/// The need of every entry, as far as it is known: `None` where nobody has asked.
pub(super) struct Needs {
    pub choices: Choices,
    pub used: Vec<bool>,
    /// By entry: the masks that hold wherever it matters.
    pub masks: Vec<Option<Masks>>,
    /// By entry: the mask without which it is not computed.
    pub guard: Vec<Option<u32>>,
    /// By entry that chooses what a guard protects: that guard; it is made behind it, and where the guard
    /// holds nowhere it is this number.
    pub merged: HashMap<u32, (u32, Arg)>,
}

/// Sets of masks, each once.
#[derive(Default)]
struct Sets {
    implied: HashMap<u32, Masks>,
    met: HashMap<(usize, usize), Masks>,
    known: HashMap<Masks, Masks>,
}

impl Sets {
    fn one(&mut self, masks: Vec<u32>) -> Masks {
        let masks: Masks = masks.into();
        self.known.entry(masks.clone()).or_insert(masks).clone()
    }

    /// A mask, and those of which it is made that hold where it does.
    fn implied(&mut self, list: &List, choices: &Choices, mask: u32) -> Masks {
        if let Some(known) = self.implied.get(&mask) {
            return known.clone();
        }
        let node = &list.nodes[mask as usize];
        let mut all = vec![mask];
        if node.op == Op::And {
            for part in node.args.iter().filter_map(|arg| choices.of(*arg).node()) {
                all.extend(self.implied(list, choices, part).iter());
            }
        }
        all.sort_unstable();
        all.dedup();
        let all = self.one(all);
        self.implied.insert(mask, all.clone());
        all
    }

    fn meet(&mut self, a: Option<&Masks>, b: &Masks) -> Masks {
        let Some(a) = a else { return b.clone() };
        if Rc::ptr_eq(a, b) {
            return b.clone();
        }
        let key = (a.as_ptr() as usize, b.as_ptr() as usize);
        if let Some(known) = self.met.get(&key) {
            return known.clone();
        }
        let both =
            self.one(a.iter().copied().filter(|mask| b.binary_search(mask).is_ok()).collect());
        self.met.insert(key, both.clone());
        both
    }

    fn join(&mut self, a: &Masks, b: &Masks) -> Masks {
        if b.iter().all(|mask| a.binary_search(mask).is_ok()) {
            return a.clone();
        }
        let mut all: Vec<u32> = a.iter().chain(b.iter()).copied().collect();
        all.sort_unstable();
        all.dedup();
        self.one(all)
    }

    fn before(&mut self, masks: &Masks, entry: usize) -> Masks {
        if masks.last().is_none_or(|last| (*last as usize) < entry) {
            return masks.clone();
        }
        self.one(masks.iter().copied().filter(|mask| (*mask as usize) < entry).collect())
    }
}

impl Needs {
    pub fn of(list: &List) -> Self {
        let mut choices = Choices::default();
        let mut used = list.used(&choices);
        let mut sets = Sets::default();
        let mut needs = find(list, &choices, &used, &mut sets);
        for _ in 0..ROUNDS {
            let before = choices.0.len();
            for (at, node) in list.nodes.iter().enumerate().filter(|(at, _)| used[*at]) {
                let Some(need) = &needs[at] else { continue };
                if node.op != Op::Select || choices.0.contains_key(&(at as u32)) {
                    continue;
                }
                let mask = choices.of(node.args[0]).node();
                if mask.is_some_and(|mask| need.binary_search(&mask).is_ok()) {
                    choices.0.insert(at as u32, node.args[1]);
                }
            }
            if choices.0.len() == before {
                break;
            }
            used = list.used(&choices);
            sets = Sets::default();
            needs = find(list, &choices, &used, &mut sets);
        }
        let guard = guards(list, &used, &needs);
        let mut own = Self { choices, used, masks: needs, guard, merged: HashMap::new() };
        own.merge(list, &mut sets);
        own
    }

    /// It is executed: somebody needs it, and it is no choice that is made already.
    pub fn lives(&self, at: usize) -> bool {
        self.used[at] && !self.choices.0.contains_key(&(at as u32))
    }

    /// What chooses among things behind a guard is made there too.
    fn merge(&mut self, list: &List, sets: &mut Sets) {
        let loops = list.loop_of();
        for at in 0..list.nodes.len() {
            if !self.lives(at) || self.guard[at].is_some() {
                continue;
            }
            let node = &list.nodes[at];
            let args: Vec<Arg> = node.args.iter().map(|arg| self.choices.of(*arg)).collect();
            let guard = |arg: Arg| self.guard[arg.node()? as usize];
            let here = |guard: u32, own: usize| {
                // A guard inside a loop protects nothing outside of it.
                loops[guard as usize].is_none() || loops[guard as usize] == loops[own]
            };
            let merged = match (node.op, &args[..]) {
                (Op::Select, &[mask, yes, no]) => mask.node().and_then(|mask| {
                    let guard = guard(yes)?;
                    let holds =
                        sets.implied(list, &self.choices, mask).binary_search(&guard).is_ok();
                    (holds && here(guard, at)).then_some((guard, no))
                }),
                (Op::And, &[Arg::Node(a), Arg::Node(b)]) => {
                    [(a, b), (b, a)].into_iter().find_map(|(low, high)| {
                        let guard = guard(Arg::Node(high))?;
                        let holds =
                            sets.implied(list, &self.choices, low).binary_search(&guard).is_ok();
                        (holds && here(guard, at)).then_some((guard, Arg::truth(false)))
                    })
                }
                (Op::Or, &[a, b]) => [(a, b), (b, a)].into_iter().find_map(|(other, part)| {
                    let (guard, none) = self.merged.get(&part.node()?)?;
                    (*none == Arg::truth(false)
                        && list.nodes[part.node()? as usize].op == Op::And
                        && other != part
                        && here(*guard, at))
                    .then_some((*guard, other))
                }),
                _ => None,
            };
            if let Some(merged) = merged {
                self.merged.insert(at as u32, merged);
            }
        }
    }
}

/// The masks that hold wherever an entry matters.
fn find(list: &List, choices: &Choices, used: &[bool], sets: &mut Sets) -> Vec<Option<Masks>> {
    let partners = list.partners();
    let n = list.nodes.len();
    let mut needs: Vec<Option<Masks>> = vec![None; n];
    let always = sets.one(vec![]);
    for _ in 0..PASSES {
        let mut new: Vec<Option<Masks>> = vec![None; n];
        for (place, (arg, _)) in list.wanted.iter().enumerate() {
            let mask = list.under.get(&place).and_then(|mask| choices.of(Arg::Node(*mask)).node());
            let need = mask.map_or(always.clone(), |mask| sets.implied(list, choices, mask));
            if let Some(root) = choices.of(*arg).node() {
                let met = sets.meet(new[root as usize].as_ref(), &need);
                new[root as usize] = Some(met);
            }
        }
        for root in list.assumed.iter().chain(list.under.values()) {
            new[*root as usize] = Some(always.clone());
        }
        for own in &list.loops {
            let (enter, leave) = own.changed[own.live];
            for node in [enter, leave].into_iter().filter(|node| used[*node as usize]) {
                new[node as usize] = Some(always.clone());
            }
        }
        for (put, masks) in &list.puts {
            let mut need = always.clone();
            for mask in masks.iter().filter_map(|mask| choices.of(Arg::Node(*mask)).node()) {
                let implied = sets.implied(list, choices, mask);
                need = sets.join(&need, &implied);
            }
            new[*put as usize] = Some(need);
        }
        let ask = |new: &mut Vec<Option<Masks>>, sets: &mut Sets, arg: Arg, need: &Masks| {
            if let Some(node) = choices.of(arg).node() {
                let met = sets.meet(new[node as usize].as_ref(), need);
                new[node as usize] = Some(met);
            }
        };
        for at in (0..n).rev().filter(|at| used[*at]) {
            let node = &list.nodes[at];
            let mut need = new[at].clone();
            if let Some((own, other)) = partners[at] {
                // The next turn needs what this one leaves; and where there is no turn it is what is left.
                let other = if node.op.leaves() { &needs } else { &new }[other as usize].clone();
                if let Some(other) = other {
                    need = Some(sets.meet(need.as_ref(), &other));
                }
                // Masks of a turn are not those of the next.
                let start = list.loops[own].entries.start;
                need = need.map(|need| sets.before(&need, start));
                new[at].clone_from(&need);
            }
            let Some(mut need) = need else { continue };
            match (node.op, &node.args[..]) {
                (Op::Select, &[mask, yes, no]) => {
                    ask(&mut new, sets, mask, &need);
                    ask(&mut new, sets, no, &need);
                    let more = match choices.of(mask).node() {
                        Some(mask) => {
                            let implied = sets.implied(list, choices, mask);
                            sets.join(&need, &implied)
                        }
                        None => need,
                    };
                    ask(&mut new, sets, yes, &more);
                }
                (Op::And, &[a, b]) => {
                    let [a, b] = [a, b].map(|arg| choices.of(arg));
                    let (low, high) = if a.node() <= b.node() { (a, b) } else { (b, a) };
                    ask(&mut new, sets, low, &need);
                    if let Some(mask) = low.node() {
                        let implied = sets.implied(list, choices, mask);
                        need = sets.join(&need, &implied);
                    }
                    ask(&mut new, sets, high, &need);
                }
                (_, args) => args.iter().for_each(|arg| ask(&mut new, sets, *arg, &need)),
            }
        }
        let same = new.iter().zip(&needs).all(|(a, b)| match (a, b) {
            (Some(a), Some(b)) => a == b,
            (None, None) => true,
            _ => false,
        });
        needs = new;
        if same {
            return needs;
        }
    }
    // Loops that settle to nothing: everything matters always.
    used.iter().map(|used| used.then(|| always.clone())).collect()
}

/// Of the masks that an entry needs, the one that fewest others need, if these are worth a jump: of a
/// contact that there is in a turn that goes on, the contact. It stands before the entry, and around it.
fn guards(list: &List, used: &[bool], needs: &[Option<Masks>]) -> Vec<Option<u32>> {
    let loops = list.loop_of();
    let parents = list.parents();
    let around = |mask: u32, at: usize| {
        let (own, mut inner) = (loops[mask as usize], loops[at]);
        loop {
            if inner == own {
                return true;
            }
            match inner {
                Some(index) => inner = parents[index],
                None => return false,
            }
        }
    };
    let mut count = vec![0; list.nodes.len()];
    let stands = |mask: &u32, at: usize| {
        (*mask as usize) < at && list.nodes[*mask as usize].op != Op::Or && around(*mask, at)
    };
    for (at, need) in needs.iter().enumerate().filter(|(at, _)| used[*at]) {
        for mask in need.iter().flat_map(|need| need.iter()).filter(|mask| stands(mask, at)) {
            count[*mask as usize] += 1;
        }
    }
    let choose = |at: usize| {
        let op = list.nodes[at].op;
        if !used[at] || op.enters() || op.leaves() || matches!(op, Op::Input(_)) {
            return None;
        }
        let own = needs[at].as_ref()?.iter().filter(|mask| stands(mask, at));
        let worth = own.filter(|mask| count[**mask as usize] >= WORTH);
        worth.copied().min_by_key(|mask| (count[*mask as usize], *mask))
    };
    (0..list.nodes.len()).map(choose).collect()
}
