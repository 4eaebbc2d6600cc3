//! The step of joint springs, dampers and servos alone, as a matrix: is it stable, up to which dt,
//! and how far does a healthy run swing?
//!
//! With M, K and D of one tree, or of trees that elements couple, at the present state, F = [0 1;
//! −M⁻¹K −M⁻¹D] and each integrator's map A(dt), measured in the energy norm ½ vᵀMv + ½ xᵀKx. A
//! symplectic method conserves another energy: this one may swing by (1 + z/2)/(1 − z/2), z = ω dt,
//! in a healthy run. ‖Aⁿ‖ for n = 1, 2, 4, … distinguishes that from growth.

use nalgebra::linalg::{Schur, SymmetricEigen};
use nalgebra::DMatrix;

use super::budget::Budget;
use crate::elements::force::Group;
use crate::elements::forces::{damping, slopes};
use crate::integrator::linear_map::Linear;
use crate::integrator::{Integrator, Map};
use crate::model::{Model, Union};
use crate::real::Real;
use crate::sim::{At, Sim};

/// Squarings of a map: 2¹⁸ steps.
const SQUARINGS: u32 = 18;
/// A spectral radius is above 1 beyond what 2¹⁸ steps of bounded or linear growth can show.
const GROWS: f64 = 1e-4;
/// The most dofs of a tree that is examined.
const MOST_DOFS: usize = 48;
/// The most halvings from an unstable dt to a stable one.
const HALVINGS: u32 = 40;
/// QR iterations for the eigenvalues of a map, by row: twice the most that any converged one took.
const ITERATIONS: usize = 60;

/// Mass, stiffness and damping of one tree, or of trees that elements couple.
struct Oscillator {
    mass: DMatrix<f64>,
    stiffness: DMatrix<f64>,
    damping: DMatrix<f64>,
    /// The part of the damping that the integrator takes at the end of the step.
    late: DMatrix<f64>,
}

/// Entries of the slopes of all elements: two dofs, and a stiffness or a damping.
type Entries = Vec<(usize, usize, f64)>;

/// The slopes of all elements; `late`: the damping that the integrator takes at a step's end.
#[derive(Default)]
struct Slopes {
    stiffness: Entries,
    damping: Entries,
    late: Entries,
}

impl<R: Real> Sim<R> {
    /// The ratio of the largest energy of a healthy run of these springs to the present energy; 1
    /// if the springs themselves diverge, or do not swing.
    pub(super) fn swing(&mut self, lane: usize, dt: f64, budget: &Budget) -> f64 {
        let integrator = self.settings.integrator;
        if integrator.scheme().map == Map::Taylor(1) {
            return 1.0;
        }
        let all = self.oscillators(lane, integrator);
        let known = all.iter().filter_map(|one| one.growth(integrator, dt, budget));
        let swings = known.map(|[radius, most]| {
            if radius > GROWS {
                1.0
            } else {
                // The powers in between may swing further.
                4.0 * most
            }
        });
        swings.fold(1.0, f64::max)
    }

    /// The largest stable dt of springs and dampers that are unstable now: None if none is, or it
    /// is unknown; zero if no dt is stable.
    pub(super) fn spring_limit(
        &mut self,
        lane: usize,
        integrator: Integrator,
        budget: &Budget,
    ) -> Option<f64> {
        let dt = self.clock.seconds;
        let limits = self.oscillators(lane, integrator).into_iter().filter_map(|one| {
            if integrator.scheme().map == Map::Taylor(1) {
                return one.explicit_limit(budget).filter(|limit| *limit <= dt);
            }
            one.limit(integrator, dt, budget)
        });
        limits.reduce(f64::min)
    }

    /// Every tree with a spring or a damper, at the present state.
    fn oscillators(&mut self, lane: usize, integrator: Integrator) -> Vec<Oscillator> {
        self.refresh();
        let slopes = Slopes::of(self, lane, integrator);
        let groups = slopes.groups(self.model_of(lane)).into_iter();
        groups
            .filter(|dofs| dofs.len() <= MOST_DOFS)
            .map(|dofs| slopes.oscillator(self, lane, &dofs))
            .collect()
    }
}

impl Slopes {
    /// The slopes of all elements at the present state.
    fn of<R: Real>(sim: &Sim<R>, lane: usize, integrator: Integrator) -> Self {
        let (model, now) = (&sim.model, sim.moment(At::State));
        let mut all = Self::default();
        let note = |list: &mut Entries, i: usize, j: usize, slope: R| {
            let slope = slope.lane(lane);
            if slope != 0.0 {
                list.push((i, j, slope));
            }
        };
        for group in [Group::Passive, Group::Driven] {
            slopes(&now, group, &mut |_, i, j, [stiffness, damping]| {
                note(&mut all.stiffness, i, j, stiffness);
                note(&mut all.damping, i, j, damping);
            });
        }
        let scheme = integrator.scheme();
        match scheme.late(model.features.eulerdamp) {
            _ if scheme.stiffness => all.late.clone_from(&all.damping),
            Some(late) => damping(&now, late, |i, j, damping| {
                if model.entry(i, j).is_some() {
                    note(&mut all.late, i, j, damping);
                }
            }),
            None => {}
        }
        all
    }

    /// The dofs of every tree that swings or is damped; trees coupled by an element are one group.
    fn groups(&self, model: &Model) -> Vec<Vec<usize>> {
        let pulls = self.stiffness.iter().filter(|(i, j, k)| i != j || *k > 0.0);
        let mut swings = vec![false; model.trees.len()];
        let mut coupled = Union::new(model.trees.len());
        for (i, j, _) in pulls.chain(&self.damping) {
            let [i, j] = [i, j].map(|dof| model.dofs[*dof].tree);
            swings[i] = true;
            coupled.join(i, j);
        }
        let mut groups = vec![Vec::new(); model.trees.len()];
        for (tree, _) in swings.iter().enumerate().filter(|(_, swings)| **swings) {
            groups[coupled.of(tree)].extend(model.trees[tree].dofs.range());
        }
        groups.retain(|group| !group.is_empty());
        groups
    }

    fn oscillator<R: Real>(&self, sim: &Sim<R>, lane: usize, dofs: &[usize]) -> Oscillator {
        let model = &sim.model;
        let place = |dof: usize| dofs.binary_search(&dof).ok();
        let zeros = || DMatrix::zeros(dofs.len(), dofs.len());
        let mut mass = zeros();
        for (i, k) in dofs.iter().enumerate() {
            for at in model.dofs[*k].row.range() {
                if let Some(j) = place(model.row_dofs[at]) {
                    let entry = sim.placed.mass[at].lane(lane);
                    (mass[(i, j)], mass[(j, i)]) = (entry, entry);
                }
            }
        }
        let matrix = |entries: &Entries| {
            let mut matrix = zeros();
            for (i, j, slope) in entries {
                if let (Some(i), Some(j)) = (place(*i), place(*j)) {
                    matrix[(i, j)] += slope;
                }
            }
            matrix
        };
        Oscillator {
            mass,
            stiffness: matrix(&self.stiffness),
            damping: matrix(&self.damping),
            late: matrix(&self.late),
        }
    }
}

impl Oscillator {
    /// |1 + dt s| < 1 for every eigenvalue s of F: dt < −2 Re s / |s|². None if they are unknown.
    fn explicit_limit(&self, budget: &Budget) -> Option<f64> {
        let n = self.mass.nrows();
        // One step of dt = 1 of the explicit map is 1 + F.
        let map = self.map(Integrator::Explicit, 1.0, budget)?;
        let rate = map - DMatrix::identity(2 * n, 2 * n);
        // A mode that neither swings nor decays is at rest, and has no limit.
        let limit = |s: &nalgebra::Complex<f64>| {
            let (size, damped) = (s.norm(), -s.re);
            (size > 1e-9).then_some(if damped < 1e-9 * size {
                0.0
            } else {
                2.0 * damped / size / size
            })
        };
        let schur = Schur::try_new(rate, f64::EPSILON, ITERATIONS * 2 * n)?;
        let limits = schur.complex_eigenvalues();
        limits.iter().filter_map(limit).filter(|limit| limit.is_finite()).reduce(f64::min)
    }

    /// The largest stable dt, to 1e-4, if `dt` is unstable; None if it is stable or unknown.
    fn limit(&self, integrator: Integrator, dt: f64, budget: &Budget) -> Option<f64> {
        let unstable =
            |dt: f64| self.growth(integrator, dt, budget).map(|[radius, _]| radius > GROWS);
        if !unstable(dt)? {
            return None;
        }
        let mut high = dt;
        let mut halvings = 0;
        while unstable(0.5 * high)? {
            (high, halvings) = (0.5 * high, halvings + 1);
            if halvings == HALVINGS {
                return None;
            }
        }
        let mut low = 0.5 * high;
        while high - low > 1e-4 * low {
            let middle = 0.5 * (low + high);
            if unstable(middle)? {
                high = middle;
            } else {
                low = middle;
            }
        }
        Some(low)
    }

    /// `growth` of the step; None if it is unknown.
    fn growth(&self, integrator: Integrator, dt: f64, budget: &Budget) -> Option<[f64; 2]> {
        let map = self.map(integrator, dt, budget)?;
        budget.product(map.nrows(), SQUARINGS).then(|| growth(map))
    }

    /// The step in coordinates (√K x, Lᵀ v), M = L Lᵀ, whose square is twice the energy. None if M
    /// has no such factor in this precision, or an entry is not finite.
    fn map(&self, integrator: Integrator, dt: f64, budget: &Budget) -> Option<DMatrix<f64>> {
        let map = budget.product(2 * self.mass.nrows(), 8).then(|| self.step_map(integrator, dt));
        map.flatten().filter(|map| map.iter().all(|x| x.is_finite()))
    }

    fn step_map(&self, integrator: Integrator, dt: f64) -> Option<DMatrix<f64>> {
        let n = self.mass.nrows();
        let root = root(&self.stiffness)?;
        let inverse = self.mass.clone().cholesky()?.l().try_inverse()?;
        // ẏ = S w, ẇ = −Sᵀ y − C w with y = √K x, w = Lᵀ v.
        let s = &root * inverse.transpose();
        let in_w = |damping: &DMatrix<f64>| &inverse * damping * inverse.transpose();
        let mut rates = DMatrix::zeros(2 * n, 2 * n);
        rates.view_mut((0, n), (n, n)).copy_from(&s);
        rates.view_mut((n, 0), (n, n)).copy_from(&-s.transpose());
        rates.view_mut((n, n), (n, n)).copy_from(&-in_w(&self.damping));
        let motion = Linear {
            rates: &rates,
            mass: &DMatrix::identity(n, n),
            damping: &in_w(&self.late),
            stiffness: &(s.transpose() * &s),
        };
        motion.step(integrator, dt, &DMatrix::identity(2 * n, 2 * n))
    }
}

/// A matrix G with GᵀG = K, for the stiffness that pulls back.
fn root(stiffness: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = stiffness.nrows();
    let diagonal = stiffness.diagonal();
    if *stiffness == DMatrix::from_diagonal(&diagonal) {
        return Some(DMatrix::from_diagonal(&diagonal.map(|k| k.max(0.0).sqrt())));
    }
    let symmetric = (stiffness + stiffness.transpose()) * 0.5;
    let eigen = SymmetricEigen::try_new(symmetric, f64::EPSILON, ITERATIONS * n)?;
    let sizes = DMatrix::from_diagonal(&eigen.eigenvalues.map(|k| k.max(0.0).sqrt()));
    Some(sizes * eigen.eigenvectors.transpose())
}

/// ln of the spectral radius, and the largest growth of the energy on the way.
fn growth(mut map: DMatrix<f64>) -> [f64; 2] {
    let (mut log, mut most) = (0.0_f64, 1.0_f64);
    let mut steps = 1.0;
    for _ in 0..SQUARINGS {
        let norm = norm(&map);
        if !norm.is_finite() || norm == 0.0 {
            return [if norm == 0.0 { 0.0 } else { f64::INFINITY }, most];
        }
        log += norm.ln();
        if 2.0 * log < 600.0 {
            most = most.max((2.0 * log).exp());
        }
        map /= norm;
        map = &map * &map;
        log *= 2.0;
        steps *= 2.0;
    }
    [(log + norm(&map).ln()) / steps, most]
}

/// The 2-norm, by power iteration on AᵀA.
fn norm(a: &DMatrix<f64>) -> f64 {
    let n = a.ncols();
    let mut x = nalgebra::DVector::from_fn(n, |i, _| 1.0 + 0.37 * i as f64);
    let mut size = 0.0;
    for _ in 0..20 {
        let length = x.norm();
        if length == 0.0 || !length.is_finite() {
            return length;
        }
        x /= length;
        let y = a * &x;
        size = y.norm();
        x = a.transpose() * y;
    }
    size
}
