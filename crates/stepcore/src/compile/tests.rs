//! Code against a reading of its list, operation by operation: random lists, every instruction set here.

use super::memory::Aligned;
use super::split::split;
use super::{Code, Isa, List};
use crate::real::traced::{Arg, Facts, Loop, Node, Op};
use crate::real::Real;

struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }
    fn below(&mut self, most: usize) -> usize {
        (self.next() >> 20) as usize % most
    }
    fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64 * 4.0 - 2.0
    }
}

/// What a list computes in some worlds side by side.
struct Reader<'a> {
    list: &'a List,
    single: bool,
    lanes: usize,
    values: Vec<Vec<f64>>,
}

impl Reader<'_> {
    fn get(&self, arg: Arg, lane: usize) -> f64 {
        match arg {
            Arg::Known(value) => value,
            Arg::Node(node) => self.values[node as usize][lane],
        }
    }

    fn rounded(&self, value: f64) -> f64 {
        if self.single {
            f64::from(value as f32)
        } else {
            value
        }
    }

    fn entry(&self, at: usize, lane: usize, state: &[Vec<f64>]) -> f64 {
        let Node { op, args, .. } = &self.list.nodes[at];
        let x = |index: usize| self.get(args[index], lane);
        let truth = |value: bool| if value { 1.0 } else { 0.0 };
        self.rounded(match op {
            Op::Input(place) => state[*place as usize][lane],
            Op::Parameter(_) => unreachable!("its place is known"),
            Op::Put(_) => unreachable!("nobody asks for a number between parts"),
            Op::Enter | Op::EnterMask | Op::Leave | Op::LeaveMask => x(0),
            Op::Add => x(0) + x(1),
            Op::Sub => x(0) - x(1),
            Op::Mul => x(0) * x(1),
            Op::Div => x(0) / x(1),
            Op::Neg => -x(0),
            Op::Sqrt => x(0).sqrt(),
            Op::Sin => Real::sin_cos(x(0)).0,
            Op::Cos => Real::sin_cos(x(0)).1,
            Op::Atan2 => Real::atan2(x(0), x(1)),
            Op::Pow => Real::powf(x(0), x(1)),
            Op::Select => return if x(0) != 0.0 { x(1) } else { x(2) },
            Op::Max => return if x(0) < x(1) { x(1) } else { x(0) },
            Op::Min => return if x(1) < x(0) { x(1) } else { x(0) },
            Op::Lt => truth(x(0) < x(1)),
            Op::Le => truth(x(0) <= x(1)),
            Op::Finite => truth(x(0).is_finite()),
            Op::And => truth(x(0) != 0.0 && x(1) != 0.0),
            Op::Or => truth(x(0) != 0.0 || x(1) != 0.0),
            Op::Not => truth(x(0) == 0.0),
        })
    }

    fn stretch(&mut self, from: usize, to: usize, state: &[Vec<f64>], inside: Option<usize>) {
        let mut at = from;
        while at < to {
            let loops = self.list.loops.iter().enumerate();
            let mut own = loops.filter(|(index, own)| {
                own.entries.start == at && inside.is_none_or(|inside| *index > inside)
            });
            if let Some((index, own)) = own.next() {
                let own = own.clone();
                self.turns(index, &own, state);
                at = own.entries.end;
                continue;
            }
            // What a loop leaves is there when it is over.
            if !self.list.nodes[at].op.leaves() {
                for lane in 0..self.lanes {
                    self.values[at][lane] = self.entry(at, lane, state);
                }
            }
            at += 1;
        }
    }

    fn turns(&mut self, index: usize, own: &Loop, state: &[Vec<f64>]) {
        let Loop { entries, most, changed, live } = own;
        let lanes = self.lanes;
        let set = |reader: &mut Self, values: Vec<Vec<f64>>| {
            for ((enter, _), value) in changed.iter().zip(values) {
                reader.values[*enter as usize] = value;
            }
        };
        let all = |reader: &Self, of: fn(&(u32, u32)) -> u32| -> Vec<Vec<f64>> {
            let read = |both| reader.list.nodes[of(both) as usize].args[0];
            changed
                .iter()
                .map(|both| (0..lanes).map(|l| reader.get(read(both), l)).collect())
                .collect()
        };
        let before = all(self, |both| both.0);
        set(self, before);
        let first = entries.start + changed.len();
        for _ in 0..*most {
            if self.values[changed[*live].0 as usize].iter().all(|x| *x == 0.0) {
                break;
            }
            self.stretch(first, entries.end, state, Some(index));
            let after = all(self, |both| both.1);
            set(self, after);
        }
        for (enter, leave) in changed {
            self.values[*leave as usize] = self.values[*enter as usize].clone();
        }
    }
}

/// A list as a trace might write it, of all kinds of entries, with choices, loops and loops in loops.
fn random(seed: u64, size: usize) -> List {
    let mut random = Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
    let mut list = List::default();
    let inputs = 6;
    let push = |list: &mut List, op: Op, args: Vec<Arg>| {
        list.nodes.push(Node { op, args, facts: Facts::NOTHING });
        list.nodes.len() as u32 - 1
    };
    let (mut numbers, mut masks) = (vec![], vec![]);
    for place in 0..inputs {
        numbers.push(push(&mut list, Op::Input(place), vec![]));
    }
    masks.push(push(&mut list, Op::Lt, vec![Arg::Node(0), Arg::Node(1)]));
    // (loop, numbers and masks outside, what changes: is it a mask)
    let mut open: Vec<(usize, usize, usize, Vec<bool>)> = vec![];
    while list.nodes.len() < size || !open.is_empty() {
        let pick = |random: &mut Random, from: &[u32]| {
            let back = random.below(from.len().min(12));
            let at =
                if random.below(4) == 0 { random.below(from.len()) } else { from.len() - 1 - back };
            from[at]
        };
        let number = |random: &mut Random| {
            if random.below(6) == 0 {
                Arg::Known(f64::from(random.unit() as f32))
            } else {
                Arg::Node(pick(random, &numbers))
            }
        };
        let mask = |random: &mut Random| Arg::Node(pick(random, &masks));
        let (x, y, m) = (number(&mut random), number(&mut random), mask(&mut random));
        let choice = random.below(100);
        if choice < 2 && open.len() < 2 && list.nodes.len() < size {
            let start = list.nodes.len();
            let index = list.loops.len();
            let (outer_numbers, outer_masks) = (numbers.len(), masks.len());
            let mut kinds = vec![];
            let mut changed = vec![];
            for k in 0..4 {
                let kind = k == 3;
                let before = if kind { mask(&mut random) } else { number(&mut random) };
                let op = if kind { Op::EnterMask } else { Op::Enter };
                changed.push((op, before));
                kinds.push(kind);
            }
            list.loops.push(Loop { entries: start..start, most: 3, changed: vec![], live: 3 });
            for (op, before) in changed {
                let entry = push(&mut list, op, vec![before]);
                list.loops[index].changed.push((entry, entry));
                if op == Op::Enter {
                    numbers.push(entry)
                } else {
                    masks.push(entry)
                }
            }
            open.push((index, outer_numbers, outer_masks, kinds));
            continue;
        }
        let ends = choice < 4 || list.nodes.len() > size + 40;
        if let (true, Some((index, outer_numbers, outer_masks, kinds))) =
            (ends, open.last().cloned())
        {
            open.pop();
            let after: Vec<Arg> = kinds
                .iter()
                .map(|kind| if *kind { mask(&mut random) } else { number(&mut random) })
                .collect();
            let end = list.nodes.len();
            list.loops[index].entries.end = end;
            numbers.truncate(outer_numbers);
            masks.truncate(outer_masks);
            for (k, (kind, after)) in kinds.iter().zip(after).enumerate() {
                let op = if *kind { Op::LeaveMask } else { Op::Leave };
                let entry = push(&mut list, op, vec![after]);
                list.loops[index].changed[k].1 = entry;
                if *kind {
                    masks.push(entry)
                } else {
                    numbers.push(entry)
                }
            }
            continue;
        }
        let (op, args) = match choice {
            0..=29 => ([Op::Add, Op::Sub, Op::Mul][choice % 3], vec![x, y]),
            30..=32 => (Op::Div, vec![x, y]),
            33..=36 => (Op::Neg, vec![x]),
            37..=38 => (Op::Sqrt, vec![x]),
            39..=40 => ([Op::Sin, Op::Cos][choice % 2], vec![x]),
            41 => (Op::Atan2, vec![x, y]),
            42 => (Op::Pow, vec![x, y]),
            43..=48 => ([Op::Max, Op::Min][choice % 2], vec![x, y]),
            49..=56 => ([Op::Lt, Op::Le][choice % 2], vec![x, y]),
            57 => (Op::Finite, vec![x]),
            58..=66 => ([Op::And, Op::And, Op::Or][choice % 3], vec![m, mask(&mut random)]),
            67 => (Op::Not, vec![m]),
            _ => (Op::Select, vec![m, x, y]),
        };
        let entry = push(&mut list, op, args);
        if op.is_mask() {
            masks.push(entry)
        } else {
            numbers.push(entry)
        }
    }
    for _ in 0..inputs {
        let from = numbers[numbers.len() - 1 - random.below(numbers.len().min(20))];
        list.wanted.push((Arg::Node(from), 1e300));
    }
    list
}

fn sets() -> Vec<Isa> {
    let every = [(false, false), (false, true), (true, false), (true, true)];
    let own = Isa::of_this_machine(false);
    let can = |wide: bool| own.is_some_and(|own| own.wide || !wide);
    let set = |(wide, single)| can(wide).then_some(Isa { wide, single });
    every.into_iter().filter_map(set).collect()
}

fn compare(seed: u64, size: usize, isa: Isa) {
    check(&random(seed, size), seed, size, isa);
}

fn check(list: &List, seed: u64, size: usize, isa: Isa) {
    let mut numbers = Random(seed + 77);
    let places = list.places();
    let number = |x: f64| if isa.single { f64::from(x as f32) } else { x };
    let state: Vec<Vec<f64>> =
        (0..places).map(|_| (0..isa.lanes()).map(|_| number(numbers.unit())).collect()).collect();
    let mut reader = Reader {
        list,
        single: isa.single,
        lanes: isa.lanes(),
        values: vec![vec![0.0; isa.lanes()]; list.nodes.len()],
    };
    reader.stretch(0, list.nodes.len(), &state, None);
    let codes: Vec<Code> = split(list.clone(), places as u32)
        .iter()
        .map(|part| Code::of(part, isa).unwrap_or_else(|| panic!("no code for {seed}")))
        .collect();
    let most = |which: usize| codes.iter().map(|code| code.sizes[which]).max().unwrap_or(0);
    let mut memory = [2, 3].map(|which| Aligned::new(most(which)));
    for (place, values) in state.iter().enumerate() {
        for (lane, value) in values.iter().enumerate() {
            let at = place * crate::real::PACK + lane * isa.size();
            let bytes = memory[0].bytes_mut();
            if isa.single {
                bytes[at..at + 4].copy_from_slice(&(*value as f32).to_le_bytes());
            } else {
                bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
            }
        }
    }
    // Memory holds what it happens to.
    memory[1].bytes_mut().fill(0x5A);
    let left = codes.iter().map(|code| code.run(&mut memory, 0, 1)).sum();
    let wanted: Vec<Vec<f64>> = list
        .wanted
        .iter()
        .map(|(arg, _)| (0..isa.lanes()).map(|lane| reader.get(*arg, lane)).collect())
        .collect();
    let limit = if isa.single { f64::INFINITY } else { 1e300 };
    let right = wanted.iter().flatten().all(|x| x.abs() <= limit);
    assert_eq!(u64::from(!right), left, "{seed} {isa:?}: {wanted:?}");
    for (place, values) in wanted.iter().enumerate().filter(|_| right) {
        for (lane, want) in values.iter().enumerate() {
            let at = place * crate::real::PACK + lane * isa.size();
            let bytes = memory[0].bytes();
            let got = if isa.single {
                f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]).into()
            } else {
                f64::from_le_bytes(std::array::from_fn(|k| bytes[at + k]))
            };
            assert!(
                got.to_bits() == want.to_bits() || got.is_nan() && want.is_nan(),
                "{seed} {isa:?} of {size}: place {place} lane {lane}: {got} instead of {want}"
            );
        }
    }
}

/// A list in parts, cut where no loop is under way.
#[test]
fn parts_compute_what_their_list_says() {
    for seed in 1..300 {
        let size = 60 + (seed as usize * 7) % 900;
        let mut list = random(seed, size);
        let whole = |at: &usize| {
            list.loops.iter().all(|own| {
                let end = own.changed.iter().map(|(_, leave)| *leave as usize).max().unwrap_or(0);
                *at <= own.entries.start || *at > end.max(own.entries.end)
            })
        };
        let places: Vec<usize> = (1..list.nodes.len()).filter(whole).collect();
        let mut random = Random(seed + 7);
        let mut cuts: Vec<usize> =
            (0..1 + seed as usize % 4).map(|_| places[random.below(places.len())]).collect();
        cuts.sort_unstable();
        cuts.dedup();
        list.cuts = cuts;
        sets().into_iter().for_each(|isa| check(&list, seed, size, isa));
    }
}

#[test]
fn code_computes_what_its_list_says() {
    for isa in sets() {
        for seed in 1..400 {
            compare(seed, 12 + (seed as usize * 7) % 900, isa);
        }
    }
}
