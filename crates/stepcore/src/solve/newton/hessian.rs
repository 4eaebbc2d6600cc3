//! The Hessian D + Σ y s″ yᵀ of one island, and LᵀDL without square roots.
//!
//! Computed once for each solve; during the iteration, rows that change zones are added or
//! subtracted. Subtracting leaves rounding: if the subtracted part was huge, the sum is recomputed.

use super::bundles::{Bundle, Problem, Run, HUGE};
use super::pattern::{Listed, Pattern};
use crate::real::array::{from_fn, map};
use crate::real::{Mask, Real};
use crate::solve::rows::{CONE, NARROW, PLANAR, SPINNING};
use crate::spatial::{subtract_all, WIDE};

/// Numbers on a pattern: the matrix, and its factors.
pub(super) struct Hessian<R: Real> {
    /// D + Σ y s″ yᵀ, and the s″ that are in it.
    entries: Vec<R>,
    curve: Vec<R>,
    /// DL of LᵀDL, and 1/D by dof.
    factors: Vec<R>,
    inverse: Vec<R>,
    /// Rows to factor again.
    stale: Vec<bool>,
    added: Added<R>,
}

/// The addition to a bundle's part of the matrix: Σ y · (s″ y)ᵀ, symmetric in total.
struct Added<R: Real> {
    /// Per row: the start of its y in the bundle, and the lanes in which it counts.
    rows: Vec<(usize, R::Mask)>,
    /// Per row: s″ y, in `stride` numbers, meaningless beyond the dofs.
    wy: Vec<R>,
    stride: usize,
}

room!(Hessian<R>: entries, curve, factors, inverse, stale, added);
room!(Added<R>: rows, wy, stride);

impl<R: Real> Hessian<R> {
    pub fn new() -> Self {
        Self {
            entries: Vec::new(),
            curve: Vec::new(),
            factors: Vec::new(),
            inverse: Vec::new(),
            stale: Vec::new(),
            added: Added { rows: Vec::new(), wy: Vec::new(), stride: 0 },
        }
    }

    /// Set to D alone.
    pub fn start(&mut self, pattern: &Pattern, d: &[R], curves: usize) {
        let fill = |list: &mut Vec<R>, len: usize| {
            list.clear();
            list.resize(len, R::zero());
        };
        fill(&mut self.entries, pattern.size);
        fill(&mut self.curve, curves);
        for (i, d) in d.iter().enumerate() {
            self.entries[pattern.start[i] + pattern.depth[i]] = *d;
        }
        self.factors.resize(pattern.size, R::zero());
        self.inverse.resize(d.len(), R::zero());
        self.stale.clear();
        self.stale.resize(d.len(), true);
    }

    /// Factors D + Σ y s″ yᵀ: adds what has changed since the last call. `changed`: whether each run
    /// may have changed; false for all afterwards.
    #[inline(never)]
    pub fn make(&mut self, problem: Problem<R>, d: &[R], (curve, changed): (&[R], &mut [bool])) {
        if self.forget_huge(problem, d, curve) {
            changed.fill(true);
        }
        for (b, bundle) in problem.bundles.list.iter().enumerate() {
            let changed = &mut changed[bundle.runs.range()];
            if !changed.contains(&true) {
                continue;
            }
            let y = problem.y(bundle);
            self.added.start(bundle);
            for (run, changed) in problem.bundles.runs_of(bundle).iter().zip(changed) {
                if !std::mem::replace(changed, false) {
                    continue;
                }
                let curves = (run.curve.of(&self.curve), run.curve.of(curve));
                let first = (run.rows.start - bundle.rows.start) * bundle.stride;
                let own = (&y[first..], bundle.stride);
                let mask = &problem.bundles.mask[run.rows.range()];
                self.added.take(run, (first, own), curves, mask);
                self.curve[run.curve.range()].copy_from_slice(run.curve.of(curve));
            }
            if !self.added.rows.is_empty() {
                self.add(problem.pattern, b, y);
            }
        }
        self.factor(problem.pattern);
    }

    /// Restarts from D in lanes where a huge part changes; returns whether there are any.
    fn forget_huge(&mut self, problem: Problem<R>, d: &[R], curve: &[R]) -> bool {
        if problem.bundles.huge.none() {
            return false;
        }
        let mut huge = R::Mask::of(false);
        let mut every = problem.every();
        for run in &problem.bundles.runs {
            let (old, new) = (run.curve.of(&self.curve), run.curve.of(curve));
            // For a cone, the diagonal shows whether it is huge.
            let apart = if run.cone.is_some() { run.rows.len + 1 } else { 1 };
            for (i, (row, _)) in every.by_ref().take(run.rows.len).enumerate() {
                let (old, new) = (old[i * apart], new[i * apart]);
                let other = (new - old).abs().gt(R::zero());
                huge = huge.or(other.and((old * row.a).gt(R::of(HUGE))));
            }
        }
        if huge.none() {
            return false;
        }
        self.stale.fill(true);
        for x in self.entries.iter_mut().chain(&mut self.curve) {
            *x = R::select(huge, R::zero(), *x);
        }
        for (i, d) in d.iter().enumerate() {
            let x = &mut self.entries[problem.pattern.start[i] + problem.pattern.depth[i]];
            *x = R::select(huge, *d, *x);
        }
        true
    }

    /// Adds the collected rows of a bundle.
    fn add(&mut self, pattern: &Pattern, bundle: usize, y: &[R]) {
        let Self { entries, added, stale, .. } = self;
        let listed = pattern.bundles[bundle];
        let lines = listed.list.of(&pattern.lists);
        lines.iter().for_each(|i| stale[*i] = true);
        // Lanes already fill the registers.
        let high = if R::ALONE { WIDE } else { 1 };
        for at in (0..lines.len()).step_by(high) {
            match high.min(lines.len() - at) {
                1 => added.add_lines::<1>(entries, at, y, (pattern, listed)),
                2 => added.add_lines::<2>(entries, at, y, (pattern, listed)),
                3 => added.add_lines::<3>(entries, at, y, (pattern, listed)),
                _ => added.add_lines::<WIDE>(entries, at, y, (pattern, listed)),
            }
        }
    }

    /// H = LᵀDL: factor rows that changed, and the rows above that they reach.
    #[inline(never)]
    fn factor(&mut self, pattern: &Pattern) {
        let Self { entries, factors, inverse, stale, .. } = self;
        for i in (0..pattern.dofs.len()).rev() {
            if !std::mem::replace(&mut stale[i], false) {
                continue;
            }
            let (start, depth) = (pattern.start[i], pattern.depth[i]);
            // With the padding behind the row, no numbers are left over.
            let len = if R::ALONE { (depth + 1).next_multiple_of(WIDE) } else { depth + 1 };
            let (before, below) = factors.split_at_mut(start + len);
            let (own, entries) = (&mut before[start..], &entries[start..start + len]);
            // The multiplier of a row below, and the start of its DL.
            let source = |k: usize| {
                let row = &below[pattern.start[k] - start - len..][..len];
                (row[depth] * inverse[k], row)
            };
            let rest = &pattern.below[pattern.below_start[i]..pattern.below_start[i + 1]];
            let registers = if R::FILLS { len } else { 0 };
            by_registers!(registers, less((entries, own), rest, source), {
                own.copy_from_slice(entries);
                less_any(own, rest, source);
            });
            inverse[i] = R::one() / own[depth];
            if let Some(parent) = depth.checked_sub(1) {
                stale[pattern.path[start + parent]] = true;
            }
        }
    }

    /// x ← H⁻¹ x.
    pub fn solve(&self, pattern: &Pattern, x: &mut [R]) {
        let row = |k: usize| {
            let own = pattern.start[k]..pattern.start[k] + pattern.depth[k];
            pattern.path[own.clone()].iter().zip(&self.factors[own])
        };
        for k in (0..x.len()).rev() {
            let factor = x[k] * self.inverse[k];
            for (j, dl) in row(k) {
                x[*j] -= *dl * factor;
            }
            x[k] = factor;
        }
        for k in 0..x.len() {
            let sum = row(k).fold(R::zero(), |sum, (j, dl)| sum + *dl * x[*j]);
            x[k] -= self.inverse[k] * sum;
        }
    }
}

impl<R: Real> Added<R> {
    /// Starts a bundle without rows.
    fn start(&mut self, bundle: &Bundle) {
        self.stride = bundle.dofs.len.next_multiple_of(WIDE);
        self.rows.clear();
        let most = bundle.rows.len * self.stride;
        if self.wy.len() < most {
            self.wy.resize(most, R::zero());
        }
    }

    /// Collects the rows of a run with changed curvature; their y start at `first` in the bundle.
    #[inline(always)]
    fn take(
        &mut self,
        run: &Run,
        (first, own): (usize, (&[R], usize)),
        (old, new): (&[R], &[R]),
        mask: &[R::Mask],
    ) {
        let changed = |(old, new): (&R, &R)| (*new - *old).abs().gt(R::zero());
        if run.cone.is_none() {
            for (i, (old, new)) in old.iter().zip(new).enumerate() {
                if changed((old, new)).any() {
                    let (y, stride) = (&own.0[i * own.1..], own.1);
                    let wy = &mut self.wy[self.rows.len() * self.stride..][..self.stride];
                    let bend = *new - *old;
                    let parts = wy.chunks_exact_mut(WIDE).zip(y[..stride].chunks(WIDE));
                    parts.for_each(|(wy, y)| scale(bend, y, wy));
                    self.rows.push((first + i * stride, mask[i]));
                }
            }
            return;
        }
        let some = old.iter().zip(new).map(changed);
        if some.fold(R::Mask::of(false), |some, new| some.or(new)).none() {
            return;
        }
        let wy = &mut self.wy[self.rows.len() * self.stride..];
        match mask.len() {
            PLANAR => bend_cone::<R, PLANAR>((old, new), own, (wy, self.stride)),
            NARROW => bend_cone::<R, NARROW>((old, new), own, (wy, self.stride)),
            SPINNING => bend_cone::<R, SPINNING>((old, new), own, (wy, self.stride)),
            CONE => bend_cone::<R, CONE>((old, new), own, (wy, self.stride)),
            _ => bend_some((old, new), own, (wy, self.stride)),
        }
        for (i, mask) in mask.iter().enumerate() {
            self.rows.push((first + i * own.1, *mask));
        }
    }

    /// Adds N lines of Σ y · (s″ y)ᵀ from line `at` on, up to the diagonal, one row after another:
    /// so a sum is independent of the bundling of rows.
    #[inline(never)]
    fn add_lines<const N: usize>(
        &self,
        entries: &mut [R],
        at: usize,
        y: &[R],
        (pattern, Listed { list, places }): (&Pattern, Listed),
    ) {
        if let Some(first) = places {
            return self.add_places::<N>(entries, at, y, &pattern.places[first..]);
        }
        let lines = &list.of(&pattern.lists)[at..];
        let begin: [usize; N] = from_fn(|line| pattern.start[lines[line]]);
        // The block of the diagonal ends with the padding behind its rows.
        for from in (0..=at).step_by(WIDE) {
            let place = |line: usize| begin[line] + from..begin[line] + from + WIDE;
            let mut sums = [[R::zero(); WIDE]; N];
            for line in 0..N {
                sums[line].copy_from_slice(&entries[place(line)]);
            }
            self.add_block(&mut sums, y, at, from);
            for line in 0..N {
                entries[place(line)].copy_from_slice(&sums[line]);
            }
        }
    }

    /// The same for lines whose entries have explicit places.
    fn add_places<const N: usize>(&self, entries: &mut [R], at: usize, y: &[R], places: &[usize]) {
        for from in (0..=at).step_by(WIDE) {
            // Lines before a line are as long as their number.
            let own = |line: usize| {
                let line = at + line;
                let begin = line * (line + 1) / 2;
                &places[begin + from..begin + (line + 1).min(from + WIDE)]
            };
            let mut sums = [[R::zero(); WIDE]; N];
            for line in 0..N {
                own(line)
                    .iter()
                    .zip(&mut sums[line])
                    .for_each(|(place, sum)| *sum = entries[*place]);
            }
            self.add_block(&mut sums, y, at, from);
            for line in 0..N {
                own(line).iter().zip(&sums[line]).for_each(|(place, sum)| entries[*place] = *sum);
            }
        }
    }

    /// Adds the part of N lines from `at` on, in columns from `from` on.
    #[inline(always)]
    fn add_block<const N: usize>(
        &self,
        sums: &mut [[R; WIDE]; N],
        y: &[R],
        at: usize,
        from: usize,
    ) {
        for ((row, mask), wy) in self.rows.iter().zip(self.wy.chunks_exact(self.stride)) {
            let (left, wy) = (&y[row + at..][..N], &wy[from..][..WIDE]);
            for line in 0..N {
                for i in 0..WIDE {
                    let new = sums[line][i] + left[line] * wy[i];
                    sums[line][i] =
                        if R::ALONE { new } else { R::select(*mask, new, sums[line][i]) };
                }
            }
        }
    }
}

/// own = from − Σ by · row over the rows below, N registers of each.
#[inline(always)]
fn less<'a, R: Real, const N: usize>(
    (from, own): (&[R], &mut [R]),
    below: &[usize],
    source: impl Fn(usize) -> (R, &'a [R]),
) {
    let mut sums: [[R; WIDE]; N] = from_fn(|i| from_fn(|k| from[i * WIDE + k]));
    for (by, row) in below.iter().map(|k| source(*k)) {
        let row = &row[..N * WIDE];
        for i in 0..N {
            for k in 0..WIDE {
                sums[i][k] -= by * row[i * WIDE + k];
            }
        }
    }
    own[..N * WIDE].copy_from_slice(sums.as_flattened());
}

/// own −= Σ by · row over any rows.
#[inline(always)]
fn less_any<'a, R: Real>(
    own: &mut [R],
    mut below: &[usize],
    source: impl Fn(usize) -> (R, &'a [R]) + Copy,
) {
    while let Some((four, others)) = below.split_first_chunk::<4>() {
        subtract_all(own, map(*four, source));
        below = others;
    }
    below.iter().for_each(|k| subtract_all(own, [source(*k)]));
}

/// out = by · y for up to `WIDE` numbers.
#[inline(always)]
fn scale<R: Real>(by: R, y: &[R], out: &mut [R]) {
    if let [a, b, c, d] = *y {
        let whole: [R; WIDE] = [by * a, by * b, by * c, by * d];
        return out[..WIDE].copy_from_slice(&whole);
    }
    out.iter_mut().zip(y).for_each(|(out, y)| *out = by * *y);
}

/// wy = (new − old) y for a cone of N rows, whose numbers are `stride` apart.
#[inline(never)]
fn bend_cone<R: Real, const N: usize>(
    (old, new): (&[R], &[R]),
    (y, stride): (&[R], usize),
    (wy, apart): (&mut [R], usize),
) {
    let (old, new) = (&old[..N * N], &new[..N * N]);
    let mut bend = [[R::zero(); N]; N];
    for i in 0..N {
        for j in 0..N {
            bend[i][j] = new[i * N + j] - old[i * N + j];
        }
    }
    let whole = stride - stride % WIDE;
    for at in (0..whole).step_by(WIDE) {
        let mut sums = [[R::zero(); WIDE]; N];
        for j in 0..N {
            let y = &y[j * stride + at..][..WIDE];
            for i in 0..N {
                for k in 0..WIDE {
                    sums[i][k] += bend[i][j] * y[k];
                }
            }
        }
        for i in 0..N {
            wy[i * apart + at..][..WIDE].copy_from_slice(&sums[i]);
        }
    }
    for at in whole..stride {
        for i in 0..N {
            let sum = (0..N).fold(R::zero(), |sum, j| sum + bend[i][j] * y[j * stride + at]);
            wy[i * apart + at] = sum;
        }
    }
}

/// The same for any number of rows.
fn bend_some<R: Real>(
    (old, new): (&[R], &[R]),
    (y, stride): (&[R], usize),
    (wy, apart): (&mut [R], usize),
) {
    let rows = old.len().isqrt();
    for (i, wy) in wy.chunks_mut(apart).take(rows).enumerate() {
        wy.fill(R::zero());
        for j in 0..rows {
            let bend = new[i * rows + j] - old[i * rows + j];
            for (wy, y) in wy.iter_mut().zip(&y[j * stride..][..stride]) {
                *wy += bend * *y;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Span;
    use crate::solve::newton::bundles::Bundles;
    use crate::solve::tests::{pack, Problem as Given, Random};

    #[test]
    fn factors_solve_what_was_built() {
        let mut random = Random::new(3);
        for _ in 0..50 {
            let nv = 2 + random.below(9);
            let ones = vec![1.0; nv];
            let mut given = Given::new(&ones, &ones);
            let count = 1 + random.below(6);
            for _ in 0..count {
                given.limit(&ones, 0.0, 1.0);
            }
            let mut rows = pack::<f64>(&[given]);
            // Every block has a random list of dofs.
            let mut lists = Vec::new();
            rows.y.clear();
            for row in &mut rows.rows {
                let own: Vec<usize> = (0..nv).filter(|_| random.next() > 0.0).collect();
                row.dofs = Span { start: lists.len(), len: own.len() };
                row.y = rows.y.len();
                // As stiff as the largest curvature below.
                row.c = 1e-14;
                rows.y.extend(own.iter().map(|_| random.next()));
                lists.extend(own);
            }
            let blocks: Vec<usize> = (0..count).collect();
            let mut bundles = Bundles::new();
            bundles.take(&blocks, &rows, Some(&lists));
            let mut pattern = Pattern::default();
            pattern.fit(&lists, false, bundles.dofs(), &mut vec![0; nv]);
            let problem =
                Problem { pattern: &pattern, bundles: &bundles, rows: &rows, blocks: &blocks };
            let n = pattern.dofs.len();
            let x: Vec<f64> = (0..n).map(|_| random.next()).collect();
            let mut b: Vec<f64> = x.iter().map(|x| 0.5 * x).collect();
            let mut along = vec![0.0; count];
            problem.dots(&x, &mut along, &mut Vec::new());
            problem.gather(&along, 3.0, &mut b, &mut Vec::new());
            let mut hessian = Hessian::new();
            hessian.start(&pattern, &vec![0.5; n], count);
            // Zones come and go.
            for bend in [3.0, 0.0, 1e14, 3.0] {
                let mut changed = vec![true; bundles.runs.len()];
                hessian.make(problem, &vec![0.5; n], (&vec![bend; count], &mut changed));
            }
            hessian.solve(&pattern, &mut b);
            for (a, b) in x.iter().zip(&b) {
                assert!((a - b).abs() < 1e-12);
            }
        }
    }
}
