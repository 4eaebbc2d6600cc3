//! Laws: the velocity after the step that a violated constraint requires.
//!
//! A law turns (violation φ, row velocity u before the step) into a target t and
//! a regulariser c. `solref` is MuJoCo's: MuJoCo documentation, "Constraint model"
//! and "Solver parameters". The others act on the velocity of the guess, after
//! Baumgarte (1972) and Stewart & Trinkle (1996).

use super::rows::Row;
use super::situation::Situation;
use crate::real::array::from_fn;
use crate::real::{elementary, Constant, Mask, Real, Value};
use crate::scene::Softness;
use crate::settings::{Law, Settings};

/// MuJoCo's `mjMINIMP`, `mjMAXIMP`: dimensionless guards of the impedance.
const IMPEDANCE: [f64; 2] = [0.0001, 0.9999];

/// The least R relative to A, in roundings.
const LEAST_SOFTNESS: f64 = 64.0;
/// The least R of a contact without inverse weight relative to A: 2⁻³⁵, and 2⁻¹⁵ in f32.
const WEIGHTLESS: f64 = 1.0 / (1u64 << 35) as f64;
const WEIGHTLESS_F32: f64 = 1.0 / (1u64 << 15) as f64;

/// Spring, damper and impedance of one row or block under `solref`.
#[derive(Clone, Copy)]
pub struct SolRef<R: Real> {
    /// Damping b [1/s] and stiffness K·d [1/s²]: a_ref = −b u − K d r.
    pub b: R,
    pub kd: R,
    /// (1 − d)/d: R is this times the inverse weight.
    pub softness: R,
}

/// The part of `solref` and `solimp` that does not depend on the violation.
#[derive(Clone, Copy)]
pub struct Spring<'a, R: Real> {
    solimp: &'a [R::Value; 5],
    stiffness: R,
    b: R,
}

impl<'a, R: Real> Spring<'a, R> {
    pub fn new(soft: &'a Softness<R::Value>, dt: f64, refsafe: bool) -> Self {
        Self::of(soft.solref.each_ref(), &soft.solimp, dt, refsafe)
    }

    /// From `solref` and `solimp`.
    #[inline(always)]
    pub fn of([s0, s1]: [&R::Value; 2], solimp: &'a [R::Value; 5], dt: f64, refsafe: bool) -> Self {
        let dw = &solimp[1];
        let (stiffness, b) = if s0.is_positive() {
            let tc = |s0: f64| if refsafe { s0.max(2.0 * dt) } else { s0 };
            let stiffness = Value::calc([s0, s1, dw], |[s0, s1, dw]| {
                let (tc, dw) = (tc(s0), impedance(dw));
                1.0 / (dw * dw * tc * tc * s1 * s1)
            });
            (stiffness, Value::calc([s0, dw], |[s0, dw]| 2.0 / (impedance(dw) * tc(s0))))
        } else {
            let stiffness = Value::calc([s0, dw], |[s0, dw]| {
                let dw = impedance(dw);
                -s0 / (dw * dw)
            });
            (stiffness, Value::calc([s1, dw], |[s1, dw]| -s1 / impedance(dw)))
        };
        Self { solimp, stiffness, b }
    }

    /// From a time constant alone: critically damped.
    pub fn critical(time: &R::Value, solimp: &'a [R::Value; 5], dt: f64, refsafe: bool) -> Self {
        let ratio = R::Value::by_lane(&[1.0]);
        Self::of([time, &ratio], solimp, dt, refsafe)
    }

    /// At the violation `r` (its size, for a block).
    #[inline(always)]
    pub fn at(&self, r: R) -> SolRef<R> {
        let d = impedance_at(self.solimp, r);
        SolRef { b: self.b, kd: self.stiffness * d, softness: (R::one() - d) / d }
    }

    /// For a row that restores no position: at no violation.
    #[inline(always)]
    pub fn at_rest(&self) -> SolRef<R> {
        let d: R = impedance_at_rest(self.solimp);
        SolRef { b: self.b, kd: R::zero(), softness: (R::one() - d) / d }
    }
}

impl<R: Real> SolRef<R> {
    /// At the violation `r` (its size, for a block).
    pub fn at(soft: &Softness<R::Value>, r: R, dt: f64, refsafe: bool) -> Self {
        Spring::new(soft, dt, refsafe).at(r)
    }

    /// Limits the spring to at most `most` [m/s] for an overlap r whose speed is u: u − dt·(b u + K
    /// d r) ≤ max(most, u).
    pub fn at_most(self, u: R, r: R, most: R, dt: R) -> Self {
        let allowed = most.max(u) - u * (R::one() - dt * self.b);
        let over = (-(self.kd * r * dt)).gt(allowed).and(r.lt(R::zero()));
        let kd = (allowed / (-r * dt)).max(R::zero());
        Self { kd: R::select(over, kd, self.kd), ..self }
    }

    /// For a row that restores no position: friction loss, and the tangents of a cone.
    pub fn without_position(self) -> Self {
        Self { kd: R::zero(), ..self }
    }

    /// For the tangents of a cone: without position, and with the damper of the friction's `solref`
    /// if there is one.
    pub fn of_friction(
        self,
        own: &Option<[R::Value; 2]>,
        soft: &Softness<R::Value>,
        settings: &Settings,
    ) -> Self {
        let Some(solref) = own else { return self.without_position() };
        let b = Spring::of(solref.each_ref(), &soft.solimp, settings.dt, settings.refsafe).b;
        Self { b, ..self.without_position() }
    }

    /// Fill in a row: t = u + dt·a_ref at the violation `r`, c = R = softness × `weight`, at least
    /// `least` (`least_softness` of its block).
    #[inline(always)]
    pub fn fill(&self, row: &mut Row<R>, r: R, weight: R, least: R, dt: R) {
        row.gap = r;
        row.t = row.velocity - dt * (self.b * row.velocity + self.kd * r);
        row.c = (self.softness * weight).max(least);
        row.inv_s = (row.a + row.c).recip_or_zero();
    }
}

/// The target with which a row of regulariser c, whose guess moves at `guess`, opens at `most` by
/// itself: most + cλ. A soft row carries its load through the excess of its target over its speed.
pub fn target_at<R: Real>(row: &Row<R>, c: R, guess: R, most: f64) -> R {
    let most = R::of(most);
    most + c * (most - guess).max(R::zero()) * row.a.recip_or_zero()
}

/// The least regulariser of a block's rows: an R that is only rounding relative to A would be
/// indistinguishable from zero, and leave Newton's Hessian without digits.
///
/// It follows from the row that is moved most, because the rows of a block depend on each other: a
/// normal that nothing can move (A = 0), of bodies without inverse weight, carries the load t/R,
/// and its friction holds a wheel with a fixed axle. MuJoCo's `mjMINVAL` does this for numbers near
/// 1. If nothing moves any row, `mass` replaces 1/A.
#[inline(always)]
pub fn least_softness<R: Real>(rows: &[Row<R>], mass: R) -> R {
    R::of(LEAST_SOFTNESS * R::epsilon()) * most_moved(rows, mass)
}

/// The same for the rows of a contact without inverse weight. Only this regulariser prevents
/// unbounded loads, whose rounding moves the pressed bodies by ε/R. R is ε^⅔ of A, so that both
/// that rounding and R itself are negligible.
pub fn weightless_softness<R: Real>(rows: &[Row<R>], mass: R) -> R {
    let share = if R::epsilon() < 1e-10 { WEIGHTLESS } else { WEIGHTLESS_F32 };
    R::of(share) * most_moved(rows, mass)
}

fn most_moved<R: Real>(rows: &[Row<R>], mass: R) -> R {
    let most = rows.iter().fold(R::zero(), |most, row| most.max(row.a));
    R::select(most.gt(R::zero()), most, R::one() / mass)
}

fn impedance(d: f64) -> f64 {
    d.clamp(IMPEDANCE[0], IMPEDANCE[1])
}

/// The form of d(r): constant, or along curves of power 1, 2 or another. Worlds in parallel lanes
/// have the same form.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum ImpedanceForm {
    Flat,
    Linear,
    Square,
    Power,
}

pub fn impedance_form<N: Constant>(solimp: &[N; 5]) -> ImpedanceForm {
    let [d0, dw, width, _, power] = from_fn(|k| solimp[k].lane(0));
    match power.max(1.0) {
        _ if impedance(d0) == impedance(dw) || width <= 0.0 => ImpedanceForm::Flat,
        1.0 => ImpedanceForm::Linear,
        2.0 => ImpedanceForm::Square,
        _ => ImpedanceForm::Power,
    }
}

/// d(0).
fn impedance_at_rest<R: Real>(solimp: &[R::Value; 5]) -> R {
    let [d0, dw, ..] = solimp;
    if impedance_form(solimp) == ImpedanceForm::Flat {
        return Value::calc([d0, dw], |[d0, dw]| 0.5 * (impedance(d0) + impedance(dw)));
    }
    Value::calc([d0], |[d0]| impedance(d0))
}

/// d(r): from d0 at r = 0 along two power curves to dw at |r| = width.
fn impedance_at<R: Real>(solimp: &[R::Value; 5], r: R) -> R {
    let [d0, dw, width, mid, power] = solimp;
    let form = impedance_form(solimp);
    if form == ImpedanceForm::Flat {
        return impedance_at_rest(solimp);
    }
    let one = R::one();
    let x = (r.abs() * R::Value::calc([width], |[width]| 1.0 / width)).min(one);
    let raise = |x: R| match form {
        ImpedanceForm::Linear => x,
        ImpedanceForm::Square => x * x,
        _ => x.powf(Value::calc([power], |[power]| power.max(1.0))),
    };
    let slope = |mid: f64, power: f64| match form {
        ImpedanceForm::Square => 1.0 / mid,
        _ => 1.0 / elementary::pow(mid, power.max(1.0) - 1.0),
    };
    let slope_below = Value::calc([mid, power], |[mid, power]| slope(impedance(mid), power));
    let slope_above =
        R::Value::calc([mid, power], |[mid, power]| slope(1.0 - impedance(mid), power));
    let below: R = raise(x) * slope_below;
    let above = one - raise(one - x) * slope_above;
    let y = R::select(x.le(Value::calc([mid], |[mid]| impedance(mid))), below, above);
    let rise: R = Value::calc([d0, dw], |[d0, dw]| impedance(dw) - impedance(d0));
    R::Value::calc([d0], |[d0]| impedance(d0)) + y * rise
}

/// The proximity of a row of an inequality, under the laws on velocities.
pub struct Near<R: Real> {
    /// The distance that the row keeps.
    pub phi: R,
    /// Whether the guess overlaps.
    pub closing: R::Mask,
    /// The velocity that the guess adds to the row's velocity at the start.
    pub gained: R,
    /// Whether a contact that is reached in this step lasts into the next, instead of being passed.
    pub arrives: R::Mask,
    /// Whether the distance exceeds the size of the shapes.
    pub far: R::Mask,
}

/// The laws on velocities: how a row that keeps a distance is filled in.
#[derive(Clone, Copy)]
pub struct OnGuess {
    pub law: Law,
    pub dt: f64,
    pub beta: f64,
    pub softness: f64,
    pub slop: f64,
    /// See `Situation::halves`: these rows have half of the impulse that softness refers to.
    pub halves: bool,
}

impl OnGuess {
    pub fn new<R: Real>(now: &Situation<R>) -> Self {
        let Settings { law, dt, beta, softness, slop, .. } = *now.settings;
        let halves = now.halves();
        let softness = if halves { 2.0 * softness } else { softness };
        Self { law, dt, beta, softness, slop, halves }
    }

    /// An inequality: distance φ ≥ 0, recovered at the speed `push`. Limits do not bounce: their
    /// restitution is 0.
    ///
    /// A row that is only near requires what the guess does anyway: no overlap at the end of the
    /// step. Its impulse is zero unless other rows press on it.
    pub fn distance<R: Real>(&self, row: &mut Row<R>, near: &Near<R>, restitution: f64, push: R) {
        let (zero, inv_dt) = (R::zero(), R::of(1.0 / self.dt));
        let phi = near.phi;
        row.gap = phi;
        let (arrive, open) = (-(phi * inv_dt), phi.gt(zero));
        let closing = if self.law == Law::Rigid {
            let bounce = R::of(-restitution) * row.velocity;
            // An impact is at the start of the step, before the smooth motion.
            let back = push.max(if self.halves { bounce + near.gained } else { bounce });
            let wait = open.and(near.arrives).and(R::Mask::of(restitution == 0.0));
            R::select(wait, arrive, back)
        } else {
            let far = near.closing.and(near.far).and(near.arrives);
            if far.any() {
                R::select(far, arrive, push)
            } else {
                push
            }
        };
        row.t = R::select(near.closing, closing, R::select(open, arrive, push));
        self.soften(row);
    }

    /// Returns the speed at which an overlap is to be removed, without a limit.
    pub fn push<R: Real>(&self, phi: R) -> R {
        let push = R::of(-self.beta) * R::of(1.0 / self.dt);
        let phi = if self.law == Law::Rigid { phi + R::of(self.slop) } else { phi };
        push * phi.min(R::zero())
    }

    /// An equality: φ = 0.
    pub fn equality<R: Real>(&self, row: &mut Row<R>, phi: R) {
        row.gap = phi;
        row.t = R::of(-self.beta / self.dt) * phi;
        self.soften(row);
    }

    /// A distance that nothing can open (A = 0) in a block whose other rows move: its load is t
    /// over the least regulariser, so that it has friction.
    pub fn unmoved<R: Real>(&self, row: &mut Row<R>, least: R) {
        let least = if self.halves { least + least } else { least };
        let still = row.a.le(R::zero()).and(row.c.le(least));
        row.c = R::select(still, least, row.c);
        let inv_s = (least + R::of(self.denominator())).recip_or_zero();
        row.inv_s = R::select(still, inv_s, row.inv_s);
    }

    /// A friction row: no slip, exactly.
    pub fn friction<R: Real>(&self, row: &mut Row<R>) {
        row.t = R::zero();
        row.c = R::zero();
        row.inv_s = row.a.recip_or_zero();
    }

    /// The term that softness adds to the denominator of an update.
    fn denominator(&self) -> f64 {
        match self.law {
            Law::Rigid => 0.0,
            _ => self.softness,
        }
    }

    /// c of a row that keeps a distance.
    pub fn regulariser<R: Real>(&self) -> R {
        R::of(if self.law == Law::Lesson { self.softness } else { 0.0 })
    }

    fn soften<R: Real>(&self, row: &mut Row<R>) {
        let soft = self.denominator();
        row.c = self.regulariser();
        row.inv_s = (row.a + R::of(soft)).recip_or_zero();
    }
}
