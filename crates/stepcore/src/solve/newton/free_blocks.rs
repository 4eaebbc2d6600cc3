//! Hessian terms of rows of free bodies, Σ y s″ yᵀ: blocks of six by six, two lines at a time.

use crate::real::{Mask, Real};

/// Dofs of a free body.
pub(super) const FREE: usize = 6;

/// The terms of rows in the lines m and m + 1 of a block.
pub(super) trait Lines<R: Real> {
    /// Calls `add` for every row with curvature, with s″ y of these two dofs, and y from the six
    /// dofs of the columns on.
    fn each(&self, m: usize, add: impl FnMut([R; 2], &[R]));
}

/// target += Σ s″ y yᵀ between two bodies.
#[inline(always)]
pub(super) fn add_outer<R: Real>(target: &mut [R], lines: &impl Lines<R>) {
    for m in [0, 2, 4] {
        add_lines::<R, FREE>(target, m, lines);
    }
}

/// The same between a body and itself: entries on the diagonal and above, by pairs of lines.
#[inline(always)]
pub(super) fn add_upper<R: Real>(target: &mut [R], lines: &impl Lines<R>) {
    add_lines::<R, 6>(target, 0, lines);
    add_lines::<R, 4>(target, 2, lines);
    add_lines::<R, 2>(target, 4, lines);
}

/// Adds lines m and m + 1, in the last N columns.
#[inline(always)]
fn add_lines<R: Real, const N: usize>(target: &mut [R], m: usize, lines: &impl Lines<R>) {
    let from = FREE - N;
    let (mut one, mut two) = ([R::zero(); N], [R::zero(); N]);
    one.copy_from_slice(&target[m * FREE + from..][..N]);
    two.copy_from_slice(&target[(m + 1) * FREE + from..][..N]);
    lines.each(m, |[p, q], theirs| {
        let theirs = &theirs[from..from + N];
        for a in 0..N {
            one[a] += p * theirs[a];
        }
        for a in 0..N {
            two[a] += q * theirs[a];
        }
    });
    target[m * FREE + from..][..N].copy_from_slice(&one);
    target[(m + 1) * FREE + from..][..N].copy_from_slice(&two);
}

/// Intervals on the same dofs: rows at a bound have no curvature.
pub(super) struct ActiveRows<'a, R: Real> {
    /// Row after row, `len` numbers each.
    pub y: &'a [R],
    pub len: usize,
    /// s″.
    pub curve: &'a [R],
    /// The starts, within a row, of the dofs of the lines and of the columns.
    pub starts: [usize; 2],
}

impl<R: Real> Lines<R> for ActiveRows<'_, R> {
    #[inline(always)]
    fn each(&self, m: usize, mut add: impl FnMut([R; 2], &[R])) {
        let [own, theirs] = self.starts;
        for (y, curve) in self.y.chunks_exact(self.len).zip(self.curve) {
            if curve.gt(R::zero()).none() {
                continue;
            }
            let own = &y[own + m..][..2];
            add([*curve * own[0], *curve * own[1]], &y[theirs..]);
        }
    }
}

/// Rows with s″ y computed, six numbers each like their y.
pub(super) struct Scaled<'a, R: Real> {
    pub own: &'a [R],
    pub theirs: &'a [R],
}

impl<R: Real> Lines<R> for Scaled<'_, R> {
    #[inline(always)]
    fn each(&self, m: usize, mut add: impl FnMut([R; 2], &[R])) {
        for (own, theirs) in self.own.chunks_exact(FREE).zip(self.theirs.chunks_exact(FREE)) {
            add([own[m], own[m + 1]], theirs);
        }
    }
}
