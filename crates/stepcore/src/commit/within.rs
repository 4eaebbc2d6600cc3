//! An adaptive step of `dt`: as many stretches as needed, each extrapolated from steps of the
//! integrator (`extrapolation.rs`).
//!
//! The start and the length of a stretch are binary fractions of the step, so that the step ends at
//! the exact time. Every step first tries its whole length: no other state is passed on. The
//! controlled error is the one that a stretch adds to the position of each body (centre of mass and
//! rotation) and the displacement from velocity errors.
//!
//! Extrapolation requires a smooth motion. A contact that starts, a servo that reaches the bound of
//! its force or a joint that sticks is not smooth: between evaluations it is invisible, and the
//! results may agree by chance. So the changes of velocity of equal steps are examined, with one
//! step beyond the stretch: their highest difference counts as an error too.

use super::extrapolation::{worse, Extrapolation, Largest, Now, CUTS};
use crate::clock::Clock;
use crate::elements::activation::remember;
use crate::elements::{Element, Kind};
use crate::error::{Error, Fault, Result};
use crate::interrupt::{caught, Meter, STRETCH};
use crate::real::{Mask, Real};
use crate::sim::{At, Sim, Stretches};

/// A shorter stretch may add as much error as one of this length [s]: a hundred sudden events (impacts)
/// per second use up the tolerance. With 0.03 s, SO-101, whose joints stick, has six times the allowed
/// error; with 0.02 s the scenes of `benches/accuracy.py` take an eighth fewer evaluations, and one
/// reaches 0.97 of the tolerance. Counting the highest difference (`Extrapolation::count`) at a half to
/// a sixth saves a fifth of them, and costs SO-101 a factor of three. Of the runs of
/// `benches/accuracy.py --random 300`, 0.7 % exceed the tolerance, at most 3-fold; a third of this
/// length takes 1.3 times the evaluations if contacts come and go.
const SUDDEN: f64 = 0.01;
/// The step divided by the shortest stretch, as a power of two.
const FINEST: u32 = 36;
/// The most that a stretch is shortened at once, by powers of two.
const SHORTER: u32 = 4;
/// If the error exceeds the allowed one by this factor, no finer cut is tried.
const HOPELESS: f64 = 1e4;
/// The target of the next stretch, as a share of the allowed error.
const SAFETY: f64 = 0.5;

/// The result of a stretch.
struct Tried {
    /// The error that it adds [m], and the body with the largest.
    error: Largest,
    /// The power of its length to which that is proportional.
    power: u32,
}

impl<R: Real> Sim<R> {
    /// Makes one step, into `next`, that adds at most `asked` metres of error per second.
    pub(crate) fn integrate_within(&mut self, asked: f64) -> Result<()> {
        let Some(mut space) = self.extrapolation.take() else { return Ok(()) };
        self.state.copy_to(&mut space.period);
        // Controls are sampled once per step, and its parts read the same samples.
        self.next.ctrl_history.copy_from_slice(&self.state.ctrl_history);
        self.effort.stretches = Stretches { shortest: self.period, refused: None };
        let outcome = caught(|| self.stretches(&mut space, asked));
        if outcome.is_ok() {
            self.swap_states();
        }
        space.period.copy_to(&mut self.state);
        let (before, after) = (&self.state.ctrl_history, &mut self.next.ctrl_history);
        remember(&self.model, before, &self.inputs.ctrl, after);
        self.extrapolation = Some(space);
        outcome
    }

    /// Advances the state to the end of the step.
    fn stretches(&mut self, space: &mut Extrapolation<R>, asked: f64) -> Result<()> {
        let (whole, mut at, mut level) = (1_u64 << FINEST, 0, 0);
        let mut meter = Meter::default();
        while at != whole {
            meter.count(STRETCH);
            if self.effort.evaluations > self.most {
                return Err(self.too_dear());
            }
            self.state.copy_to(&mut space.from);
            let length = self.period / (1_u64 << level) as f64;
            let allowed = asked * length.max(SUDDEN);
            let tried = self.stretch(space, length, allowed);
            if let Ok(Tried { error, power }) = &tried {
                if error.0 <= allowed {
                    self.effort.stretches.take(length);
                    at += whole >> level;
                    let grown = error.0 * f64::from(1_u32 << power);
                    let begins = level > 0 && at.is_multiple_of(whole >> (level - 1));
                    if begins && grown <= SAFETY * allowed {
                        level -= 1;
                    }
                    continue;
                }
            }
            space.from.copy_to(&mut self.state);
            self.effort.stretches.refuse(length, tried.as_ref().ok().map(|tried| tried.error.1));
            if level == FINEST {
                let error = tried?.error;
                return Err(self.too_rough(error, length));
            }
            let shorter = match tried {
                Err(Error::Diverged(_)) => SHORTER,
                Err(error) => return Err(error),
                Ok(Tried { error, power }) => {
                    let halvings = (error.0 / allowed).log2() / f64::from(power);
                    // For a number that is not finite this is 0.
                    (halvings.ceil() as u32).clamp(1, SHORTER)
                }
            };
            level = (level + shorter).min(FINEST);
        }
        Ok(())
    }

    /// Advances the state over one stretch from `space.from`, the current state.
    fn stretch(
        &mut self,
        space: &mut Extrapolation<R>,
        length: f64,
        allowed: f64,
    ) -> Result<Tried> {
        let mut tried = Tried { error: (f64::INFINITY, 0), power: 1 };
        for (nth, cuts) in CUTS.into_iter().enumerate() {
            if nth > 0 {
                space.from.copy_to(&mut self.state);
            }
            self.set_dt(length / f64::from(cuts));
            for part in 0..cuts {
                self.part(space, part, cuts)?;
                self.swap_states();
            }
            space.take(&self.model, &self.state, nth);
            if nth == 0 {
                continue;
            }
            if nth == 1 {
                space.settle(&self.moment(At::State), &self.placed);
            }
            tried = Tried { error: space.error(&self.now()), power: nth as u32 };
            if tried.error.0 <= allowed {
                space.store(&self.model, &mut self.state);
                self.part(space, cuts, cuts)?;
                let jump = space.jump(&self.now());
                let power = if jump.0 > allowed { 1 } else { tried.power };
                return Ok(Tried { error: worse(tried.error, jump), power });
            }
            if tried.error.0 > HOPELESS * allowed {
                break;
            }
        }
        Ok(tried)
    }

    /// Makes a step of the integrator, into `next`: the nth of `of`.
    fn part(&mut self, space: &mut Extrapolation<R>, nth: u32, of: u32) -> Result<()> {
        self.integrate(&mut ())?;
        self.check_next()?;
        space.count(nth, of, &self.state.qvel, &self.next.qvel);
        Ok(())
    }

    fn now(&self) -> Now<'_, R> {
        Now {
            model: &self.model,
            placed: &self.placed,
            inputs: &self.inputs,
            state: &self.state,
            clock: self.clock,
        }
    }

    /// Sets the length of steps from now on [s].
    pub(crate) fn set_dt(&mut self, dt: f64) {
        if self.settings.dt != dt {
            self.settings.dt = dt;
            self.clock = Clock { period: self.period, ..Clock::new(dt) };
            self.placed.set_dt(self.clock.dt);
            self.plan.noslip_cost = self.settings.cost_floor(self.settings.noslip_tolerance);
        }
    }

    /// The error when the run may not evaluate forces any more.
    #[cold]
    fn too_dear(&self) -> Error {
        self.diverged(R::Mask::of(true), |_| Fault::Evaluations)
    }

    /// The error when no stretch is short enough.
    fn too_rough(&self, (error, body): Largest, length: f64) -> Error {
        let body = self.model.named(Element::whole(Kind::Body, body));
        let asked = self.settings.accuracy.0.unwrap_or_default();
        self.diverged(R::Mask::of(true), |_| Fault::Rough { error, length, asked, body })
    }
}
