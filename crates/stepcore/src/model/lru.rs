//! A cache of expensive results about a scene, for the next compilation of the same question.

use std::collections::VecDeque;

/// Questions with their answers, the last one used at the back; the oldest used are removed.
pub(super) struct Lru<K, V> {
    entries: VecDeque<(K, V)>,
    /// The size of all entries together, and its limit.
    size: usize,
    most: usize,
    size_of: fn(&K) -> usize,
}

impl<K, V: Clone> Lru<K, V> {
    pub const fn new(most: usize, size_of: fn(&K) -> usize) -> Self {
        Self { entries: VecDeque::new(), size: 0, most, size_of }
    }

    /// The answer to a question, if it is still kept.
    pub fn recalled(&mut self, same: impl Fn(&K) -> bool) -> Option<V> {
        let entry = self.take(same)?;
        let answer = entry.1.clone();
        self.put(entry);
        Some(answer)
    }

    /// Keeps an answer and replaces one to the same question.
    pub fn keep(&mut self, question: K, answer: V, same: impl Fn(&K, &K) -> bool) {
        self.take(|other| same(other, &question));
        self.put((question, answer));
    }

    pub fn clear(&mut self) {
        self.entries = VecDeque::new();
        self.size = 0;
    }

    fn take(&mut self, same: impl Fn(&K) -> bool) -> Option<(K, V)> {
        let at = self.entries.iter().position(|(other, _)| same(other))?;
        let entry = self.entries.remove(at)?;
        self.size -= (self.size_of)(&entry.0);
        Some(entry)
    }

    fn put(&mut self, entry: (K, V)) {
        self.size += (self.size_of)(&entry.0);
        self.entries.push_back(entry);
        while self.size > self.most {
            let Some((oldest, _)) = self.entries.pop_front() else { break };
            self.size -= (self.size_of)(&oldest);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_used_longest_ago_makes_room() {
        let mut recent = Lru::new(10, |size: &usize| *size);
        let same = |a: &usize, b: &usize| a == b;
        recent.keep(4, "four", same);
        recent.keep(5, "five", same);
        assert_eq!(recent.recalled(|size| *size == 4), Some("four"));
        recent.keep(2, "two", same);
        assert_eq!(recent.recalled(|size| *size == 5), None);
        assert_eq!(recent.recalled(|size| *size == 4), Some("four"));
        // An answer replaces the one before it.
        recent.keep(4, "vier", same);
        assert_eq!((recent.entries.len(), recent.size), (2, 6));
        // An entry above the limit is not kept, nor anything else.
        recent.keep(11, "eleven", same);
        assert_eq!((recent.entries.len(), recent.size), (0, 0));
    }
}
