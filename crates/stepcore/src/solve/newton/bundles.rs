//! The rows of an island in the layout of Newton's method: number by number instead of row by row,
//! and in bundles of consecutive rows on the same dofs, such as the contacts of two bodies, or on
//! dofs of one chain, such as the friction losses of a leg.

use super::pattern::Pattern;
use super::penalty::Cone;
use crate::model::Span;
use crate::real::array::from_fn;
use crate::real::{Mask, Real};
use crate::solve::rows::{Block, Row, Rows, Set};
use crate::spatial::WIDE;

/// A penalty is huge if A s″ exceeds this. MuJoCo's impedances keep below 1e4, but if a pressed
/// body is almost immovable, A s″ is unbounded.
pub(super) const HUGE: f64 = 1e6;

/// Rows on the same dofs, or on the first of them. Indices of rows and curvatures are relative to
/// the island.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bundle {
    /// Into `dof_lists`.
    pub dofs: Span,
    pub rows: Span,
    /// The first entry of its rows, which are `stride` apart in `Rows::y`, or in `Bundles::filled`.
    pub y: usize,
    pub stride: usize,
    /// Whether its y are padded with zeros: some rows are on the first of the dofs alone, or rows
    /// are padded to whole registers.
    pub filled: bool,
    pub runs: Span,
    /// Its part of `System::curve`.
    pub curve: Span,
    /// Whether every lane has all of its rows.
    pub whole: bool,
}

/// Consecutive rows of a bundle: intervals, or one cone.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    pub rows: Span,
    /// Into `System::curve`: one number per row for intervals, n per row for a cone of n rows.
    pub curve: Span,
    pub cone: Option<usize>,
    /// Whether every lane has all of its rows.
    pub whole: bool,
}

/// Data that stay constant while an island is solved.
pub(super) struct Bundles<R: Real> {
    pub list: Vec<Bundle>,
    pub runs: Vec<Run>,
    pub cones: Vec<Cone<R>>,
    /// Per row: the fields of `Row`.
    pub t: Vec<R>,
    pub inv_c: Vec<R>,
    pub lo: Vec<R>,
    pub hi: Vec<R>,
    /// Per row: lanes that have it.
    pub mask: Vec<R::Mask>,
    /// Lanes in which a row's curvature may be huge: see `Hessian::forget_huge`.
    pub huge: R::Mask,
    /// Entries of `System::curve`.
    pub curves: usize,
    /// The y of padded bundles.
    pub filled: Vec<R>,
}

room!(Bundles<R>: list, runs, cones, t, inv_c, lo, hi, mask, huge, curves, filled);

impl<R: Real> Bundles<R> {
    pub fn new() -> Self {
        Self {
            list: Vec::new(),
            runs: Vec::new(),
            cones: Vec::new(),
            t: Vec::new(),
            inv_c: Vec::new(),
            lo: Vec::new(),
            hi: Vec::new(),
            mask: Vec::new(),
            huge: R::Mask::of(false),
            curves: 0,
            filled: Vec::new(),
        }
    }

    /// Takes the rows of these blocks. `lists`: dof lists, if rows may be padded with zeros; the
    /// nodes of a pile follow from its rows.
    pub fn take(&mut self, blocks: &[usize], rows: &Rows<R>, lists: Option<&[usize]>) {
        self.clear(blocks.iter().map(|b| rows.blocks[*b].rows.len).sum());
        let mut at = 0;
        for block in blocks.iter().map(|b| &rows.blocks[*b]) {
            let own = &rows.rows[block.rows.range()];
            let Some(first) = own.first() else { continue };
            self.take_rows(at, own, block.mask);
            let cone = (block.set != Set::Interval).then(|| {
                self.cones.push(Cone::new(own, block.mu));
                self.cones.len() - 1
            });
            let curve = Span { start: self.curves, len: block.curves() };
            self.curves += curve.len;
            let span = Span { start: at, len: own.len() };
            let run = Run { rows: span, curve, cone, whole: block.mask.all() };
            self.join(first.dofs, first.y, run, lists);
            at += own.len();
        }
        self.fill(blocks, rows, R::ALONE && lists.is_some());
    }

    /// Takes the numbers of some rows, from place `at` on.
    #[inline(always)]
    fn take_rows(&mut self, at: usize, own: &[Row<R>], mask: R::Mask) {
        let places = at..at + own.len();
        let t = self.t[places.clone()].iter_mut().zip(&mut self.inv_c[places.clone()]);
        let bounds = self.lo[places.clone()].iter_mut().zip(&mut self.hi[places.clone()]);
        for ((row, (t, inv_c)), (lo, hi)) in own.iter().zip(t).zip(bounds) {
            *t = row.t;
            *inv_c = row.c.recip_or_zero();
            *lo = row.lo;
            *hi = row.hi;
            self.huge = self.huge.or((*inv_c * row.a).gt(R::of(HUGE)));
        }
        self.mask[places].fill(mask);
    }

    /// Writes the rows of padded bundles; `registers`: pad to whole registers.
    fn fill(&mut self, blocks: &[usize], rows: &Rows<R>, registers: bool) {
        let mut every = blocks.iter().flat_map(|b| &rows.rows[rows.blocks[*b].rows.range()]);
        let mut end = 0;
        for bundle in &mut self.list {
            bundle.stride = bundle.dofs.len;
            if registers {
                (bundle.stride, bundle.filled) = (bundle.dofs.len.next_multiple_of(WIDE), true);
            }
            if bundle.filled {
                bundle.y = end;
                end += bundle.rows.len * bundle.stride;
            }
        }
        self.filled.resize(end, R::zero());
        for bundle in &self.list {
            let own = every.by_ref().take(bundle.rows.len);
            if !bundle.filled {
                own.for_each(drop);
                continue;
            }
            let places = bundle.y..bundle.y + bundle.rows.len * bundle.stride;
            let filled = self.filled[places].chunks_exact_mut(bundle.stride.max(1));
            for (row, filled) in own.zip(filled) {
                fill_up(&rows.y[row.y..row.y + row.dofs.len], filled);
            }
        }
    }

    /// Clears, and reserve room for this many rows.
    fn clear(&mut self, rows: usize) {
        self.list.clear();
        self.runs.clear();
        self.cones.clear();
        for numbers in [&mut self.t, &mut self.inv_c, &mut self.lo, &mut self.hi] {
            numbers.resize(rows, R::zero());
        }
        self.mask.resize(rows, R::Mask::of(false));
        self.huge = R::Mask::of(false);
        self.curves = 0;
    }

    /// Adds a block's rows to the last bundle and its last run, or starts new ones.
    fn join(&mut self, dofs: Span, y: usize, run: Run, lists: Option<&[usize]>) {
        // Its y continue at the end of the bundle's.
        let next =
            |last: &Bundle| last.dofs.len == dofs.len && last.y + last.rows.len * dofs.len == y;
        // All are on one chain, and the zeros are no more than the rows.
        let chained = |last: &Bundle| {
            // Rows that only some lanes have would force masks on the rows of all lanes.
            let alike = R::ALONE || last.whole == run.whole;
            alike
                && lists.is_some_and(|lists| {
                    let (own, other) = (dofs.of(lists), last.dofs.of(lists));
                    let shared = own.len().min(other.len());
                    2 * shared >= own.len().max(other.len()) && own[..shared] == other[..shared]
                })
        };
        match self.list.last_mut() {
            Some(last) if (last.dofs == dofs && next(last)) || chained(last) => {
                last.filled |= !next(last);
                if dofs.len > last.dofs.len {
                    last.dofs = dofs;
                }
                last.rows.len += run.rows.len;
                last.curve.len += run.curve.len;
                last.whole &= run.whole;
                if let Some(before) = self.runs.last_mut() {
                    if before.cone.is_none() && run.cone.is_none() && before.whole == run.whole {
                        before.rows.len += run.rows.len;
                        before.curve.len += run.curve.len;
                        return;
                    }
                }
                last.runs.len += 1;
            }
            _ => self.list.push(Bundle {
                dofs,
                rows: run.rows,
                y,
                stride: dofs.len,
                filled: false,
                runs: Span { start: self.runs.len(), len: 1 },
                curve: run.curve,
                whole: run.whole,
            }),
        }
        self.runs.push(run);
    }

    /// Returns the dofs of each bundle.
    pub fn dofs(&self) -> impl Iterator<Item = Span> + Clone + '_ {
        self.list.iter().map(|bundle| bundle.dofs)
    }

    pub fn runs_of(&self, bundle: &Bundle) -> &[Run] {
        &self.runs[bundle.runs.range()]
    }
}

/// Writes a row's y, followed by zeros.
#[inline(always)]
fn fill_up<R: Real>(y: &[R], out: &mut [R]) {
    let mut at = 0;
    while at + WIDE <= y.len() {
        out[at..at + WIDE].copy_from_slice(&y[at..at + WIDE]);
        at += WIDE;
    }
    for (at, out) in (at..).zip(&mut out[at..]) {
        *out = if at < y.len() { y[at] } else { R::zero() };
        // Keeps the compiler from replacing a few numbers by a call that copies or clears memory.
        std::hint::black_box(());
    }
}

/// An island that is being solved.
#[derive(Clone, Copy)]
pub(super) struct Problem<'a, R: Real> {
    pub pattern: &'a Pattern,
    pub bundles: &'a Bundles<R>,
    /// The rows of the island are those in `blocks`, one after another.
    pub rows: &'a Rows<R>,
    pub blocks: &'a [usize],
}

impl<'a, R: Real> Problem<'a, R> {
    /// Returns the y of a bundle's rows, `stride` apart.
    #[inline(always)]
    pub fn y(&self, bundle: &Bundle) -> &'a [R] {
        let y = if bundle.filled { &self.bundles.filled } else { &self.rows.y };
        &y[bundle.y..bundle.y + bundle.rows.len * bundle.stride]
    }

    /// Iterates over the rows of the island, with the block of each.
    pub fn every(&self) -> impl Iterator<Item = (&'a Row<R>, &'a Block<R>)> {
        let rows = self.rows;
        self.blocks
            .iter()
            .map(|b| &rows.blocks[*b])
            .flat_map(|block| rows.rows[block.rows.range()].iter().map(move |row| (row, block)))
    }

    /// out = y·x by row; x by dof. `own`: scratch, the x of a bundle.
    #[inline(never)]
    pub fn dots(&self, x: &[R], out: &mut [R], own: &mut Vec<R>) {
        for (b, bundle) in self.bundles.list.iter().enumerate() {
            let (y, out) = (self.y(bundle), &mut out[bundle.rows.range()]);
            if R::ALONE {
                if let Some(free) = self.pattern.free(b) {
                    free.dot_each(y, x, out);
                    continue;
                }
                let list = self.pattern.padded(b);
                by_registers!(bundle.stride, products_of((y, list), x, out), {
                    own.clear();
                    own.extend(list.iter().map(|k| x[*k]));
                    products(y, own, out);
                });
                continue;
            }
            own.clear();
            own.extend(self.pattern.list(b).iter().map(|k| x[*k]));
            products(y, own, out);
        }
    }

    /// out += sign · Σ y x; x by row, out by dof. `own`: scratch.
    #[inline(never)]
    pub fn gather(&self, x: &[R], sign: R, out: &mut [R], own: &mut Vec<R>) {
        for (b, bundle) in self.bundles.list.iter().enumerate() {
            let rows = bundle.rows.range();
            let (y, x) = (self.y(bundle), &x[rows.clone()]);
            let list = self.pattern.list(b);
            if R::ALONE {
                if let Some(free) = self.pattern.free(b) {
                    // A pile is one world.
                    free.add_each(y, x, sign, out);
                    continue;
                }
                let list = (self.pattern.padded(b), list.len());
                by_registers!(bundle.stride, add_rows_of((y, list), (sign, x), out), {
                    add_listed(y, list, (sign, x), out, own)
                });
                continue;
            }
            if bundle.whole {
                add_listed(y, (list, list.len()), (sign, x), out, own);
                continue;
            }
            let mask = &self.bundles.mask[rows];
            for ((x, mask), y) in x.iter().zip(mask).zip(y.chunks_exact(bundle.stride.max(1))) {
                for (k, y) in list.iter().zip(y) {
                    out[*k] = R::select(*mask, out[*k] + *y * (sign * *x), out[*k]);
                }
            }
        }
    }
}

/// out = y·x by row for bundles of N registers: four sums, each of every fourth dof, then their sum.
#[inline(always)]
fn products_of<R: Real, const N: usize>((y, list): (&[R], &[usize]), x: &[R], out: &mut [R]) {
    let own = listed::<R, N>(list, x);
    for (out, y) in out.iter_mut().zip(y.chunks_exact(N * WIDE)) {
        let mut sums = [R::zero(); WIDE];
        for (y, x) in y.chunks_exact(WIDE).zip(&own) {
            for k in 0..WIDE {
                sums[k] += y[k] * x[k];
            }
        }
        let [a, b, c, d] = sums;
        *out = (a + b) + (c + d);
    }
}

/// Returns x at the dofs of a list, N registers.
#[inline(always)]
fn listed<R: Real, const N: usize>(list: &[usize], x: &[R]) -> [[R; WIDE]; N] {
    let list = &list[..N * WIDE];
    from_fn(|i| from_fn(|k| x[list[i * WIDE + k]]))
}

/// The same for any number of dofs; `x` in the order of the list.
fn products<R: Real>(y: &[R], x: &[R], out: &mut [R]) {
    let (wide, rest) = x.split_at(x.len() - x.len() % WIDE);
    for (out, y) in out.iter_mut().zip(y.chunks_exact(x.len().max(1))) {
        let (y, last) = y.split_at(wide.len());
        let mut sums = [R::zero(); WIDE];
        for (y, x) in y.chunks_exact(WIDE).zip(wide.chunks_exact(WIDE)) {
            for k in 0..WIDE {
                sums[k] += y[k] * x[k];
            }
        }
        for k in 0..rest.len() {
            sums[k] += last[k] * rest[k];
        }
        let [a, b, c, d] = sums;
        *out = (a + b) + (c + d);
    }
}

/// out += sign · Σ y x over the rows of a bundle of N registers, each dof's sum in their order. The
/// first `len` of the list are dofs of the bundle.
#[inline(always)]
fn add_rows_of<R: Real, const N: usize>(
    (y, (list, len)): (&[R], (&[usize], usize)),
    (sign, x): (R, &[R]),
    out: &mut [R],
) {
    let mut sums = listed::<R, N>(list, out);
    for (x, y) in x.iter().zip(y.chunks_exact(N * WIDE)) {
        let x = sign * *x;
        for (sums, y) in sums.iter_mut().zip(y.chunks_exact(WIDE)) {
            for k in 0..WIDE {
                sums[k] += y[k] * x;
            }
        }
    }
    for (k, sum) in list[..len].iter().zip(sums.as_flattened()) {
        out[*k] = *sum;
    }
}

/// The same for any number of dofs.
fn add_listed<R: Real>(
    y: &[R],
    (list, len): (&[usize], usize),
    (sign, x): (R, &[R]),
    out: &mut [R],
    own: &mut Vec<R>,
) {
    own.clear();
    own.extend(list.iter().map(|k| out[*k]));
    for (x, y) in x.iter().zip(y.chunks_exact(own.len().max(1))) {
        let x = sign * *x;
        own.iter_mut().zip(y).for_each(|(sum, y)| *sum += *y * x);
    }
    list[..len].iter().zip(&*own).for_each(|(k, sum)| out[*k] = *sum);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::rows::Set;
    use crate::solve::tests::{pack, Problem as Given, Random};

    /// Seven intervals, a cone and an interval on the same dofs are one bundle of three runs, with
    /// the same products as the rows.
    #[test]
    fn rows_on_the_same_dofs_are_one_bundle() {
        let mut random = Random::new(31);
        let ones = [1.0; 5];
        let mut given = Given::new(&ones, &ones);
        let mut line = |lo: f64| {
            let y: Vec<f64> = (0..5).map(|_| random.next()).collect();
            (y, 0.1, 0.2, lo, f64::INFINITY)
        };
        for count in [4, 3] {
            given.blocks.push((Set::Interval, 0.0, (0..count).map(|_| line(0.0)).collect()));
        }
        let low = f64::NEG_INFINITY;
        given.blocks.push((Set::Convex, 0.5, vec![line(0.0), line(low), line(low)]));
        given.blocks.push((Set::Interval, 0.0, vec![line(0.0)]));
        let rows = pack::<f64>(&[given]);
        let mut bundles = Bundles::new();
        bundles.take(&[0, 1, 2, 3], &rows, Some(&[0, 1, 2, 3, 4]));
        let runs: Vec<(usize, usize)> =
            bundles.runs.iter().map(|run| (run.rows.len, run.curve.len)).collect();
        assert_eq!((bundles.list.len(), runs), (1, vec![(7, 7), (3, 9), (1, 1)]));
        let mut pattern = Pattern::default();
        pattern.fit(&[0, 1, 2, 3, 4], false, bundles.dofs(), &mut [0; 5]);
        let problem =
            Problem { pattern: &pattern, bundles: &bundles, rows: &rows, blocks: &[0, 1, 2, 3] };
        let x = [0.3, -0.2, 0.7, 0.1, -0.9];
        let (mut along, mut sums) = ([0.0; 11], [0.5; 5]);
        problem.dots(&x, &mut along, &mut Vec::new());
        problem.gather(&along, -2.0, &mut sums, &mut Vec::new());
        let mut want = [0.5; 5];
        for (row, along) in rows.rows.iter().zip(along) {
            let y = &rows.y[row.y..row.y + 5];
            let part = |k: usize| y[k] * x[k];
            assert_eq!(along, ((part(0) + part(4)) + part(1)) + (part(2) + part(3)));
            for (want, y) in want.iter_mut().zip(y) {
                *want += y * (-2.0 * along);
            }
        }
        assert_eq!(sums, want);
    }

    /// Rows on a chain and on its first dofs are one bundle with the same products as the rows; a
    /// row on few of the dofs, and one on others, are not in it.
    #[test]
    fn rows_on_a_chain_are_filled_up() {
        let mut random = Random::new(32);
        let ones = [1.0; 5];
        let mut given = Given::new(&ones, &ones);
        (0..4).for_each(|_| given.limit(&ones, 0.0, 1.0));
        let mut rows = pack::<f64>(&[given]);
        let lists = [0, 1, 2, 3, 4, 0, 1, 2, 0, 1, 3];
        rows.y.clear();
        for (row, (start, len)) in rows.rows.iter_mut().zip([(5, 3), (0, 5), (0, 2), (9, 2)]) {
            (row.dofs, row.y) = (Span { start, len }, rows.y.len());
            rows.y.extend((0..len).map(|_| random.next()));
        }
        let (blocks, mut bundles) = ([0, 1, 2, 3], Bundles::new());
        bundles.take(&blocks, &rows, Some(&lists));
        let counts: Vec<usize> = bundles.list.iter().map(|bundle| bundle.rows.len).collect();
        assert_eq!(counts, [2, 1, 1]);
        let mut pattern = Pattern::default();
        pattern.fit(&lists, false, bundles.dofs(), &mut [0; 5]);
        let problem =
            Problem { pattern: &pattern, bundles: &bundles, rows: &rows, blocks: &blocks };
        let (x, mut along) = ([0.3, -0.2, 0.7, 0.1, -0.9], [0.0; 4]);
        problem.dots(&x, &mut along, &mut Vec::new());
        for (row, along) in rows.rows.iter().zip(along) {
            let y = &rows.y[row.y..row.y + row.dofs.len];
            let want: f64 = row.dofs.of(&lists).iter().zip(y).map(|(k, y)| x[*k] * y).sum();
            assert!((along - want).abs() < 1e-15);
        }
    }
}
