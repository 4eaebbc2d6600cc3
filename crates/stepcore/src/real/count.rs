//! `Count`: an integer for each lane.

use super::lanes::WIDEST;
use super::Mask;

/// A count for each lane; a scalar uses the first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Count([u64; WIDEST]);

impl Count {
    pub const ZERO: Self = Self([0; WIDEST]);

    #[inline(always)]
    pub fn lane(&self, lane: usize) -> u64 {
        self.0[lane]
    }

    /// Adds `n` in the lanes of `mask`.
    #[inline(always)]
    pub fn add<M: Mask>(&mut self, mask: M, n: u64) {
        for (lane, count) in self.0[..M::LANES].iter_mut().enumerate() {
            *count += if mask.lane(lane) { n } else { 0 };
        }
    }

    /// Adds each lane's number in the lanes of `mask`.
    #[inline(always)]
    pub fn add_each<M: Mask>(&mut self, mask: M, more: &Self) {
        for (lane, count) in self.0[..M::LANES].iter_mut().enumerate() {
            *count += if mask.lane(lane) { more.0[lane] } else { 0 };
        }
    }

    /// Raises to at least `least` in the lanes of `mask`.
    #[inline(always)]
    pub fn raise_in<M: Mask>(&mut self, mask: M, least: u64) {
        for (lane, count) in self.0[..M::LANES].iter_mut().enumerate() {
            *count = (*count).max(if mask.lane(lane) { least } else { 0 });
        }
    }

    /// Raises to the larger of both, lane by lane.
    #[inline(always)]
    pub fn raise(&mut self, other: &Self) {
        for (count, other) in self.0.iter_mut().zip(other.0) {
            *count = (*count).max(other);
        }
    }

    /// Returns the lanes whose count is `most` or less.
    #[inline(always)]
    pub fn at_most<M: Mask>(&self, most: u64) -> M {
        M::from_lanes(|lane| self.0[lane] <= most)
    }
}
