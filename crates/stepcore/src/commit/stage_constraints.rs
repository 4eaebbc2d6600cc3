//! The rows that act at the stages of `midpoint` and `rk4`, and the rows that act after them.

use crate::error::Result;
use crate::integrator::Inside;
use crate::observer::Observer;
use crate::real::Real;
use crate::sim::{At, Sim};
use crate::solve::{Choice, Part};

impl<R: Real> Sim<R> {
    /// Makes one step: `stages`, then the rows that do not act within them.
    pub(super) fn after_stages(
        &mut self,
        stages: impl FnOnce(&mut Self, Inside, &mut dyn Observer<R>) -> Result<()>,
        observer: &mut dyn Observer<R>,
    ) -> Result<()> {
        let inside = self.plan.inside;
        self.next.start.copy_from_slice(&self.state.qvel);
        self.next.held.fill(R::zero());
        if inside == Inside::Equalities && self.settings.law.on_guess() {
            self.start(observer)?;
        }
        stages(self, inside, observer)?;
        if inside == Inside::All {
            return Ok(());
        }
        self.rows_at_the_end(observer)
    }

    /// Projects the velocities at the start onto the equalities, and removes a share β of their
    /// violation. The stages change neither.
    fn start(&mut self, observer: &mut dyn Observer<R>) -> Result<()> {
        let model = self.model.clone();
        let (qpos, qvel) = At::State.of(&self.state, &self.next);
        let act = self.state.activations(self.clock);
        self.placed.place(&model, qpos, qvel, act, &self.inputs, R::zero());
        self.connect(At::State, Part::Start, 1.0, Choice::Now)?;
        observer.solved(self, At::State, 1.0);
        for k in 0..model.nv {
            self.next.start[k] += self.velocity[k];
        }
        Ok(())
    }

    /// Computes the acceleration of a stage, which acts for a share of the step.
    pub(super) fn accelerate(
        &mut self,
        at: At,
        inside: Inside,
        share: f64,
        choice: Choice,
    ) -> Result<()> {
        match inside {
            Inside::Nothing => {
                self.smooth(at);
                Ok(())
            }
            Inside::Equalities => self.smooth_and_connected(at, share, choice),
            Inside::All => self.place_detect_solve(at),
        }
    }
}
