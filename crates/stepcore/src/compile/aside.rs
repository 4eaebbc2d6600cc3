//! Who does what code leaves to the stages.

use super::handed::Handed;
use super::memory::Aligned;
use super::pairs::Meeting;
use super::rows::Solving;
use crate::model::Model;
use crate::real::Real;
use crate::room::Room;
use crate::settings::Settings;

pub(super) enum Aside<R: Real> {
    Pairs(Box<Meeting<R>>),
    Rows(Box<Solving<R>>),
}

impl<R: Real> Room for Aside<R> {
    fn room(&self) -> usize {
        match self {
            Self::Pairs(meeting) => meeting.room(),
            Self::Rows(solving) => solving.room(),
        }
    }
}

impl<R: Real> Aside<R> {
    pub fn new(handed: &Handed) -> Self {
        match handed {
            Handed::Pairs(_) => Self::Pairs(Box::new(Meeting::new())),
            Handed::Rows(rows) => Self::Rows(Box::new(Solving::new(rows))),
        }
    }

    /// False: the step is one for the stages.
    pub fn work(
        &mut self,
        handed: &Handed,
        (model, settings): (&Model<R::Value>, &Settings),
        memory: &mut Aligned,
    ) -> bool {
        match (self, handed) {
            (Self::Pairs(own), Handed::Pairs(pairs)) => own.none(pairs, model, memory),
            (Self::Rows(own), Handed::Rows(rows)) => own.solve(rows, settings, memory),
            _ => false,
        }
    }
}
