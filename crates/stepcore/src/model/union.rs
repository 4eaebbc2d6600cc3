//! Union-find (Tarjan 1975): sets that grow into one another, each identified by its lowest member.

/// For each member: a member of its set that is no higher, at last the lowest.
#[derive(Clone, Debug, Default)]
pub(crate) struct Union {
    below: Vec<usize>,
}

room!(Union: below);

impl Union {
    pub fn new(count: usize) -> Self {
        Self { below: (0..count).collect() }
    }

    /// Makes a set of each of `count` members.
    pub fn reset(&mut self, count: usize) {
        self.below.clear();
        self.below.extend(0..count);
    }

    /// The lowest member of a set.
    pub fn of(&mut self, mut member: usize) -> usize {
        while self.below[member] != member {
            self.below[member] = self.below[self.below[member]];
            member = self.below[member];
        }
        member
    }

    pub fn join(&mut self, one: usize, two: usize) {
        let (one, two) = (self.of(one), self.of(two));
        self.below[one.max(two)] = one.min(two);
    }
}
