//! Code or the stages, where the stages do a part of the code's work: whichever takes less time.
//!
//! Both have the same bits, so groups may go either way at any step. Most go the quicker way, and some the
//! other one, which tells when that changes: on the ground a robot has rows that it had not in the air.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// Of so many groups one goes the slower way.
const OTHER: u64 = 16;
/// Steps of groups after which what they took counts half.
const MEMORY: u64 = 4096;
/// Steps before which both ways are tried in turn.
const FEW: u64 = 8;

/// What both ways took: [ns] and steps of groups, of the stages and of code.
#[derive(Default)]
pub(super) struct Contest {
    ways: [[AtomicU64; 2]; 2],
    calls: AtomicU64,
}

impl Contest {
    /// A call of all groups begins.
    pub fn begin(&self) {
        self.calls.fetch_add(1, Ordering::Relaxed);
    }

    /// Whether a group goes by code.
    pub fn by_code(&self, group: usize) -> bool {
        let [stages, code] = [0, 1].map(|way| {
            let [took, steps] = &self.ways[way];
            (took.load(Ordering::Relaxed) as f64, steps.load(Ordering::Relaxed))
        });
        let turn = group as u64 + self.calls.load(Ordering::Relaxed);
        if stages.1 < FEW || code.1 < FEW {
            return turn.is_multiple_of(2);
        }
        let code_wins = code.0 / (code.1 as f64) < stages.0 / stages.1 as f64;
        code_wins != turn.is_multiple_of(OTHER)
    }

    /// So many steps of a group go this way.
    pub fn time(&self, by_code: bool, steps: u64, go: impl FnOnce()) {
        let started = Instant::now();
        go();
        let [took, all] = &self.ways[usize::from(by_code)];
        took.fetch_add(started.elapsed().as_nanos() as u64, Ordering::Relaxed);
        if all.fetch_add(steps, Ordering::Relaxed) > MEMORY {
            for number in [took, all] {
                number.store(number.load(Ordering::Relaxed) / 2, Ordering::Relaxed);
            }
        }
    }
}
