//! Elimination with complete pivoting, for systems in which some rows may repeat others.

use crate::real::WAYS;

/// What is left of a diagonal of 1 when a row only repeats others.
const NOTHING: f64 = 1e-12;

/// x ← M⁻¹ x, M row by row with a diagonal of about 1. Rows that repeat others take no part:
/// their unknowns are 0.
pub(super) fn eliminate(m: &mut [f64], x: &mut [[f64; WAYS]]) {
    let n = x.len();
    // Columns are not moved: `order` says which is k-th.
    let mut order: Vec<usize> = (0..n).collect();
    let mut rank = n;
    for k in 0..n {
        let (mut most, mut at) = (NOTHING, None);
        for i in k..n {
            for (j, column) in order.iter().enumerate().skip(k) {
                let size = m[i * n + column].abs();
                if size > most {
                    (most, at) = (size, Some((i, j)));
                }
            }
        }
        let Some((row, column)) = at else {
            rank = k;
            break;
        };
        order.swap(k, column);
        if row != k {
            x.swap(row, k);
            let (upper, lower) = m.split_at_mut(row * n);
            upper[k * n..(k + 1) * n].swap_with_slice(&mut lower[..n]);
        }
        let (upper, lower) = m.split_at_mut((k + 1) * n);
        let pivot = &upper[k * n..];
        let inverse = 1.0 / pivot[order[k]];
        let (done, rest) = x.split_at_mut(k + 1);
        for (own, rest) in lower.chunks_exact_mut(n).zip(rest) {
            let factor = own[order[k]] * inverse;
            if factor == 0.0 {
                continue;
            }
            for column in &order[k + 1..] {
                own[*column] -= factor * pivot[*column];
            }
            for (x, above) in rest.iter_mut().zip(done[k]) {
                *x -= factor * above;
            }
        }
    }
    for k in (0..rank).rev() {
        let row = &m[k * n..(k + 1) * n];
        let inverse = 1.0 / row[order[k]];
        for way in 0..WAYS {
            let mut sum = x[k][way];
            for (column, x) in order[k + 1..rank].iter().zip(&x[k + 1..rank]) {
                sum -= row[*column] * x[way];
            }
            x[k][way] = sum * inverse;
        }
    }
    x[rank..].fill([0.0; WAYS]);
    let solved = x.to_vec();
    for (column, solved) in order.iter().zip(solved) {
        x[*column] = solved;
    }
}
