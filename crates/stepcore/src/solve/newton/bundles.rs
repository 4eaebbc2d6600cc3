//! The rows of an island as Newton's method reads them: number by number instead of row by row, and
//! in bundles of consecutive rows on the same dofs, such as those of all contacts of two bodies.

use super::pattern::Pattern;
use super::penalty::Cone;
use crate::model::Span;
use crate::real::{Mask, Real};
use crate::solve::dot::dots;
use crate::solve::rows::{Rows, Set};

/// Rows on the same dofs. Rows and their curvature are counted within the island.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bundle {
    /// Into `dof_lists`.
    pub dofs: Span,
    pub rows: Span,
    /// The first entry of its rows in `Rows::y`, where they stand one after another.
    pub y: usize,
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
}

room!(Bundles<R>: list, runs, cones, t, inv_c, lo, hi, inv_s, a, per_mass, mask, curves);

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
        }
    }

    /// Takes in the rows of these blocks.
    pub fn take(&mut self, blocks: &[usize], rows: &Rows<R>) {
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
            let rows = Span { start: at, len: own.len() };
            let curve = Span { start: self.curves, len: block.curves() };
            self.curves += curve.len;
            self.join(first.dofs, first.y, Run { rows, curve, cone, whole });
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
        self.curves = 0;
    }

    /// Adds a block's rows to the last bundle and its last run, or begins new ones.
    fn join(&mut self, dofs: Span, y: usize, run: Run) {
        let goes_on = |last: &Bundle| last.dofs == dofs && last.y + last.rows.len * dofs.len == y;
        match self.list.last_mut() {
            Some(last) if goes_on(last) => {
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
    /// The y of a bundle's rows, one after another.
    #[inline(always)]
    pub fn y(&self, bundle: &Bundle) -> &'a [R] {
        &self.rows.y[bundle.y..bundle.y + bundle.rows.len * bundle.dofs.len]
    }

    /// out = y·x by row; x by dof.
    pub fn dots(&self, x: &[R], out: &mut [R]) {
        for (b, bundle) in self.bundles.list.iter().enumerate() {
            let (mut y, mut out) = (self.y(bundle), &mut out[bundle.rows.range()]);
            if R::ALONE {
                if let Some(free) = self.pattern.free(b) {
                    free.dot_each(y, x, out);
                    continue;
                }
            }
            let list = self.pattern.list(b);
            while out.len() >= WIDE {
                let (own, rest) = out.split_at_mut(WIDE);
                own.copy_from_slice(&dots::<R, WIDE>(list, y, x));
                (out, y) = (rest, &y[WIDE * list.len()..]);
            }
            match out.len() {
                1 => out.copy_from_slice(&dots::<R, 1>(list, y, x)),
                2 => out.copy_from_slice(&dots::<R, 2>(list, y, x)),
                3 => out.copy_from_slice(&dots::<R, 3>(list, y, x)),
                _ => {}
            }
        }
    }

    /// out += sign · Σ y x; x by row, out by dof.
    pub fn gather(&self, x: &[R], sign: R, out: &mut [R]) {
        for (b, bundle) in self.bundles.list.iter().enumerate() {
            let own = bundle.rows.range();
            let (mut y, mut x, mut mask) =
                (self.y(bundle), &x[own.clone()], &self.bundles.mask[own]);
            if R::ALONE {
                if let Some(free) = self.pattern.free(b) {
                    // A heap is one world.
                    free.add_each(y, x, sign, out);
                    continue;
                }
            }
            let list = self.pattern.list(b);
            while !x.is_empty() {
                let to = (list, y);
                let done = match x.len() {
                    _ if !bundle.whole => {
                        for (k, y) in list.iter().zip(y) {
                            out[*k] = R::select(mask[0], out[*k] + *y * (sign * x[0]), out[*k]);
                        }
                        1
                    }
                    1 => sums::<R, 1>(to, (sign, x), out),
                    2 => sums::<R, 2>(to, (sign, x), out),
                    3 => sums::<R, 3>(to, (sign, x), out),
                    _ => sums::<R, WIDE>(to, (sign, x), out),
                };
                (x, mask, y) = (&x[done..], &mask[done..], &y[done * list.len()..]);
            }
        }
    }
}

/// Rows that are multiplied side by side.
const WIDE: usize = 4;

/// out += sign · Σ y x of N rows, each dof's sum in the order of the rows; N.
#[inline(always)]
fn sums<R: Real, const N: usize>(
    (list, y): (&[usize], &[R]),
    (sign, x): (R, &[R]),
    out: &mut [R],
) -> usize {
    let len = list.len();
    let x: [R; N] = crate::real::array::from_fn(|i| sign * x[i]);
    let rows: [&[R]; N] = crate::real::array::from_fn(|i| &y[i * len..][..len]);
    for (at, k) in list.iter().enumerate() {
        let mut sum = out[*k];
        for i in 0..N {
            sum += rows[i][at] * x[i];
        }
        out[*k] = sum;
    }
    N
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
        bundles.take(&[0, 1, 2, 3], &rows);
        let runs: Vec<(usize, usize)> =
            bundles.runs.iter().map(|run| (run.rows.len, run.curve.len)).collect();
        assert_eq!((bundles.list.len(), runs), (1, vec![(7, 7), (3, 9), (1, 1)]));
        let mut pattern = Pattern::default();
        pattern.fit(&[0, 1, 2, 3, 4], false, bundles.dofs(), &mut [0; 5]);
        let problem =
            Problem { pattern: &pattern, bundles: &bundles, rows: &rows, blocks: &[0, 1, 2, 3] };
        let x = [0.3, -0.2, 0.7, 0.1, -0.9];
        let (mut along, mut sums) = ([0.0; 11], [0.5; 5]);
        problem.dots(&x, &mut along);
        problem.gather(&along, -2.0, &mut sums);
        let mut want = [0.5; 5];
        for (row, along) in rows.rows.iter().zip(along) {
            let y = &rows.y[row.y..row.y + 5];
            assert_eq!(along, y.iter().zip(x).fold(0.0, |sum, (y, x)| sum + y * x));
            for (want, y) in want.iter_mut().zip(y) {
                *want += y * (-2.0 * along);
            }
        }
        assert_eq!(sums, want);
        // Not one after another: two bundles.
        bundles.take(&[0, 2], &rows);
        assert_eq!(bundles.list.len(), 2);
    }
}
