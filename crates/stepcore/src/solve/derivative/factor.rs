//! P M Q = L U with complete pivoting, for systems in which some rows may repeat others.

use crate::real::WAYS;

/// The rounding error of a diagonal of 1 when a row only repeats others.
const NOTHING: f64 = 1e-12;

/// Factors of a square matrix, up to its rank. Rows that repeat others are left out: their unknowns
/// are 0.
pub(super) struct Factors {
    /// L (with a diagonal of ones) below U, row by row in the order of `rows` and `columns`.
    lu: Vec<f64>,
    /// The row and the column of the matrix that is k-th; as many as the rank.
    rows: Vec<usize>,
    columns: Vec<usize>,
}

room!(Factors: lu, rows, columns);

impl Factors {
    /// Factor n × n numbers, row by row.
    pub fn of(mut m: Vec<f64>, n: usize) -> Self {
        let (mut rows, mut columns): (Vec<_>, Vec<_>) = ((0..n).collect(), (0..n).collect());
        let mut rank = n;
        for k in 0..n {
            let (mut most, mut at) = (NOTHING, None);
            for i in k..n {
                for (j, x) in m[i * n + k..(i + 1) * n].iter().enumerate() {
                    if x.abs() > most {
                        (most, at) = (x.abs(), Some((i, k + j)));
                    }
                }
            }
            let Some((row, column)) = at else {
                rank = k;
                break;
            };
            rows.swap(k, row);
            columns.swap(k, column);
            for i in 0..n {
                m.swap(i * n + k, i * n + column);
            }
            for j in 0..n {
                m.swap(k * n + j, row * n + j);
            }
            let (upper, lower) = m.split_at_mut((k + 1) * n);
            let pivot = &upper[k * n + k..];
            let inverse = 1.0 / pivot[0];
            for own in lower.chunks_exact_mut(n) {
                let factor = own[k] * inverse;
                own[k] = factor;
                for (x, pivot) in own[k + 1..].iter_mut().zip(&pivot[1..]) {
                    *x -= factor * pivot;
                }
            }
        }
        rows.truncate(rank);
        columns.truncate(rank);
        let lu = (0..rank).flat_map(|k| &m[k * n..k * n + rank]).copied().collect();
        Self { lu, rows, columns }
    }

    pub fn rank(&self) -> usize {
        self.rows.len()
    }

    /// x ← M⁻¹ x for several right-hand sides.
    pub fn solve(&self, x: &mut [[f64; WAYS]]) {
        let rank = self.rows.len();
        let mut solved: Vec<[f64; WAYS]> = self.rows.iter().map(|row| x[*row]).collect();
        let subtract = |from: &mut [f64; WAYS], k: f64, what: [f64; WAYS]| {
            for (from, what) in from.iter_mut().zip(what) {
                *from -= k * what;
            }
        };
        for k in 0..rank {
            let mut own = solved[k];
            for (l, above) in self.lu[k * rank..k * rank + k].iter().zip(&solved) {
                subtract(&mut own, *l, *above);
            }
            solved[k] = own;
        }
        for k in (0..rank).rev() {
            let row = &self.lu[k * rank..(k + 1) * rank];
            let mut own = solved[k];
            for (r, below) in row[k + 1..].iter().zip(&solved[k + 1..]) {
                subtract(&mut own, *r, *below);
            }
            solved[k] = own.map(|x| x / row[k]);
        }
        x.fill([0.0; WAYS]);
        for (column, solved) in self.columns.iter().zip(solved) {
            x[*column] = solved;
        }
    }
}
