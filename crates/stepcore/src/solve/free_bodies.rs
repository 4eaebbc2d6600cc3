//! Rows of free bodies: their dofs are one or two runs of six, so sums over them have a fixed
//! length.
//!
//! Only piles use this (`Rows::heap`): a sum is taken in another order than in `dot`, by even and
//! odd dofs, so that two partial sums advance in parallel.

use crate::real::Real;

/// Dofs of a free body.
pub(super) const SIX: usize = 6;

/// The first dofs of a row's bodies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FreeBodies {
    first: [u32; 2],
    two: bool,
}

impl FreeBodies {
    /// From a list of dofs, if it is one or two runs of six.
    pub fn of(list: &[usize]) -> Option<Self> {
        let run = |from: usize| {
            let own = list.get(from..from + SIX)?;
            let straight = own.iter().enumerate().all(|(at, k)| *k == own[0] + at);
            straight.then(|| u32::try_from(own[0]).ok()).flatten()
        };
        match list.len() {
            SIX => Some(Self { first: [run(0)?; 2], two: false }),
            12 => Some(Self { first: [run(0)?, run(SIX)?], two: true }),
            _ => None,
        }
    }

    /// The same for an ascending list, for which the ends suffice.
    pub fn ascending(list: &[usize]) -> Option<Self> {
        let run = |from: usize| (list[from + SIX - 1] - list[from] == SIX - 1).then(|| list[from]);
        let first = match list.len() {
            SIX => [run(0)?; 2],
            12 => [run(0)?, run(SIX)?],
            _ => return None,
        };
        let [one, two] = first.map(u32::try_from);
        Some(Self { first: [one.ok()?, two.ok()?], two: list.len() > SIX })
    }

    /// u += D⁻¹ Σ y x of four rows, with each dof's sum in their order.
    #[inline(always)]
    pub fn kick_four<R: Real>(&self, y: [&[R]; 4], x: [R; 4], inv_d: &[R], u: &mut [R]) {
        for which in 0..self.count() {
            let own = self.body(which);
            let (inv_d, mut new) = (six(&inv_d[own.clone()]), six(&u[own.clone()]));
            for i in 0..4 {
                let y = six(&y[i][which * SIX..]);
                for a in 0..SIX {
                    new[a] += inv_d[a] * y[a] * x[i];
                }
            }
            u[own].copy_from_slice(&new);
        }
    }

    /// The number of entries of a row.
    pub fn len(&self) -> usize {
        if self.two {
            2 * SIX
        } else {
            SIX
        }
    }

    /// The number of bodies.
    #[inline(always)]
    pub fn count(&self) -> usize {
        1 + usize::from(self.two)
    }

    /// Returns the dofs of one of them.
    #[inline(always)]
    pub fn body(&self, which: usize) -> std::ops::Range<usize> {
        let first = self.first[which] as usize;
        first..first + SIX
    }

    /// out = y·x of some rows, with y stored row after row.
    #[inline(always)]
    pub fn dot_each<R: Real>(&self, y: &[R], x: &[R], out: &mut [R]) {
        let one = &six(&x[self.body(0)]);
        if !self.two {
            for (out, y) in out.iter_mut().zip(y.chunks_exact(SIX)) {
                *out = total(products(y, one));
            }
            return;
        }
        let two = &six(&x[self.body(1)]);
        for (out, y) in out.iter_mut().zip(y.chunks_exact(2 * SIX)) {
            let (mut both, second) = (products(&y[..SIX], one), products(&y[SIX..], two));
            for a in 0..SIX {
                both[a] += second[a];
            }
            *out = total(both);
        }
    }

    /// out += k Σ y x over some rows, with y stored row after row.
    #[inline(always)]
    pub fn add_each<R: Real>(&self, y: &[R], x: &[R], k: R, out: &mut [R]) {
        let mut one = six(&out[self.body(0)]);
        if !self.two {
            for (x, y) in x.iter().zip(y.chunks_exact(SIX)) {
                scaled(y, k * *x, &mut one);
            }
            out[self.body(0)].copy_from_slice(&one);
            return;
        }
        let mut two = six(&out[self.body(1)]);
        for (x, y) in x.iter().zip(y.chunks_exact(2 * SIX)) {
            let x = k * *x;
            scaled(&y[..SIX], x, &mut one);
            scaled(&y[SIX..], x, &mut two);
        }
        out[self.body(0)].copy_from_slice(&one);
        out[self.body(1)].copy_from_slice(&two);
    }
}

#[inline(always)]
fn products<R: Real>(y: &[R], x: &[R]) -> [R; SIX] {
    let (mut products, x) = (six(y), &x[..SIX]);
    for a in 0..SIX {
        products[a] *= x[a];
    }
    products
}

/// Returns the first six numbers.
#[inline(always)]
pub(super) fn six<R: Real>(x: &[R]) -> [R; SIX] {
    let mut six = [R::zero(); SIX];
    six.copy_from_slice(&x[..SIX]);
    six
}

#[inline(always)]
fn total<R: Real>(p: [R; SIX]) -> R {
    ((p[0] + p[2]) + p[4]) + ((p[1] + p[3]) + p[5])
}

#[inline(always)]
fn scaled<R: Real>(y: &[R], k: R, out: &mut [R]) {
    let (y, out) = (&y[..SIX], &mut out[..SIX]);
    for a in 0..SIX {
        out[a] += y[a] * k;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_of_six_are_found() {
        let list = |first: usize| (first..first + 6).collect::<Vec<_>>();
        assert!(FreeBodies::of(&list(12)).is_some());
        assert!(FreeBodies::of(&[list(12), list(30)].concat()).is_some_and(|free| free.len() == 12));
        assert!(FreeBodies::of(&[list(12), vec![18]].concat()).is_none());
        assert!(FreeBodies::of(&[0, 1, 2, 3, 4, 6]).is_none());
        assert!(FreeBodies::of(&[]).is_none());
        for known in [list(12), [list(12), list(30)].concat()] {
            assert_eq!(FreeBodies::ascending(&known), FreeBodies::of(&known));
        }
        assert!(FreeBodies::ascending(&[0, 1, 2, 3, 4, 6]).is_none());
        assert!(FreeBodies::ascending(&[list(12), vec![18]].concat()).is_none());
    }

    #[test]
    fn sums_are_sums_over_the_list() {
        let free = FreeBodies::of(&[3, 4, 5, 6, 7, 8, 12, 13, 14, 15, 16, 17]).unwrap();
        let y: Vec<f64> = (0..24).map(|i| (0.3 * i as f64).sin()).collect();
        let u: Vec<f64> = (0..20).map(|i| (0.7 * i as f64).cos()).collect();
        let list = [3, 4, 5, 6, 7, 8, 12, 13, 14, 15, 16, 17];
        let want = |y: &[f64]| list.iter().zip(y).map(|(k, y)| u[*k] * y).sum::<f64>();
        let mut each = [0.0; 2];
        free.dot_each(&y, &u, &mut each);
        assert!((each[0] - want(&y)).abs() < 1e-14 && (each[1] - want(&y[12..])).abs() < 1e-14);
        let mut moved = u.clone();
        free.add_each(&y, &[0.25, -1.0], 2.0, &mut moved);
        for (at, k) in list.into_iter().enumerate() {
            assert!((moved[k] - (u[k] + y[at] * 0.5 - y[12 + at] * 2.0)).abs() < 1e-15);
        }
    }
}
