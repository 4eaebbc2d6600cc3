//! Arrays computed number by number. The standard library's `from_fn` and `map` support drops and
//! failures half-way, with a dozen functions for each of ours; these are for numbers.

/// [f(0), f(1), …].
#[inline(always)]
pub fn from_fn<T: Copy, const N: usize>(mut f: impl FnMut(usize) -> T) -> [T; N] {
    let mut all = [f(0); N];
    for k in 1..N {
        all[k] = f(k);
    }
    all
}

/// [f(of[0]), f(of[1]), …].
#[inline(always)]
pub fn map<T: Copy, U: Copy, const N: usize>(of: [T; N], mut f: impl FnMut(T) -> U) -> [U; N] {
    from_fn(|k| f(of[k]))
}
