//! The account of one world: its energy, and the energy that a passive scene could have.
//!
//! E is kinetic energy, springs and gravity; W the work of motors and applied forces. E − W can
//! only fall, except for what violated rows give back: |λ|/dt·|r| at most, the force of a row
//! through the whole of its violation. So E − W never rises above its lowest earlier value, with
//! violated rows counted there and not now. An integrator's error rises with the energy that
//! circulates, and so does its allowance: `scale`, the most that moved or was stored without being
//! a gain itself. All constants here are dimensionless.

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
    /// The most that rows solved only to the requested tolerance may give in a step.
    pub unsolved: f64,
}

/// The energy that one world may have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Account {
    /// Work of motors and applied forces since the account was opened [J].
    pub paid: f64,
    /// The least E − W until now, violated rows counted [J].
    least: f64,
    /// Energy that circulated [J].
    pub scale: f64,
    /// The allowed gain as a multiple of `scale`.
    allowed: f64,
    throughput: f64,
    unsolved: f64,
}

/// A gain of this share of the present energies does not matter, whatever circulates.
const NEGLIGIBLE: f64 = 1e-8;

/// The judgement of an account on a level.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Verdict {
    /// Energy that no element can have given [J]; negative: none.
    pub gained: f64,
    /// The largest gain that is not suspicious [J].
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

    /// Adds the work since the last level, this many steps ago, and judges the present one.
    pub fn judge<R: Real>(&mut self, level: &Level, work: f64, steps: f64) -> Verdict {
        self.unsolved += steps * level.unsolved;
        self.paid += work;
        self.throughput += work.abs();
        let free = level.moving + level.gravity - self.paid;
        let gained = free - self.least;
        // The energy held by violated rows may be gained as well.
        let unearned = (free + level.held - self.least).max(0.0);
        let earned = if unearned > 0.0 {
            // moving + held − unearned, up to rounding
            self.least + self.paid - level.gravity
        } else {
            level.moving + level.held
        };
        self.scale = self.scale.max(earned);
        self.least = self.least.min(free + level.held);
        // A world at rest has no circulating energy, but it has rounding; forces that balance each
        // other then move it by the solver's residual.
        let rounding = NEGLIGIBLE.max(1024.0 * R::epsilon()) * (level.size + self.throughput);
        let unsure = rounding + self.unsolved;
        // An energy beyond all numbers has no rounding.
        let unsure = if unsure.is_finite() { unsure } else { 0.0 };
        Verdict { gained, limit: self.allowed * self.scale + unsure }
    }

    /// Allows a gain that was examined and was not caused by the step; the next one to be examined
    /// is twice as large.
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

    /// A ball of energy `e` [J] above its floor, this share of it moving.
    fn ball(e: f64, share: f64) -> Level {
        Level { moving: e * share, gravity: e * (1.0 - share), held: 0.0, size: e, unsolved: 0.0 }
    }

    /// Examined anywhere in its flight, at the top of it too, where nothing moves.
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
