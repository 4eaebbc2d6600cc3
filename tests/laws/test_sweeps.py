"""How fast sweeps converge: closed forms, and the matrix of the rows.

Once the active rows no longer change, a sweep of projected Gauss-Seidel is linear: with
K = J M⁻¹ Jᵀ + c, its diagonal D and L below it, it turns an error e into (I − (D + L)⁻¹ K) e. The
spectral radius of that matrix is the share of the error that a sweep leaves in the end.
"""

import math

import numpy as np
import pytest
from covering import every_pair

import stepcore as sc
from stepcore import lesson
from stepcore.engine.run_settings import converged_settings


def tower(masses, **settings):
    """A tower whose balls move into each other."""
    chosen = {"law": "rigid", "solver": "pgs", "sweeps": 10, "tolerance": 0.0} | settings
    sim = sc.Sim(sc.Model(lesson.tower(masses), **chosen))
    sim.qpos[:] = -1e-5 * np.arange(1, len(masses) + 1)
    sim.qvel[:] = -0.01 * np.arange(1, len(masses) + 1)
    return sim


# Numbers of sweeps after which the distance to the solution is read.
SWEEPS = tuple(2**k for k in range(13))
# Distances are read down to this share of the largest: far above rounding, which PGS keeps.
READABLE = 1e-9


def measured(sim):
    """Sweeps for a factor of ten, by the distance to the solution after ever more of them."""
    model, state, settings = sim.model, sim.state(), sim.settings

    def at(settings):
        solved = sc.Sim(model, settings)
        solved.restore(state)
        solved.forward()
        return np.array(solved.qacc)

    target = at(converged_settings(settings, tolerance=0.0 if settings.law == "solref" else 1e-14))
    plain = {"tolerance": 0.0, "cost_tolerance": 0.0, "warm_start": False, "precision": "f64"}
    plain |= {"solver": "pgs", "acceleration": "none"}
    mass, left = sim.mass_matrix(), []
    for count in (0, *SWEEPS):
        change = at(settings.replace(**plain, sweeps=count)) - target
        left.append(math.sqrt(max(change @ mass @ change, 0.0)))
    last = max(k for k, size in enumerate(left) if size >= READABLE * max(left))
    counts = (0, *SWEEPS)
    return decimals((left[last] / left[last - 1]) ** (1 / (counts[last] - counts[last - 1])))


def decimals(rate):
    """Sweeps for a factor of ten."""
    return math.log(10) / -math.log(rate)


@pytest.mark.parametrize(
    ("masses", "law"),
    [
        ((1.0, 0.1), 0.1 / 1.1),
        ((1.0, 1.0), 0.5),
        ((1.0, 10.0), 10 / 11),
        ((1.0, 1000.0), 1000 / 1001),
        ((1.0,) * 3, 0.75),
        ((1.0,) * 10, math.cos(math.pi / 20) ** 2),
        ((1.0,) * 20, math.cos(math.pi / 40) ** 2),
    ],
)
def test_c6_a_tower_contracts_by_its_closed_form(masses, law):
    """Two balls m_top/(m_top + m_bottom), N equal ones cos²(π/2N): to 1 % in sweeps a decimal."""
    assert measured(tower(masses)) == pytest.approx(decimals(law), rel=0.01)


@every_pair(masses=[(1.0, 3.0, 20.0), (1.0, 100.0), (5.0, 1.0, 1.0, 8.0)], law=["lesson", "solref"])
def test_soft_rows_contract_by_the_matrix_of_their_rows(law, masses):
    """The regulariser adds to the diagonal and to nothing else."""
    sim = tower(masses, law=law, softness=0.3)
    sim.forward()
    # Rows are swept in order; the radius of another order would differ.
    K = sim.delassus() + np.diag(sim.rows["regulariser"])
    left = np.eye(len(K)) - np.linalg.solve(np.tril(K), K)
    radius = np.abs(np.linalg.eigvals(left)).max()
    assert measured(sim) == pytest.approx(decimals(radius), rel=0.01)


def test_the_matrix_of_the_rows():
    """J M⁻¹ Jᵀ: of a tower by hand; symmetric; and it maps impulses to velocities."""
    sim = tower((1.0, 4.0, 0.5))
    sim.forward()
    expected = [[1, -1, 0], [-1, 1.25, -0.25], [0, -0.25, 2.25]]
    assert sim.delassus() == pytest.approx(np.array(expected), abs=1e-15)
    grasp = sc.Sim(lesson.grasp())
    grasp.reset(key="start")
    grasp.step(20)
    A, rows = grasp.delassus(), grasp.rows
    assert np.allclose(A, A.T, atol=1e-12)
    # Jᵀλ in generalised coordinates has the same energy as A has it.
    force = np.array(grasp.constraint_force) * grasp.settings.dt
    energy = force @ np.linalg.solve(grasp.mass_matrix(), force)
    assert rows["impulse"] @ A @ rows["impulse"] == pytest.approx(energy, rel=1e-9)


def speeds(sim):
    """The residuals of the last solve's rows as speeds [m/s]: s·|δ| by √(A/m) over s."""
    rows = sim.rows
    coupling, about = sim._core.coupling()
    diagonal, unit = np.diagonal(coupling), about[:, 4]
    denominator = diagonal + rows["regulariser"] * unit**2
    for block in np.unique(rows["block"][about[:, 3] > 0]):
        at = rows["block"] == block
        denominator[at] = denominator[at].max()
    return rows["residual"] * unit / denominator * np.sqrt(diagonal / about[:, 1])


@every_pair(cone=["elliptic", "pyramidal"], sweeps=[1, 3])
def test_row_speeds_are_what_the_residual_is_made_of(cone, sweeps):
    sim = sc.Sim(lesson.grasp(), cone=cone, sweeps=sweeps, tolerance=0.0, warm_start=False)
    sim.reset(key="start")
    sim.step(3)
    assert speeds(sim).max() == pytest.approx(sim.residual, rel=1e-12)
    assert sim.residual > 1e-6
