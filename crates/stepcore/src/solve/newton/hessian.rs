//! The Hessian D + Σ y s″ yᵀ of one island, and LᵀDL without square roots.
//!
//! Made once for each solve; as the iteration goes on, what changed zones is added or taken away. That
//! leaves the rounding of what was taken away: where it was huge, the sum is made afresh.

use super::bundles::Problem;
use super::pattern::{Listed, Pattern};
use crate::real::{Mask, Real};
use crate::spatial::{subtract_all, WIDE};

/// So many times what moves a row, its penalty is huge: A s″. MuJoCo's impedances keep below 1e4, but
/// where next to nothing moves a body that rows press on there is no end.
const HUGE: f64 = 1e6;

/// Numbers on a pattern: the matrix, and its factors.
pub(super) struct Hessian<R: Real> {
    /// D + Σ y s″ yᵀ, and the s″ that are in it.
    entries: Vec<R>,
    curve: Vec<R>,
    /// L, with D of LDLᵀ in the place of its diagonal; 1/D.
    factors: Vec<R>,
    inverse: Vec<R>,
    /// Rows to factor again.
    stale: Vec<bool>,
    added: Added<R>,
}

/// What is added to a bundle's part of the matrix: Σ left · bentᵀ, symmetric as a whole.
struct Added<R: Real> {
    /// By row: where its y begin in the bundle's, and in which lanes it counts.
    rows: Vec<(usize, R::Mask)>,
    /// By row: s″ y, and zeros up to `stride` numbers.
    bent: Vec<R>,
    stride: usize,
    /// All count in every lane.
    whole: bool,
}

room!(Hessian<R>: entries, curve, factors, inverse, stale, added);
room!(Added<R>: rows, bent, stride, whole);

impl<R: Real> Hessian<R> {
    pub fn new() -> Self {
        Self {
            entries: Vec::new(),
            curve: Vec::new(),
            factors: Vec::new(),
            inverse: Vec::new(),
            stale: Vec::new(),
            added: Added::new(),
        }
    }

    /// D alone.
    pub fn start(&mut self, pattern: &Pattern, d: &[R], curves: usize) {
        self.entries.clear();
        self.entries.resize(pattern.cols.len(), R::zero());
        for (d, end) in d.iter().zip(&pattern.start[1..]) {
            self.entries[end - 1] = *d;
        }
        self.curve.clear();
        self.curve.resize(curves, R::zero());
        self.factors.resize(self.entries.len(), R::zero());
        self.inverse.resize(d.len(), R::zero());
        self.stale.clear();
        self.stale.resize(d.len(), true);
    }

    /// Factors D + Σ y s″ yᵀ: what has changed since the last time is added.
    #[inline(never)]
    pub fn make(&mut self, problem: Problem<R>, d: &[R], curve: &[R]) {
        self.forget_huge(problem, d, curve);
        for (b, bundle) in problem.bundles.list.iter().enumerate() {
            self.added.start(bundle.rows.len, bundle.dofs.len);
            let y = problem.y(bundle);
            for run in problem.bundles.runs_of(bundle) {
                let (old, new) = (run.curve.of(&self.curve), run.curve.of(curve));
                let first = (run.rows.start - bundle.rows.start) * bundle.dofs.len;
                let mask = &problem.bundles.mask[run.rows.range()];
                self.added.take(bundle.dofs.len, (first, y), (old, new), mask);
            }
            if !self.added.rows.is_empty() {
                self.add(problem.pattern, b, y);
            }
        }
        self.curve.copy_from_slice(curve);
        self.factor(problem.pattern);
    }

    /// Begins with D again in lanes where a huge part changes.
    fn forget_huge(&mut self, problem: Problem<R>, d: &[R], curve: &[R]) {
        let mut huge = R::Mask::of(false);
        for run in &problem.bundles.runs {
            let (old, new) = (run.curve.of(&self.curve), run.curve.of(curve));
            let rows = run.rows.len;
            // Of a cone the diagonal tells.
            let every = if run.cone.is_some() { rows + 1 } else { 1 };
            let a = &problem.bundles.a[run.rows.range()];
            for ((old, new), a) in old.iter().zip(new).step_by(every).zip(a) {
                let other = (*new - *old).abs().gt(R::zero());
                huge = huge.or(other.and((*old * *a).gt(R::of(HUGE))));
            }
        }
        if huge.none() {
            return;
        }
        self.stale.fill(true);
        let ends = problem.pattern.start.iter().skip(1);
        let mut diagonal = ends.zip(d).peekable();
        for (at, x) in self.entries.iter_mut().enumerate() {
            let d = diagonal.next_if(|(end, _)| **end == at + 1);
            *x = R::select(huge, d.map_or(R::zero(), |(_, d)| *d), *x);
        }
        for curve in &mut self.curve {
            *curve = R::select(huge, R::zero(), *curve);
        }
    }

    /// Adds what was taken of a bundle.
    fn add(&mut self, pattern: &Pattern, bundle: usize, y: &[R]) {
        let Self { entries, added, stale, .. } = self;
        let Listed { list, places, .. } = pattern.bundles[bundle];
        let list = list.of(&pattern.lists);
        list.iter().for_each(|i| stale[*i] = true);
        // Lanes fill the registers by themselves.
        let high = if R::ALONE { WIDE } else { 1 };
        for at in (0..list.len()).step_by(high) {
            let lines = &list[at..list.len().min(at + high)];
            match places {
                // The place of a pair: the lists before it are as long as their number.
                Some(first) => {
                    let of = |line: usize| first + line * (line + 1) / 2;
                    added.add(entries, at, lines.len(), y, |line, col| {
                        pattern.places[of(at + line) + col]
                    });
                }
                None => {
                    added.add(entries, at, lines.len(), y, |line, col| {
                        pattern.start[lines[line]] + col
                    });
                }
            }
        }
    }

    /// H = LᵀDL: rows that changed, and those above that they reach.
    #[inline(never)]
    fn factor(&mut self, pattern: &Pattern) {
        let Self { entries, factors, inverse, stale, .. } = self;
        for i in (0..pattern.dofs.len()).rev() {
            if !std::mem::replace(&mut stale[i], false) {
                continue;
            }
            pattern.cols[pattern.row(i)].iter().for_each(|j| stale[*j] = *j < i);
            let (before, below) = factors.split_at_mut(pattern.start[i + 1]);
            let own = &mut before[pattern.start[i]..];
            own.copy_from_slice(&entries[pattern.row(i)]);
            let row = pattern.start[i + 1];
            // L and D of a row below, and its L up to the column i.
            let source = |(k, at): (usize, usize)| {
                let own = pattern.row(k);
                let by = below[at - row] * below[own.end - 1 - row];
                (by, &below[own.start - row..=at - row])
            };
            let mut rest = &pattern.below[pattern.below_start[i]..pattern.below_start[i + 1]];
            while let [first, others @ ..] = rest {
                // Side by side, where each row's begin as this one's.
                if let Some((four, others)) = rest.split_first_chunk::<4>() {
                    let four = four.map(source);
                    if four.iter().all(|(_, l)| l.len() == own.len()) {
                        subtract_all(own, four);
                        rest = others;
                        continue;
                    }
                }
                let (by, l) = source(*first);
                rest = others;
                if l.len() == own.len() {
                    subtract_all(own, [(by, l)]);
                    continue;
                }
                let mut places = pattern.cols[pattern.row(i)].iter().zip(&mut *own);
                for (j, l) in pattern.cols[pattern.row(first.0)].iter().zip(l) {
                    if let Some((_, x)) = places.find(|(col, _)| *col == j) {
                        *x -= by * *l;
                    }
                }
            }
            if let Some((d, own)) = own.split_last_mut() {
                inverse[i] = R::one() / *d;
                own.iter_mut().for_each(|x| *x *= inverse[i]);
            }
        }
    }

    /// x ← H⁻¹ x.
    pub fn solve(&self, pattern: &Pattern, x: &mut [R]) {
        for k in (0..x.len()).rev() {
            let own = pattern.start[k]..pattern.start[k + 1] - 1;
            let factor = x[k];
            for (j, l) in pattern.cols[own.clone()].iter().zip(&self.factors[own]) {
                x[*j] -= *l * factor;
            }
            x[k] = factor * self.inverse[k];
        }
        for k in 0..x.len() {
            let own = pattern.start[k]..pattern.start[k + 1] - 1;
            let mut rest = x[k];
            for (j, l) in pattern.cols[own.clone()].iter().zip(&self.factors[own]) {
                rest -= *l * x[*j];
            }
            x[k] = rest;
        }
    }
}

impl<R: Real> Added<R> {
    fn new() -> Self {
        Self { rows: Vec::new(), bent: Vec::new(), stride: 0, whole: true }
    }

    /// Nothing yet, of a bundle of so many rows and dofs.
    fn start(&mut self, rows: usize, dofs: usize) {
        self.stride = dofs.next_multiple_of(WIDE);
        self.whole = true;
        self.rows.clear();
        self.rows.reserve(rows);
        self.bent.clear();
        self.bent.reserve(rows * self.stride);
    }

    /// Takes a run's rows of `len` dofs, whose y begin at `first`, where their curvature is new.
    fn take(
        &mut self,
        len: usize,
        (first, y): (usize, &[R]),
        (old, new): (&[R], &[R]),
        mask: &[R::Mask],
    ) {
        let rows = mask.len();
        let changed = |(old, new): (&R, &R)| (*new - *old).abs().gt(R::zero());
        if new.len() == rows {
            for (i, (old, new)) in old.iter().zip(new).enumerate() {
                let some = changed((old, new));
                if some.any() {
                    let start = first + i * len;
                    let bend = *new - *old;
                    self.bent.extend(y[start..start + len].iter().map(|y| bend * *y));
                    self.push(start, mask[i]);
                }
            }
            return;
        }
        let some = old.iter().zip(new).map(changed);
        let some = some.fold(R::Mask::of(false), |some, new| some.or(new));
        if some.none() {
            return;
        }
        for (i, (old, new)) in old.chunks_exact(rows).zip(new.chunks_exact(rows)).enumerate() {
            let start = self.bent.len();
            self.bent.resize(start + len, R::zero());
            for ((old, new), y) in old.iter().zip(new).zip(y[first..].chunks_exact(len.max(1))) {
                let bend = *new - *old;
                for (bent, y) in self.bent[start..].iter_mut().zip(y) {
                    *bent += bend * *y;
                }
            }
            self.push(first + i * len, mask[i]);
        }
    }

    fn push(&mut self, start: usize, mask: R::Mask) {
        self.whole &= mask.all();
        self.rows.push((start, mask));
        self.bent.resize(self.rows.len() * self.stride, R::zero());
    }

    /// Adds `count` lines of Σ left · bentᵀ from line `at` on, up to the diagonal, to the entries at
    /// `place`, one row after the other: so a sum is the same however rows are bundled.
    #[inline(always)]
    fn add(
        &self,
        entries: &mut [R],
        at: usize,
        count: usize,
        y: &[R],
        place: impl Fn(usize, usize) -> usize,
    ) {
        match (count, self.whole) {
            (WIDE, true) => self.add_lines::<true, WIDE>(entries, at, y, place),
            (WIDE, false) => self.add_lines::<false, WIDE>(entries, at, y, place),
            _ => {
                for line in 0..count {
                    let place = |_, col| place(line, col);
                    if self.whole {
                        self.add_lines::<true, 1>(entries, at + line, y, place);
                    } else {
                        self.add_lines::<false, 1>(entries, at + line, y, place);
                    }
                }
            }
        }
    }

    #[inline(always)]
    fn add_lines<const WHOLE: bool, const N: usize>(
        &self,
        entries: &mut [R],
        at: usize,
        y: &[R],
        place: impl Fn(usize, usize) -> usize,
    ) {
        let last = at / WIDE * WIDE;
        for from in (0..=last).step_by(WIDE) {
            // The diagonal's block has entries above it, which are not kept.
            let width = |line: usize| if from < last { WIDE } else { at + line + 1 - last };
            let mut sums = [[R::zero(); WIDE]; N];
            for line in 0..N {
                for i in 0..width(line) {
                    sums[line][i] = entries[place(line, from + i)];
                }
            }
            for ((row, mask), bent) in self.rows.iter().zip(self.bent.chunks_exact(self.stride)) {
                let (left, bent) = (&y[row + at..][..N], &bent[from..][..WIDE]);
                for line in 0..N {
                    for i in 0..WIDE {
                        let new = sums[line][i] + left[line] * bent[i];
                        sums[line][i] =
                            if WHOLE { new } else { R::select(*mask, new, sums[line][i]) };
                    }
                }
            }
            for line in 0..N {
                for i in 0..width(line) {
                    entries[place(line, from + i)] = sums[line][i];
                }
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
            // Every block on its own random list of dofs.
            let mut lists = Vec::new();
            rows.y.clear();
            for row in &mut rows.rows {
                let own: Vec<usize> = (0..nv).filter(|_| random.next() > 0.0).collect();
                row.dofs = Span { start: lists.len(), len: own.len() };
                row.y = rows.y.len();
                rows.y.extend(own.iter().map(|_| random.next()));
                lists.extend(own);
            }
            let blocks: Vec<usize> = (0..count).collect();
            let mut bundles = Bundles::new();
            bundles.take(&blocks, &rows, &lists);
            let mut pattern = Pattern::default();
            pattern.fit(&lists, false, bundles.dofs(), &mut vec![0; nv]);
            let problem =
                Problem { pattern: &pattern, bundles: &bundles, rows: &rows, blocks: &blocks };
            let n = pattern.dofs.len();
            let x: Vec<f64> = (0..n).map(|_| random.next()).collect();
            let mut b: Vec<f64> = x.iter().map(|x| 0.5 * x).collect();
            let mut along = vec![0.0; count];
            problem.dots(&x, &mut along, &mut Vec::new());
            problem.gather(&along, 3.0, &mut b);
            let mut hessian = Hessian::new();
            hessian.start(&pattern, &vec![0.5; n], count);
            // Zones come and go.
            for bend in [3.0, 0.0, 1e14, 3.0] {
                hessian.make(problem, &vec![0.5; n], &vec![bend; count]);
            }
            hessian.solve(&pattern, &mut b);
            for (a, b) in x.iter().zip(&b) {
                assert!((a - b).abs() < 1e-12);
            }
        }
    }
}
