//! The rows of an island as Newton's method reads them: number by number instead of row by row, and
//! in bundles of consecutive rows on the same dofs, such as those of all contacts of two bodies, or on
//! dofs of one chain, such as the friction losses of a leg.

use super::pattern::Pattern;
use super::penalty::Cone;
use crate::model::Span;
use crate::real::{Mask, Real};
use crate::solve::rows::{Rows, Set};
use crate::spatial::WIDE;

/// Rows on the same dofs, or on the first of them. Rows and their curvature are counted within the
/// island.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bundle {
    /// Into `dof_lists`.
    pub dofs: Span,
    pub rows: Span,
    /// The first entry of its rows, which stand `stride` apart in `Rows::y`, or in
    /// `Bundles::filled`.
    pub y: usize,
    pub stride: usize,
    /// Its y are filled up with zeros: some rows are on the first of the dofs alone, or a row has a
    /// whole number of registers.
    pub filled: bool,
    pub runs: Span,
    /// Its part of `System::curve`.
    pub curve: Span,
    /// Every lane has all of its rows.
    pub whole: bool,
}

/// Consecutive rows of a bundle: intervals, or one cone.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    pub rows: Span,
    /// Into `System::curve`: of intervals one number a row; of a cone as many a row as it has rows.
    pub curve: Span,
    pub cone: Option<usize>,
    /// Every lane has all of its rows.
    pub whole: bool,
}

/// What does not change while an island is solved.
pub(super) struct Bundles<R: Real> {
    pub list: Vec<Bundle>,
    pub runs: Vec<Run>,
    pub cones: Vec<Cone<R>>,
    /// By row: what `Row` calls so.
    pub t: Vec<R>,
    pub inv_c: Vec<R>,
    pub lo: Vec<R>,
    pub hi: Vec<R>,
    pub inv_s: Vec<R>,
    pub a: Vec<R>,
    /// By row: A/m, by which the square of an impulse is that of a speed.
    pub per_mass: Vec<R>,
    /// By row: lanes that have it.
    pub mask: Vec<R::Mask>,
    /// Entries of `System::curve`.
    pub curves: usize,
    /// The y of bundles that need zeros.
    pub filled: Vec<R>,
}

room!(Bundles<R>: list, runs, cones, t, inv_c, lo, hi, inv_s, a, per_mass, mask, curves, filled);

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
            inv_s: Vec::new(),
            a: Vec::new(),
            per_mass: Vec::new(),
            mask: Vec::new(),
            curves: 0,
            filled: Vec::new(),
        }
    }

    /// Takes in the rows of these blocks.
    pub fn take(&mut self, blocks: &[usize], rows: &Rows<R>, dof_lists: &[usize]) {
        self.clear();
        for block in blocks.iter().map(|b| &rows.blocks[*b]) {
            let own = &rows.rows[block.rows.range()];
            let Some(first) = own.first() else { continue };
            let (at, whole) = (self.t.len(), block.mask.all());
            let per_mass = R::one() / block.mass;
            self.t.extend(own.iter().map(|row| row.t));
            self.inv_c.extend(own.iter().map(|row| row.c.recip_or_zero()));
            self.lo.extend(own.iter().map(|row| row.lo));
            self.hi.extend(own.iter().map(|row| row.hi));
            self.inv_s.extend(own.iter().map(|row| row.inv_s));
            self.a.extend(own.iter().map(|row| row.a));
            self.per_mass.extend(own.iter().map(|row| row.a * per_mass));
            self.mask.extend(own.iter().map(|_| block.mask));
            let cone = (block.set != Set::Interval).then(|| {
                self.cones.push(Cone::new(own, block.mu));
                self.cones.len() - 1
            });
            let curve = Span { start: self.curves, len: block.curves() };
            self.curves += curve.len;
            let run = Run { rows: Span { start: at, len: own.len() }, curve, cone, whole };
            // The nodes of a heap are those of its rows.
            let lists = (!rows.heap).then_some(dof_lists);
            self.join(first.dofs, first.y, run, lists);
        }
        self.fill(blocks, rows);
    }

    /// Writes the rows of bundles that need zeros.
    fn fill(&mut self, blocks: &[usize], rows: &Rows<R>) {
        let registers = R::ALONE && !rows.heap;
        let mut every = blocks.iter().flat_map(|b| &rows.rows[rows.blocks[*b].rows.range()]);
        for bundle in &mut self.list {
            let own = every.by_ref().take(bundle.rows.len);
            bundle.stride = bundle.dofs.len;
            if registers {
                (bundle.stride, bundle.filled) = (bundle.dofs.len.next_multiple_of(WIDE), true);
            } else if !bundle.filled {
                own.for_each(drop);
                continue;
            }
            bundle.y = self.filled.len();
            for (at, row) in own.enumerate() {
                self.filled.extend_from_slice(&rows.y[row.y..row.y + row.dofs.len]);
                self.filled.resize(bundle.y + (at + 1) * bundle.stride, R::zero());
            }
        }
    }

    fn clear(&mut self) {
        self.list.clear();
        self.runs.clear();
        self.cones.clear();
        for numbers in [
            &mut self.t,
            &mut self.inv_c,
            &mut self.lo,
            &mut self.hi,
            &mut self.inv_s,
            &mut self.a,
            &mut self.per_mass,
        ] {
            numbers.clear();
        }
        self.mask.clear();
        self.filled.clear();
        self.curves = 0;
    }

    /// Adds a block's rows to the last bundle and its last run, or begins new ones. `lists`: of dofs,
    /// where rows may be filled up with zeros.
    fn join(&mut self, dofs: Span, y: usize, run: Run, lists: Option<&[usize]>) {
        // Its y go on where those of the bundle end.
        let next =
            |last: &Bundle| last.dofs.len == dofs.len && last.y + last.rows.len * dofs.len == y;
        // All on one chain, and the zeros are no more than the rows.
        let chained = |last: &Bundle| {
            lists.is_some_and(|lists| {
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

    /// The dofs of each bundle.
    pub fn dofs(&self) -> impl Iterator<Item = Span> + Clone + '_ {
        self.list.iter().map(|bundle| bundle.dofs)
    }

    pub fn runs_of(&self, bundle: &Bundle) -> &[Run] {
        &self.runs[bundle.runs.range()]
    }
}

/// An island that is being solved.
#[derive(Clone, Copy)]
pub(super) struct Problem<'a, R: Real> {
    pub pattern: &'a Pattern,
    pub bundles: &'a Bundles<R>,
    /// Its rows are those of these blocks, one after another.
    pub rows: &'a Rows<R>,
    pub blocks: &'a [usize],
}

impl<'a, R: Real> Problem<'a, R> {
    /// The y of a bundle's rows, `stride` apart.
    #[inline(always)]
    pub fn y(&self, bundle: &Bundle) -> &'a [R] {
        let y = if bundle.filled { &self.bundles.filled } else { &self.rows.y };
        &y[bundle.y..bundle.y + bundle.rows.len * bundle.stride]
    }

    /// out = y·x by row; x by dof. `own`: scratch, the x of a bundle.
    pub fn dots(&self, x: &[R], out: &mut [R], own: &mut Vec<R>) {
        for (b, bundle) in self.bundles.list.iter().enumerate() {
            let (y, out) = (self.y(bundle), &mut out[bundle.rows.range()]);
            if R::ALONE {
                if let Some(free) = self.pattern.free(b) {
                    free.dot_each(y, x, out);
                    continue;
                }
            }
            own.clear();
            own.extend(self.pattern.list(b).iter().map(|k| x[*k]));
            own.resize(bundle.stride, R::zero());
            products(y, own, out);
        }
    }

    /// out += sign · Σ y x; x by row, out by dof. `own`: scratch.
    pub fn gather(&self, x: &[R], sign: R, out: &mut [R], own: &mut Vec<R>) {
        for (b, bundle) in self.bundles.list.iter().enumerate() {
            let rows = bundle.rows.range();
            let (y, x, mask) = (self.y(bundle), &x[rows.clone()], &self.bundles.mask[rows]);
            if R::ALONE {
                if let Some(free) = self.pattern.free(b) {
                    // A heap is one world.
                    free.add_each(y, x, sign, out);
                    continue;
                }
            }
            let list = self.pattern.list(b);
            if bundle.whole {
                own.clear();
                own.extend(list.iter().map(|k| out[*k]));
                own.resize(bundle.stride, R::zero());
                add_rows(y, (sign, x), own);
                list.iter().zip(&*own).for_each(|(k, sum)| out[*k] = *sum);
                continue;
            }
            for ((x, mask), y) in x.iter().zip(mask).zip(y.chunks_exact(bundle.stride.max(1))) {
                for (k, y) in list.iter().zip(y) {
                    out[*k] = R::select(*mask, out[*k] + *y * (sign * *x), out[*k]);
                }
            }
        }
    }
}

/// `$of` of so many registers a row as `$stride` has, a number known to the compiler; `$other` of
/// more, and where a row has no whole number of them.
macro_rules! by_registers {
    ($stride:expr, $of:ident $arguments:tt, $other:expr) => {
        match $stride {
            4 => $of::<R, 1> $arguments,
            8 => $of::<R, 2> $arguments,
            12 => $of::<R, 3> $arguments,
            16 => $of::<R, 4> $arguments,
            20 => $of::<R, 5> $arguments,
            24 => $of::<R, 6> $arguments,
            _ => $other,
        }
    };
}

/// out = y·x by row: four sums, of every fourth dof, and then these.
#[inline(always)]
fn products<R: Real>(y: &[R], x: &[R], out: &mut [R]) {
    if R::ALONE {
        return by_registers!(x.len(), products_of(y, x, out), any_products(y, x, out));
    }
    any_products(y, x, out);
}

#[inline(always)]
fn products_of<R: Real, const N: usize>(y: &[R], x: &[R], out: &mut [R]) {
    let mut own = [[R::zero(); WIDE]; N];
    own.as_flattened_mut().copy_from_slice(x);
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

fn any_products<R: Real>(y: &[R], x: &[R], out: &mut [R]) {
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

/// own += sign · Σ y x over some rows, each dof's sum in their order, four dofs side by side.
#[inline(always)]
fn add_rows<R: Real>(y: &[R], (sign, x): (R, &[R]), own: &mut [R]) {
    if R::ALONE {
        return by_registers!(
            own.len(),
            add_rows_of(y, (sign, x), own),
            add_any(y, (sign, x), own)
        );
    }
    add_any(y, (sign, x), own);
}

#[inline(always)]
fn add_rows_of<R: Real, const N: usize>(y: &[R], (sign, x): (R, &[R]), own: &mut [R]) {
    let mut sums = [[R::zero(); WIDE]; N];
    sums.as_flattened_mut().copy_from_slice(own);
    for (x, y) in x.iter().zip(y.chunks_exact(N * WIDE)) {
        let x = sign * *x;
        for (sums, y) in sums.iter_mut().zip(y.chunks_exact(WIDE)) {
            for k in 0..WIDE {
                sums[k] += y[k] * x;
            }
        }
    }
    own.copy_from_slice(sums.as_flattened());
}

fn add_any<R: Real>(y: &[R], (sign, x): (R, &[R]), own: &mut [R]) {
    let stride = own.len();
    let mut parts = own.chunks_exact_mut(WIDE);
    for (part, first) in (&mut parts).zip((0..).step_by(WIDE)) {
        let (mut sums, mut at) = ([R::zero(); WIDE], first);
        sums.copy_from_slice(part);
        for x in x {
            let (x, y) = (sign * *x, &y[at..at + WIDE]);
            for k in 0..WIDE {
                sums[k] += y[k] * x;
            }
            at += stride;
        }
        part.copy_from_slice(&sums);
    }
    let rest = parts.into_remainder();
    let first = stride - rest.len();
    for (at, sum) in (first..).zip(rest) {
        for (x, y) in x.iter().zip(y.chunks_exact(stride)) {
            *sum += y[at] * (sign * *x);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::rows::Set;
    use crate::solve::tests::{pack, Problem as Given, Random};

    /// Seven intervals, a cone and an interval on the same dofs are one bundle of three runs, whose
    /// products are those of its rows.
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
        bundles.take(&[0, 1, 2, 3], &rows, &[0, 1, 2, 3, 4]);
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

    /// Rows on a chain and on its first dofs are one bundle, whose products are those of its rows; a row
    /// on few of the dofs, and one on others, are not in it.
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
        bundles.take(&blocks, &rows, &lists);
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
