//! What rows of free bodies add to the Hessian, straight from their y: Σ y s″ yᵀ.

use crate::real::{Mask, Real};

/// Dofs of a free body.
const FREE: usize = 6;

/// Intervals on the same dofs and their curvature s″; rows at a bound have none.
pub(super) struct Bent<'a, R: Real> {
    /// Row after row, `len` numbers each.
    pub y: &'a [R],
    pub len: usize,
    pub curve: &'a [R],
}

impl<R: Real> Bent<'_, R> {
    /// target += Σ y s″ yᵀ between two bodies, whose parts of a row begin at `starts`.
    #[inline(always)]
    pub fn add_outer(&self, target: &mut [R], starts: [usize; 2]) {
        for m in [0, 2, 4] {
            self.add_lines::<FREE>(target, m, starts);
        }
    }

    /// The same of a body with itself: entries on the diagonal and above, by pairs of lines.
    #[inline(always)]
    pub fn add_upper(&self, target: &mut [R], start: usize) {
        self.add_lines::<6>(target, 0, [start; 2]);
        self.add_lines::<4>(target, 2, [start; 2]);
        self.add_lines::<2>(target, 4, [start; 2]);
    }

    /// Lines m and m + 1, in the last N columns.
    #[inline(always)]
    fn add_lines<const N: usize>(&self, target: &mut [R], m: usize, [own, theirs]: [usize; 2]) {
        let from = FREE - N;
        let (mut one, mut two) = ([R::zero(); N], [R::zero(); N]);
        one.copy_from_slice(&target[m * FREE + from..][..N]);
        two.copy_from_slice(&target[(m + 1) * FREE + from..][..N]);
        for (y, curve) in self.y.chunks_exact(self.len).zip(self.curve) {
            if curve.gt(R::zero()).none() {
                continue;
            }
            let (own, theirs) = (&y[own + m..][..2], &y[theirs + from..][..N]);
            let (p, q) = (*curve * own[0], *curve * own[1]);
            for a in 0..N {
                one[a] += p * theirs[a];
            }
            for a in 0..N {
                two[a] += q * theirs[a];
            }
        }
        target[m * FREE + from..][..N].copy_from_slice(&one);
        target[(m + 1) * FREE + from..][..N].copy_from_slice(&two);
    }
}
