//! Factors of piles against dense elimination, and partial refactoring.

use super::super::tests::EVERY;
use super::bundles::Bundles;
use super::columns::{Columns, Curved};
use super::nodes::{Nodes, NOWHERE};
use super::Newton;
use crate::model::Span;
use crate::solve::limits::Limits;
use crate::solve::pgs::Pgs;
use crate::solve::rows::{Rows, Set};
use crate::solve::solver::Unconstrained;
use crate::solve::tests::{by_sweeps, close, pack, Problem, Random};

/// Bodies of some dofs each, touched by blocks of rows: one body alone, or two together.
struct Heap {
    rows: Rows<f64>,
    lists: Vec<usize>,
    inv_d: Vec<f64>,
}

/// `touches(random)`: the bodies of the next block of `count`, ascending.
fn heap(
    sizes: &[usize],
    count: usize,
    random: &mut Random,
    touches: impl Fn(&mut Random) -> Vec<usize>,
) -> Heap {
    let nv = sizes.iter().sum();
    let inv_d: Vec<f64> = (0..nv).map(|_| 1.0 + 0.5 * random.next()).collect();
    let guess: Vec<f64> = (0..nv).map(|_| random.next()).collect();
    let mut problem = Problem::new(&inv_d, &guess);
    for block in 0..count {
        let mut line = |lo| (vec![0.0; nv], 0.3 * random.next(), 0.05, lo, f64::INFINITY);
        let set = if block % 3 == 0 { Set::Convex } else { Set::Interval };
        let low = if set == Set::Convex { f64::NEG_INFINITY } else { 0.0 };
        problem.blocks.push((set, 0.5, vec![line(0.0), line(low), line(low)]));
    }
    let mut rows = pack::<f64>(&[problem]);
    rows.heap = true;
    rows.y.clear();
    let mut lists = Vec::new();
    for block in rows.blocks.clone() {
        let span = Span { start: lists.len(), len: 0 };
        for body in touches(random) {
            let first: usize = sizes[..body].iter().sum();
            lists.extend(first..first + sizes[body]);
        }
        let span = Span { len: lists.len() - span.start, ..span };
        for row in &mut rows.rows[block.rows.range()] {
            (row.dofs, row.y, row.a) = (span, rows.y.len(), 0.0);
            for k in span.of(&lists) {
                let y = random.next();
                row.a += y * y * inv_d[*k];
                rows.y.push(y);
            }
            row.inv_s = 1.0 / (row.a + row.c);
        }
    }
    Heap { rows, lists, inv_d }
}

fn two_of(count: usize) -> impl Fn(&mut Random) -> Vec<usize> {
    move |random| {
        let (a, b) = (random.below(count), random.below(count));
        let mut both = vec![a.min(b), a.max(b)];
        both.dedup();
        both
    }
}

fn bundles_of(heap: &Heap) -> Bundles<f64> {
    let blocks: Vec<usize> = (0..heap.rows.blocks.len()).collect();
    let mut bundles = Bundles::new();
    bundles.take(&blocks, &heap.rows, None);
    bundles
}

fn nodes_of(heap: &Heap, bundles: &Bundles<f64>) -> Nodes {
    let spans: Vec<Span> = bundles.list.iter().map(|bundle| bundle.dofs).collect();
    let mut nodes = Nodes::default();
    nodes.fit(&heap.lists, &spans, &mut vec![NOWHERE; heap.rows.u.len()]);
    nodes
}

/// Returns a curvature for every row: for cones symmetric and positive; else a number, sometimes 0.
fn curvature(heap: &Heap, random: &mut Random) -> Vec<f64> {
    let mut curve = Vec::new();
    for block in &heap.rows.blocks {
        let v: Vec<f64> = (0..block.rows.len).map(|_| random.next()).collect();
        if block.set == Set::Interval {
            curve.extend(v.iter().map(|v| v.max(0.0)));
        } else {
            curve.extend(v.iter().flat_map(|a| v.iter().map(move |b| a * b)));
        }
    }
    curve
}

/// Per block: the first entry of its curvature.
fn starts(heap: &Heap) -> Vec<usize> {
    let mut starts = vec![0];
    for block in &heap.rows.blocks {
        starts.push(starts[starts.len() - 1] + block.curves());
    }
    starts
}

/// Returns H x, from the definition.
fn times(heap: &Heap, d: &[f64], curve: &[f64], x: &[f64]) -> Vec<f64> {
    let mut out: Vec<f64> = d.iter().zip(x).map(|(d, x)| d * x).collect();
    for (block, start) in heap.rows.blocks.iter().zip(starts(heap)) {
        let own = &heap.rows.rows[block.rows.range()];
        let curve = &curve[start..start + block.curves()];
        let dot = |i: usize| {
            let list = own[i].dofs.of(&heap.lists);
            list.iter().zip(&heap.rows.y[own[i].y..]).map(|(k, y)| x[*k] * y).sum::<f64>()
        };
        for i in 0..own.len() {
            let pull: f64 = if block.set == Set::Interval {
                curve[i] * dot(i)
            } else {
                (0..own.len()).map(|j| curve[i * own.len() + j] * dot(j)).sum()
            };
            for (k, y) in own[i].dofs.of(&heap.lists).iter().zip(&heap.rows.y[own[i].y..]) {
                out[*k] += pull * y;
            }
        }
    }
    out
}

#[test]
fn factors_solve_what_was_built() {
    let mut random = Random::new(5);
    for case in 0..40 {
        let sizes: Vec<usize> =
            (0..12).map(|i| if case % 2 == 0 { 6 } else { 1 + (i + case) % 7 }).collect();
        let heap = heap(&sizes, 5 + case, &mut random, two_of(12));
        let bundles = bundles_of(&heap);
        let nodes = nodes_of(&heap, &bundles);
        let d: Vec<f64> = heap.inv_d.iter().map(|inv| 1.0 / inv).collect();
        let local: Vec<f64> = nodes.dofs.iter().map(|k| d[*k]).collect();
        let starts = starts(&heap);
        let mut columns = Columns::new();
        columns.start(&nodes);
        let mut curve = curvature(&heap, &mut random);
        for turn in 0..4 {
            let curved = Curved { bundles: &bundles, y: &heap.rows.y, curve: &curve };
            columns.factor(&nodes, &local, curved);
            // A partially refactored matrix equals a newly computed one.
            let mut whole = Columns::new();
            whole.start(&nodes);
            whole.factor(&nodes, &local, curved);
            assert!(columns.same_bits(&whole));
            let mut x = vec![0.0; d.len()];
            nodes.dofs.iter().for_each(|k| x[*k] = random.next());
            let b = times(&heap, &d, &curve, &x);
            let mut got: Vec<f64> = nodes.dofs.iter().map(|k| b[*k]).collect();
            columns.solve(&nodes, &mut got);
            for (k, got) in nodes.dofs.iter().zip(&got) {
                close(*got, x[*k], 1e-11);
            }
            // Another curvature in one block.
            let own = starts[turn]..starts[turn + 1];
            curve[own].iter_mut().for_each(|bend| *bend *= 2.0);
        }
    }
}

/// A chain of bodies has no fill-in: a block below the diagonal for each but the last, whatever the
/// order in which contacts are listed. Numbers are counts: 36 per block.
#[test]
fn a_stack_fills_nothing() {
    let mut random = Random::new(9);
    let sizes = [6; 30];
    let heap = heap(&sizes, 400, &mut random, |random| {
        let a = random.below(29);
        vec![a, a + 1]
    });
    let nodes = nodes_of(&heap, &bundles_of(&heap));
    assert_eq!(nodes.count(), 30);
    assert_eq!(nodes.numbers, 36 * (30 + 29));
}

#[test]
fn heaps_equal_converged_pgs() {
    let mut random = Random::new(8);
    for case in 0..10 {
        let sizes: Vec<usize> = (0..15).map(|i| if case < 5 { 6 } else { 1 + i % 7 }).collect();
        let mut heap = heap(&sizes, 40, &mut random, two_of(15));
        let mut want = pack::<f64>(&[Problem::new(&[], &[])]);
        (want.rows, want.blocks) = (heap.rows.rows.clone(), heap.rows.blocks.clone());
        (want.y, want.u) = (heap.rows.y.clone(), heap.rows.u.clone());
        let guess = heap.rows.u.clone();
        let limits = Limits { momentum: true, ..EVERY };
        by_sweeps(&mut Pgs::new(), &heap.lists, &heap.inv_d, &mut want, limits);
        let newton = Limits { sweeps: 50, tolerance: 0.0, ..limits };
        let free = Unconstrained { dof_lists: &heap.lists, inv_d: &heap.inv_d, guess: &guess };
        Newton::new().solve(free, &mut heap.rows, newton).unwrap();
        assert!(heap.rows.residual(&heap.lists) < 1e-13);
        for (a, b) in heap.rows.u.iter().zip(&want.u) {
            close(*a, *b, 1e-9);
        }
    }
}
