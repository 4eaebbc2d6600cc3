//! Code that is made while the stages step.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use super::alone::may_be_short;
use super::desk::Compiled;
use super::isa::Isa;
use crate::model::Model;
use crate::real::Real;
use crate::settings::Settings;

/// What the stages must have taken before code is worth making, for each dof and each pair of geoms: two or
/// three times what that takes, which is 20 ms for hopper (6 dofs, 8 pairs), 130 for ant, 350 for a Panda (9 dofs,
/// 208 pairs).
const A_DOF: Duration = Duration::from_millis(10);
const A_PAIR: Duration = Duration::from_millis(3);

/// Operations that are made to code at once: that takes a millisecond or two.
const AT_ONCE: usize = 1000;

/// When code is made: `STEPCORE_COMPILE` is 0 for never, `now` for before the first step, else it is
/// begun once steps take long.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum When {
    Never,
    Now,
    Later,
}

impl When {
    fn asked() -> Self {
        match std::env::var("STEPCORE_COMPILE").as_deref() {
            Ok("0") => Self::Never,
            Ok("now") => Self::Now,
            _ => Self::Later,
        }
    }
}

/// The vectors of machine code on this machine; none where steps always run the stages.
pub fn vectors() -> Option<&'static str> {
    let own = Isa::of_this_machine(false).filter(|_| When::asked() != When::Never)?;
    Some(if own.wide { "avx512" } else { "avx2" })
}

/// Code of the steps of models that differ in numbers alone: there, or not yet, or never.
pub struct Coming {
    make: Box<dyn Fn() -> Option<Arc<Compiled>> + Send + Sync>,
    settings: Settings,
    made: OnceLock<Option<Arc<Compiled>>>,
    when: When,
    /// What the stages must take before it is worth making [ns], and what they have taken.
    worth: u64,
    taken: AtomicU64,
}

impl Coming {
    pub fn of<R: Real>(models: Arc<[Arc<Model>]>, settings: &Settings) -> Arc<Self> {
        let (of, own) = (models.clone(), settings.clone());
        let make = move || Compiled::of::<R>(&of, &own, usize::MAX);
        let when = When::asked();
        let model = &models[0];
        let worth = A_DOF * model.nv as u32 + A_PAIR * model.pairs.len() as u32;
        let made = OnceLock::new();
        if when == When::Later && models.len() == 1 && may_be_short(&models[0]) {
            // Of a small model it is there before somebody asks for it.
            if let Some(code) = Compiled::of::<R>(&models, settings, AT_ONCE) {
                let _ = made.set(Some(code));
            }
        }
        let own = Self {
            make: Box::new(make),
            settings: settings.clone(),
            made,
            when,
            worth: worth.as_nanos() as u64,
            taken: AtomicU64::new(0),
        };
        Arc::new(own)
    }

    /// The same of other models.
    pub fn of_other<R: Real>(&self, models: Arc<[Arc<Model>]>) -> Arc<Self> {
        Self::of::<R>(models, &self.settings)
    }

    /// The code, if it is there.
    pub fn code(&self) -> Option<&Arc<Compiled>> {
        match self.when {
            When::Never => None,
            When::Now => self.made.get_or_init(&*self.make).as_ref(),
            When::Later => self.made.get()?.as_ref(),
        }
    }

    /// The stages do a part of its steps, and may be quicker: it is there to be tried.
    pub fn contested(&self) -> bool {
        let code = self.code().filter(|_| self.when == When::Later);
        code.is_some_and(|code| code.hands_over())
    }

    /// The stages have taken so long.
    pub fn stages_took(self: &Arc<Self>, time: Duration) {
        if self.when != When::Later || self.made.get().is_some() {
            return;
        }
        let worth = self.worth;
        let before = self.taken.fetch_add(time.as_nanos() as u64, Ordering::Relaxed);
        if before < worth && before + time.as_nanos() as u64 >= worth {
            let own = self.clone();
            // Where there is no thread for it, the stages go on.
            let name = std::thread::Builder::new().name("stepcore-compile".into());
            let _ = name.spawn(move || {
                own.made.get_or_init(&*own.make);
            });
        }
    }
}
