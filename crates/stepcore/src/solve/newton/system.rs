//! The data of one island in Newton's method, and the laws of its rows.

use super::bundles::{Bundles, Problem, Run};
use super::columns::Columns;
use super::hessian::Hessian;
use super::penalty::{interval, Line};
use crate::real::{Mask, Real};
use crate::solve::rows::{CONE, NARROW, PLANAR, SPINNING};

/// The data of one island. "Per row" counts its rows one after another; "per dof" is local, as in
/// `Pattern::dofs`.
pub(super) struct System<R: Real> {
    /// Per row: w = y·u − t; the rate of w along the step (during refinement, the error of the
    /// impulses); the impulse.
    pub(super) w: Vec<R>,
    pub(super) rate: Vec<R>,
    pub(super) impulse: Vec<R>,
    /// Curvature s″, run by run: see `Run::curve`.
    pub(super) curve: Vec<R>,
    /// Per run: whether its curvature may have changed since the matrix was computed.
    pub(super) changed: Vec<bool>,
    /// Per cone: its penalty along the step.
    pub(super) lines: Vec<Line<R>>,
    /// Per dof.
    pub(super) guess: Vec<R>,
    pub(super) u: Vec<R>,
    /// Lanes with a row on the dof.
    touched: Vec<R::Mask>,
    pub(super) d: Vec<R>,
    pub(super) inv_d: Vec<R>,
    pub(super) gradient: Vec<R>,
    pub(super) step: Vec<R>,
    pub(super) hessian: Hessian<R>,
    /// The same for a pile.
    pub(super) columns: Columns<R>,
    /// Lanes whose factors belong to the current curvature.
    pub(super) fresh: R::Mask,
    /// Newton's decrement relative to `floor`, the energy of the motion along the rows.
    pub(super) decrement: R,
    pub(super) floor: R,
    /// The part of `floor` due to the rows' velocities at the start.
    pub(super) scale: R,
    /// Whether u has moved since the impulses were computed, in some lane.
    pub(super) moved: bool,
    /// Scratch of products: a vector at the dofs of one bundle.
    pub(super) local: Vec<R>,
}

room!(System<R>: w, rate, impulse, curve, changed, lines, guess, u, touched, d, inv_d, gradient, step, hessian, columns,
    fresh, decrement, floor, scale, moved, local);

impl<R: Real> System<R> {
    pub fn new() -> Self {
        Self {
            w: Vec::new(),
            rate: Vec::new(),
            impulse: Vec::new(),
            curve: Vec::new(),
            changed: Vec::new(),
            lines: Vec::new(),
            guess: Vec::new(),
            u: Vec::new(),
            touched: Vec::new(),
            d: Vec::new(),
            inv_d: Vec::new(),
            gradient: Vec::new(),
            step: Vec::new(),
            hessian: Hessian::new(),
            columns: Columns::new(),
            fresh: R::Mask::of(false),
            decrement: R::zero(),
            floor: R::zero(),
            scale: R::zero(),
            moved: false,
            local: Vec::new(),
        }
    }

    /// Loads an island, and starts at the velocities u or at û: at the end to which the cost falls
    /// half-way between them. The minimum along the line would not do: unconnected parts of an
    /// island would change each other's bits. If the start is u, laws and slope are computed:
    /// return the result of `slope`.
    pub fn start(
        &mut self,
        problem: Problem<R>,
        (inv_d, guess, u): (&[R], &[R], &[R]),
        todo: R::Mask,
    ) -> Option<(R, R)> {
        self.make_room(problem, (inv_d, guess, u));
        if !R::ALONE {
            self.leave_untouched(problem);
        }
        self.find_slacks(problem);
        self.weigh(problem);
        if self.u == self.guess {
            return None;
        }
        self.laws(problem.bundles, todo);
        let begun = self.slope(problem);
        let mut fall = R::zero();
        for (k, step) in self.step.iter_mut().enumerate() {
            *step = self.guess[k] - self.u[k];
            fall -= self.gradient[k] * *step;
        }
        let down = todo.and(fall.gt(R::zero()));
        if down.none() {
            return Some(begun);
        }
        slacks(problem, &self.guess, &mut self.rate, &mut self.local);
        for (rate, w) in self.rate.iter_mut().zip(&self.w) {
            *rate -= *w;
        }
        self.line_up(problem.bundles);
        let half = R::of(0.5);
        let (first, second) = self.energy_along();
        let slope = first + half * second + self.bend_at(problem.bundles, half).0;
        let falls_on = down.and(slope.lt(R::zero()));
        if falls_on.none() {
            return Some(begun);
        }
        self.advance(R::one(), falls_on);
        None
    }

    /// Start at û where a lane has no row on a dof: alone it would not have the dof in its system.
    fn leave_untouched(&mut self, problem: Problem<R>) {
        let Problem { pattern, rows, blocks, .. } = problem;
        self.touched.clear();
        self.touched.resize(self.u.len(), R::Mask::of(false));
        let of_block = |b: &usize| {
            let block = &rows.blocks[*b];
            rows.rows[block.rows.range()].iter().map(|row| (row.dofs.len, block.mask))
        };
        let mut every = blocks.iter().flat_map(of_block);
        for (b, bundle) in problem.bundles.list.iter().enumerate() {
            for (len, mask) in every.by_ref().take(bundle.rows.len) {
                for k in &pattern.list(b)[..len] {
                    self.touched[*k] = self.touched[*k].or(mask);
                }
            }
        }
        for ((u, guess), touched) in self.u.iter_mut().zip(&self.guess).zip(&self.touched) {
            *u = R::select(*touched, *u, *guess);
        }
    }

    /// Resize the lists for an island.
    fn make_room(&mut self, problem: Problem<R>, (inv_d, guess, u): (&[R], &[R], &[R])) {
        let dofs = problem.pattern.dofs();
        let take = |out: &mut Vec<R>, from: &[R]| {
            out.clear();
            out.extend(dofs.iter().map(|k| from[*k]));
        };
        take(&mut self.guess, guess);
        take(&mut self.u, u);
        take(&mut self.inv_d, inv_d);
        self.d.clear();
        self.d.extend(self.inv_d.iter().map(|inv| R::one() / *inv));
        let fill = |list: &mut Vec<R>, len: usize| {
            list.clear();
            list.resize(len, R::zero());
        };
        for list in [&mut self.w, &mut self.rate, &mut self.impulse] {
            fill(list, problem.bundles.t.len());
        }
        fill(&mut self.curve, problem.bundles.curves);
        self.changed.clear();
        self.changed.resize(problem.bundles.runs.len(), false);
        for list in [&mut self.gradient, &mut self.step] {
            fill(list, dofs.len());
        }
        if R::ALONE && problem.pattern.heap {
            self.columns.start(&problem.pattern.nodes);
        } else {
            self.hessian.start(problem.pattern, &self.d, problem.bundles.curves);
        }
    }

    /// Set w = y·u − t by row.
    pub(super) fn find_slacks(&mut self, problem: Problem<R>) {
        slacks(problem, &self.u, &mut self.w, &mut self.local);
    }

    /// Sets every row's impulse at its w; in lanes of `bend` also the curvature. Returns the lanes in
    /// which some curvature changed.
    pub(super) fn laws(&mut self, bundles: &Bundles<R>, bend: R::Mask) -> R::Mask {
        let mut changed = R::Mask::of(false);
        for (at, run) in bundles.runs.iter().enumerate() {
            let new = match (run.cone, run.rows.len) {
                (None, _) => self.intervals(bundles, run, bend),
                (Some(cone), ..=PLANAR) => self.bend_cone::<PLANAR>(bundles, run, cone, bend),
                (Some(cone), ..=NARROW) => self.bend_cone::<NARROW>(bundles, run, cone, bend),
                (Some(cone), ..=SPINNING) => self.bend_cone::<SPINNING>(bundles, run, cone, bend),
                (Some(cone), _) => self.bend_cone::<CONE>(bundles, run, cone, bend),
            };
            self.changed[at] |= new.any();
            changed = changed.or(new);
        }
        changed
    }

    #[inline(always)]
    fn intervals(&mut self, bundles: &Bundles<R>, run: &Run, bend: R::Mask) -> R::Mask {
        let (own, len) = (run.rows.range(), run.rows.len);
        let (lo, hi) = (&bundles.lo[own.clone()][..len], &bundles.hi[own.clone()][..len]);
        let (inv_c, mask) = (&bundles.inv_c[own.clone()][..len], &bundles.mask[own.clone()][..len]);
        let (w, impulses) = (&self.w[own.clone()][..len], &mut self.impulse[own][..len]);
        let curves = &mut self.curve[run.curve.range()][..len];
        let mut changed = R::Mask::of(false);
        for i in 0..len {
            let (impulse, curve) = interval([lo[i], hi[i]], inv_c[i], w[i]);
            let old = curves[i];
            // At a bound the impulse is constant: if it changed, it is at the other bound.
            let jump = impulse - impulses[i];
            let slides = curve.gt(R::zero()).or(jump.abs().le(R::zero()));
            let same = curve.le(old).and(curve.ge(old)).and(slides);
            impulses[i] = impulse;
            let bend = if R::ALONE || run.whole { bend } else { bend.and(mask[i]) };
            changed = changed.or(bend.and(same.not()));
            curves[i] = R::select(bend, curve, old);
        }
        changed
    }

    /// The same for a cone.
    fn bend_cone<const N: usize>(
        &mut self,
        bundles: &Bundles<R>,
        run: &Run,
        cone: usize,
        bend: R::Mask,
    ) -> R::Mask {
        let (own, len) = (run.rows.range(), run.rows.len);
        let (impulse, curve) = bundles.cones[cone].law::<N>(padded(&self.w[own.clone()]));
        self.impulse[own].copy_from_slice(&impulse[..len]);
        let bend = bend.and(bundles.mask[run.rows.start]);
        if bend.none() {
            return bend;
        }
        let curves = &mut self.curve[run.curve.range()];
        if len == N {
            return replace(&mut curves[..N * N], curve.as_flattened(), bend);
        }
        let rows = curves.chunks_exact_mut(len).zip(&curve);
        rows.fold(R::Mask::of(false), |changed, (old, new)| changed.or(replace(old, new, bend)))
    }

    /// Computes the energy of the rows' velocities, the scale for rounding.
    fn weigh(&mut self, problem: Problem<R>) {
        self.scale = R::zero();
        for (w, (row, block)) in self.w.iter().zip(problem.every()) {
            let velocity = *w + row.t;
            let energy = self.scale + (velocity * velocity + row.t * row.t) * row.inv_s;
            self.scale = R::select(block.mask, energy, self.scale);
        }
    }
}

/// out = y·u − t by row.
fn slacks<R: Real>(problem: Problem<R>, u: &[R], out: &mut [R], own: &mut Vec<R>) {
    problem.dots(u, out, own);
    for (w, t) in out.iter_mut().zip(&problem.bundles.t) {
        *w -= *t;
    }
}

/// old ← new in the lanes of `mask`; returns its lanes in which they differ.
#[inline(always)]
fn replace<R: Real>(old: &mut [R], new: &[R], mask: R::Mask) -> R::Mask {
    let mut changed = R::Mask::of(false);
    for (old, new) in old.iter().zip(new) {
        changed = changed.or(new.le(*old).and(new.ge(*old)).not());
    }
    for (old, new) in old.iter_mut().zip(new) {
        *old = R::select(mask, *new, *old);
    }
    changed.and(mask)
}

/// Returns a cone's numbers, 0 for missing rows.
pub(super) fn padded<R: Real, const N: usize>(x: &[R]) -> [R; N] {
    assert!(x.len() <= N);
    crate::real::array::from_fn(|i| x.get(i).copied().unwrap_or_else(R::zero))
}
