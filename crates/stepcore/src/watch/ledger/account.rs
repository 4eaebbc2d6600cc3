//! The account of one world: what its energy is, and what a passive scene could have.
//!
//! E is kinetic energy, springs and gravity; W what motors and applied forces put in. E − W
//! can only fall, but for what violated rows give back: |λ|/dt·|r| at most, the force of a
//! row through the whole of its violation. So E − W never rises above its least value so far,
//! violated rows counted there and not now. An integrator's own error rises with the energy
//! that circulates, and so does what it may be: `scale`, the most that moved or was stored
//! without being a gain itself. No number here has a unit of its own.

use crate::real::Real;

/// Energies of one world [J].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Level {
    /// Kinetic, and of joint springs: never below zero.
    pub moving: f64,
    pub gravity: f64,
    /// The most that rows violated at this state give back.
    pub held: f64,
    /// The size of the numbers that were summed, for rounding.
    pub size: f64,
    /// What rows may give in a step that are solved to the tolerance asked for, and no better.
    pub unsolved: f64,
}

/// What one world may have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Account {
    /// Work of motors and applied forces since the account was opened [J].
    pub paid: f64,
    /// Least E − W so far, violated rows counted [J].
    least: f64,
    /// Energy that circulated [J].
    pub scale: f64,
    /// How many times `scale` may be gained.
    allowed: f64,
    throughput: f64,
    unsolved: f64,
}

/// A gain of this share of the energies at hand is none that matters, whatever circulates.
const NEGLIGIBLE: f64 = 1e-8;

/// What an account says of a level.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Verdict {
    /// Energy that no element can have given [J]; negative: none.
    pub gained: f64,
    /// The most that is not suspicious [J].
    pub limit: f64,
}

impl Account {
    /// A gain of `allowed` times the energy that circulates is not suspicious.
    pub fn open(level: &Level, allowed: f64) -> Self {
        Self {
            paid: 0.0,
            least: level.moving + level.gravity + level.held,
            scale: level.moving + level.held,
            allowed,
            throughput: 0.0,
            unsolved: 0.0,
        }
    }

    /// Takes the work done since the last level, so many steps ago, and judges the present one.
    pub fn judge<R: Real>(&mut self, level: &Level, work: f64, steps: f64) -> Verdict {
        self.unsolved += steps * level.unsolved;
        self.paid += work;
        self.throughput += work.abs();
        let free = level.moving + level.gravity - self.paid;
        let gained = free - self.least;
        // What violated rows hold may be gained as well.
        let unearned = (free + level.held - self.least).max(0.0);
        let earned = if unearned > 0.0 {
            // moving + held − unearned, but for rounding
            self.least + self.paid - level.gravity
        } else {
            level.moving + level.held
        };
        self.scale = self.scale.max(earned);
        self.least = self.least.min(free + level.held);
        // A world at rest has nothing that circulates, and rounding all the same; forces that
        // hold each other then move it by what the solver leaves.
        let rounding = NEGLIGIBLE.max(1024.0 * R::epsilon()) * (level.size + self.throughput);
        let unsure = rounding + self.unsolved;
        // An energy beyond all numbers is none that was rounded.
        let unsure = if unsure.is_finite() { unsure } else { 0.0 };
        Verdict { gained, limit: self.allowed * self.scale + unsure }
    }

    /// A gain that was looked into, and is none of the step's making, is allowed; the next
    /// to be looked into is twice as large.
    pub fn allow(&mut self, gained: f64, times: f64) {
        let reached = if self.scale > 0.0 { gained / self.scale } else { 0.0 };
        self.allowed = self.allowed.max(2.0 * reached).max(times);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As with `Settings::ledger`.
    const ALLOWED: f64 = 1.0;

    /// A ball of energy `e` [J] above its floor, so much of it moving.
    fn ball(e: f64, share: f64) -> Level {
        Level { moving: e * share, gravity: e * (1.0 - share), held: 0.0, size: e, unsolved: 0.0 }
    }

    /// Looked at anywhere in its flight, at the top of it too, where nothing moves.
    const SHARES: [f64; 7] = [0.3, 0.9, 0.0, 0.6, 0.01, 1.0, 0.5];

    #[test]
    fn what_grows_a_little_at_each_bounce_is_found_when_it_has_doubled() {
        let mut account = Account::open(&ball(1.0, 0.0), ALLOWED);
        let mut found = None;
        for n in 0..2000 {
            let e = 1.001_f64.powi(n);
            let verdict = account.judge::<f64>(&ball(e, SHARES[n as usize % 7]), 0.0, 1.0);
            if verdict.gained > verdict.limit {
                found = found.or(Some(e));
            }
        }
        assert!(found.is_some_and(|e| e > 1.9 && e < 2.1), "{found:?}");
    }

    #[test]
    fn what_keeps_its_energy_within_a_share_is_not() {
        let mut account = Account::open(&ball(1.0, 0.0), ALLOWED);
        for n in 0..100_000 {
            let e = 1.0 + 0.2 * (n % 17) as f64 / 17.0;
            let verdict = account.judge::<f64>(&ball(e, SHARES[n as usize % 7]), 0.0, 1.0);
            assert!(verdict.gained <= verdict.limit);
        }
    }

    #[test]
    fn what_is_lifted_is_paid() {
        let mut account = Account::open(&ball(0.0, 0.0), ALLOWED);
        for n in 1..1000 {
            let level = Level {
                moving: 0.5,
                gravity: f64::from(n),
                held: 0.0,
                size: f64::from(n),
                unsolved: 0.0,
            };
            let verdict = account.judge::<f64>(&level, if n == 1 { 1.5 } else { 1.0 }, 1.0);
            assert!(verdict.gained <= verdict.limit);
        }
    }
}
