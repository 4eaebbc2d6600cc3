//! The order in which an island's nodes are eliminated: minimum degree.
//!
//! Eliminating a node couples all its neighbours; always taking the node with the fewest neighbours
//! keeps the fill-in small (Tinney & Walker 1967; George & Liu 1989). The remaining graph is stored
//! as rows of bits, so that an elimination is a few words per neighbour. A pile has some hundred
//! nodes: bodies, not dofs. Ties go to the lower node, so that the order follows from the graph
//! alone.

use crate::bits::ones;
use crate::interrupt::Meter;

/// A graph's order of elimination, and the remaining neighbours of each node at its turn.
#[derive(Default)]
pub(super) struct Order {
    /// Words per row of bits.
    words: usize,
    /// The given graph, row by row; and its remaining part.
    given: Vec<u64>,
    bits: Vec<u64>,
    degree: Vec<u32>,
    pivot: Vec<u64>,
    /// Nodes in the order of elimination, and the turn of each.
    pub sequence: Vec<usize>,
    pub turn: Vec<usize>,
    /// Per turn: the turns of the nodes that it touches, ascending: `rows[start[k]..start[k + 1]]`.
    pub start: Vec<usize>,
    pub rows: Vec<usize>,
}

room!(Order: words, given, bits, degree, pivot, sequence, turn, start, rows);

impl Order {
    /// Orders the graph of `count` nodes with these edges, unless it is unchanged. Returns whether
    /// the order is new.
    pub fn fit(&mut self, count: usize, edges: impl Iterator<Item = (usize, usize)>) -> bool {
        let words = count.div_ceil(64);
        self.bits.clear();
        self.bits.resize(count * words, 0);
        for (i, j) in edges.filter(|(i, j)| i != j) {
            self.bits[i * words + j / 64] |= 1 << (j % 64);
            self.bits[j * words + i / 64] |= 1 << (i % 64);
        }
        if self.turn.len() == count && self.given == self.bits {
            return false;
        }
        self.given.clear();
        self.given.extend_from_slice(&self.bits);
        self.words = words;
        self.eliminate(count);
        self.number();
        true
    }

    fn eliminate(&mut self, count: usize) {
        const GONE: u32 = u32::MAX;
        let words = self.words;
        self.degree.clear();
        let degree = |row: &[u64]| row.iter().map(|word| word.count_ones()).sum::<u32>();
        self.degree.extend(self.bits.chunks_exact(words.max(1)).map(degree));
        self.sequence.clear();
        self.start.clear();
        self.rows.clear();
        let mut meter = Meter::default();
        for _ in 0..count {
            meter.count(count);
            let least = self.degree.iter().enumerate().min_by_key(|(_, degree)| **degree);
            let Some((k, _)) = least else { return };
            self.degree[k] = GONE;
            self.sequence.push(k);
            self.start.push(self.rows.len());
            self.pivot.clear();
            self.pivot.extend_from_slice(&self.bits[k * words..(k + 1) * words]);
            for i in ones(&self.pivot) {
                self.rows.push(i);
                meter.count(words);
                let row = &mut self.bits[i * words..(i + 1) * words];
                for (word, pivot) in row.iter_mut().zip(&self.pivot) {
                    *word |= pivot;
                }
                row[k / 64] &= !(1 << (k % 64));
                row[i / 64] &= !(1 << (i % 64));
                self.degree[i] = degree(row);
            }
        }
        self.start.push(self.rows.len());
    }

    /// Returns the turns of the neighbours that a node has at its turn.
    pub fn column(&self, turn: usize) -> &[usize] {
        &self.rows[self.start[turn]..self.start[turn + 1]]
    }

    /// Converts nodes to turns.
    fn number(&mut self) {
        self.turn.clear();
        self.turn.resize(self.sequence.len(), 0);
        for (turn, node) in self.sequence.iter().enumerate() {
            self.turn[*node] = turn;
        }
        for row in &mut self.rows {
            *row = self.turn[*row];
        }
        for k in 0..self.sequence.len() {
            self.rows[self.start[k]..self.start[k + 1]].sort_unstable();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts the entries below the diagonal, in nodes.
    fn fill(order: &Order) -> usize {
        order.rows.len()
    }

    fn ordered(count: usize, edges: &[(usize, usize)]) -> Order {
        let mut order = Order::default();
        assert!(order.fit(count, edges.iter().copied()));
        assert!(!order.fit(count, edges.iter().copied()), "the same graph is not ordered again");
        order
    }

    /// A path, a star and a tree have no fill-in: as many entries as edges.
    #[test]
    fn trees_fill_nothing() {
        for count in [1, 2, 3, 64, 65, 200] {
            let path: Vec<_> = (1..count).map(|i| (i - 1, i)).collect();
            let star: Vec<_> = (1..count).map(|i| (0, i)).collect();
            let tree: Vec<_> = (1..count).map(|i| (i, (i - 1) / 2)).collect();
            for edges in [path, star, tree] {
                assert_eq!(fill(&ordered(count, &edges)), edges.len());
            }
        }
    }

    /// A grid of m × m: the natural order fills to m entries per node, minimum degree to less than
    /// half. Costs are counts, the same on every machine.
    #[test]
    fn grids_fill_little() {
        let m = 20;
        let mut edges = Vec::new();
        for i in 0..m * m {
            if i % m > 0 {
                edges.push((i - 1, i));
            }
            if i >= m {
                edges.push((i - m, i));
            }
        }
        let order = ordered(m * m, &edges);
        assert!(2 * fill(&order) < m * m * m, "{}", fill(&order));
        assert!(fill(&order) > edges.len());
    }

    /// Every node has a turn; the neighbours of a node come later; the earliest of these touches
    /// the others.
    #[test]
    fn columns_are_those_of_an_elimination() {
        let mut edges = Vec::new();
        let mut state = 7usize;
        for _ in 0..150 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            edges.push(((state >> 33) % 70, (state >> 45) % 70));
        }
        let order = ordered(70, &edges);
        for (i, j) in edges.iter().filter(|(i, j)| i != j) {
            let (a, b) = (order.turn[*i], order.turn[*j]);
            assert!(order.column(a.min(b)).contains(&a.max(b)));
        }
        for k in 0..70 {
            assert_eq!(order.turn[order.sequence[k]], k);
            assert!(order.column(k).windows(2).all(|pair| pair[0] < pair[1]));
            assert!(order.column(k).iter().all(|i| *i > k));
            if let Some((parent, rest)) = order.column(k).split_first() {
                assert!(rest.iter().all(|i| order.column(*parent).contains(i)));
            }
        }
    }
}
