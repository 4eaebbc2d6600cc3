"""Two engines on one model: stepcore and MuJoCo at its most accurate, at the same states."""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np

import stepcore as sc
from stepcore.loading import find_asset

GYM = (
    "inverted_pendulum",
    "inverted_double_pendulum",
    "reacher",
    "hopper",
    "walker2d",
    "half_cheetah",
    "ant",
    "humanoid",
    "humanoidstandup",
)
# What both engines have, by our name.
INTEGRATORS = {
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "rk4": mujoco.mjtIntegrator.mjINT_RK4,
}
CONES = {
    "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL,
    "elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC,
}

# Newton until it cannot improve.
EXACT = {"solver": "newton", "sweeps": 200, "tolerance": 0.0}


def gym_path(name: str) -> str:
    """The MJCF file of a gymnasium model."""
    return str(find_asset("gymnasium", name))


def strict(model: mujoco.MjModel, **options) -> mujoco.MjModel:
    """Sets MuJoCo to its most accurate; `integrator`, `cone`, `impratio` by our names."""
    model.opt.solver = mujoco.mjtSolver.mjSOL_NEWTON
    model.opt.tolerance, model.opt.iterations = 0.0, 200
    model.opt.ls_tolerance, model.opt.ls_iterations = 1e-6, 100
    model.opt.ccd_tolerance, model.opt.ccd_iterations = 1e-12, 500
    # One problem, not one per island: the line search then sees the whole cost.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    if "integrator" in options:
        model.opt.integrator = INTEGRATORS[options["integrator"]]
    if "cone" in options:
        model.opt.cone = CONES[options["cone"]]
    model.opt.impratio = options.get("impratio", model.opt.impratio)
    return model


def shipped_integrator(model: mujoco.MjModel) -> str:
    """Our name of the integrator that the model's file asks for."""
    return next(name for name, value in INTEGRATORS.items() if value == model.opt.integrator)


@dataclass
class State:
    """What both engines are set to."""

    qpos: np.ndarray
    qvel: np.ndarray
    ctrl: np.ndarray
    qfrc_applied: np.ndarray
    xfrc_applied: np.ndarray
    act: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def to_mujoco(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Sets a cleared `data` to this state: no warm start from another one."""
        mujoco.mj_resetData(model, data)
        for name, value in vars(self).items():
            getattr(data, name)[:] = value

    def to_stepcore(self, sim: sc.Sim) -> None:
        sim.ctrl_history[:] = 0
        for name, value in vars(self).items():
            getattr(sim, name)[:] = value


def nudge(model: mujoco.MjModel, qpos: np.ndarray, rng: np.random.Generator, size: float) -> None:
    """Moves `qpos` by a random tangent vector, quaternions staying on their sphere."""
    mujoco.mj_integratePos(model, qpos, size * rng.normal(size=model.nv), 1.0)


def random_ctrl(model: mujoco.MjModel, rng: np.random.Generator) -> np.ndarray:
    """Controls that fill their range and sometimes leave it; unlimited ones are normal."""
    ctrl = rng.normal(size=model.nu)
    limited = model.actuator_ctrllimited.astype(bool)
    low, high = model.actuator_ctrlrange[limited].T
    ctrl[limited] = low + (high - low) * rng.uniform(-0.1, 1.1, size=limited.sum())
    return ctrl


def fall_states(
    model: mujoco.MjModel, count: int, seed: int, spread: float = 0.2, speed: float = 1.0
) -> list[State]:
    """States on the way of random falls, where contacts and limits are active.

    Each is moved a little off MuJoCo's own trajectory, so that none sits on a
    tie (exactly at rest, exactly aligned). Every other one has applied forces.
    """
    rng = np.random.default_rng(seed)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    weight = 1.0 / np.maximum(model.dof_invweight0, 1e-9)
    states: list[State] = []
    while len(states) < count:
        mujoco.mj_resetData(model, data)
        nudge(model, data.qpos, rng, spread)
        data.qvel[:] = speed * rng.normal(size=model.nv)
        vigour = rng.uniform()  # from limp to thrashing
        for _ in range(8):
            data.ctrl[:] = vigour * random_ctrl(model, rng)
            mujoco.mj_step(model, data, nstep=round(rng.uniform(0.004, 0.2) / model.opt.timestep))
            if not np.abs(data.qvel).max() < 50.0:
                break
            qpos = data.qpos.copy()
            nudge(model, qpos, rng, 1e-3)
            pushed = len(states) % 2
            wrench = np.zeros((model.nbody, 6))
            wrench[1:, :3] = model.body_mass[1:, None] * rng.normal(size=(model.nbody - 1, 3))
            wrench[1:, 3:] = model.body_inertia[1:] * rng.normal(size=(model.nbody - 1, 3))
            states.append(
                State(
                    qpos,
                    data.qvel + 1e-2 * rng.normal(size=model.nv),
                    data.ctrl.copy(),
                    pushed * 3.0 * weight * rng.normal(size=model.nv),
                    pushed * 3.0 * wrench,
                    data.act.copy(),
                )
            )
    return states[:count]


def apart(ours: np.ndarray, theirs: np.ndarray, floor: float = 1e-6) -> float:
    """The largest difference, relative to the largest magnitude of `theirs` (at least `floor`)."""
    ours, theirs = np.asarray(ours, dtype=float), np.asarray(theirs, dtype=float)
    assert ours.shape == theirs.shape, f"shape {ours.shape}, MuJoCo has {theirs.shape}"
    if theirs.size == 0:
        return 0.0
    worst = np.abs(ours - theirs).max() / max(np.abs(theirs).max(), floor)
    return float(worst) if np.isfinite(worst) else np.inf


def kept_geoms(sim: sc.Sim, model: mujoco.MjModel) -> np.ndarray:
    """Which of MuJoCo's geoms stepcore has: meshes that only draw are left out there."""
    ours = np.bincount(sim.model.geom_body, minlength=model.nbody)
    theirs = np.bincount(model.geom_bodyid, minlength=model.nbody)
    draws = (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH) & (model.geom_contype == 0)
    draws &= (model.geom_conaffinity == 0) & (ours != theirs)[model.geom_bodyid]
    # One with a name may be there for a sensor.
    known = set(sim.model.geom_names) - {""}
    named = [model.geom(k).name in known for k in range(model.ngeom)]
    draws &= ~np.array(named, dtype=bool)
    return np.flatnonzero(~draws)


def same_turn(ours: np.ndarray, theirs: np.ndarray) -> float:
    """`apart` for unit quaternions, of which q and -q are the same rotation."""
    sign = np.where((np.asarray(ours) * theirs).sum(axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    return apart(sign * ours, theirs)


def mass_matrix(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full


def sensors_apart(sim: sc.Sim, model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """How far the sensors are apart, each relative to its largest number, at least 1.

    MuJoCo's that have no counterpart, because they are not computed here, are passed over.
    """
    worst, at = 0.0, 0
    ours = np.split(sim.sensordata, np.cumsum(sim.model.sensor_dim))[:-1]
    for kind, name, mine in zip(sim.model.sensor_type, sim.model.sensor_names, ours, strict=True):
        while (_sensor_word(model, at), model.sensor(at).name) != (kind, name):
            at += 1
        first = model.sensor_adr[at]
        theirs = data.sensordata[first : first + model.sensor_dim[at]]
        if kind in ("framequat", "ballquat") and mine @ theirs < 0:
            mine = -mine
        worst = max(worst, apart(mine, theirs, 1.0))
        at += 1
    return worst


def _sensor_word(model: mujoco.MjModel, index: int) -> str:
    """MJCF's word for the type of a sensor."""
    word = mujoco.mjtSensor(model.sensor_type[index]).name.removeprefix("mjSENS_").lower()
    renamed = {
        "jointactfrc": "jointactuatorfrc",
        "tendonactfrc": "tendonactuatorfrc",
        "geomdist": "distance",
        "geomnormal": "normal",
        "geomfromto": "fromto",
    }
    return renamed.get(word, word)


def contacts_apart(sim: sc.Sim, data: mujoco.MjData, geoms: np.ndarray | None = None) -> float:
    """How far dist, pos [m] and normal of the contacts are apart; infinite if pairs differ.

    geoms: MuJoCo's index of each of ours, if not the same.
    """
    index = np.arange(sim.model.ngeom) if geoms is None else geoms
    ours = [(int(index[c["geom1"]]), int(index[c["geom2"]]), c) for c in sim.contacts]
    worst = 0.0
    if len(ours) != data.ncon:
        return np.inf
    for theirs in data.contact[: data.ncon]:
        pair = tuple(int(g) for g in theirs.geom)
        # A pair may touch in two points: take the nearest that is left.
        left = [
            (float(np.abs(c["pos"] - theirs.pos).max()), i)
            for i, (a, b, c) in enumerate(ours)
            if (a, b) == pair
        ]
        if not left:
            return np.inf
        gap, index = min(left)
        _, _, mine = ours.pop(index)
        normal = np.abs(mine["normal"] - theirs.frame[:3]).max()
        worst = max(worst, gap, float(abs(mine["dist"] - theirs.dist)), float(normal))
    return worst


@dataclass
class Worst:
    """The largest difference seen per quantity, and at which state."""

    seen: dict[str, tuple[float, int]] = field(default_factory=dict)

    def note(self, name: str, value: float, index: int) -> None:
        if name not in self.seen or not value <= self.seen[name][0]:
            self.seen[name] = (value, index)

    def check(self, limits: dict[str, float], context: str = "") -> None:
        """Fails with every quantity that is over its limit."""
        bad = [
            f"{name}: {self.seen[name][0]:.2e} > {limit:.0e} at state {self.seen[name][1]}"
            for name, limit in limits.items()
            if name in self.seen and not self.seen[name][0] <= limit
        ]
        assert not bad, f"{context}: " + "; ".join(bad)
        assert self.seen.keys() <= limits.keys()


PLACED = dict.fromkeys(
    ("xpos", "xquat", "geom_xpos", "geom_xmat", "site_xpos", "mass", "bias", "passive", "actuator"),
    1e-10,
)
SOLVED = {"contacts": 1e-10, "constraint": 1e-9, "qacc": 1e-9, "sensordata": 1e-9}
STEPPED = {"qpos": 1e-9, "qvel": 1e-9, "act": 1e-9}


def owned_forces(sim: sc.Sim, model: mujoco.MjModel) -> np.ndarray:
    """The forces of MuJoCo's actuators: ours beyond those of one, further inputs, have none."""
    ends = np.cumsum(model.actuator_ctrlnum)
    outputs = zip(ends - model.actuator_ctrlnum, model.actuator_outnum, strict=True)
    ours: np.ndarray = sim.actuator_force
    return np.concatenate([ours[:0], *(ours[start : start + n] for start, n in outputs)])


def note_forward(
    worst: Worst, index: int, sim: sc.Sim, model: mujoco.MjModel, data: mujoco.MjData, state: State
) -> None:
    """Both engines' forward at `state`, and how far apart everything is."""
    state.to_mujoco(model, data)
    state.to_stepcore(sim)
    mujoco.mj_forward(model, data)
    sim.forward()
    theirs_mass, geoms = mass_matrix(model, data), kept_geoms(sim, model)
    # Forces below a hundredth of a typical one are rounding of a cancellation.
    force = 1e-2 * max(np.abs(theirs_mass).max(), np.abs(data.qfrc_smooth).max())
    note = {
        "xpos": apart(sim.xpos, data.xpos),
        "xquat": same_turn(sim.xquat, data.xquat),
        "geom_xpos": apart(sim.geom_xpos, data.geom_xpos[geoms]),
        "geom_xmat": apart(sim.geom_xmat, data.geom_xmat[geoms].reshape(-1, 3, 3)),
        "site_xpos": apart(sim.site_xpos, data.site_xpos),
        "mass": apart(sim.mass_matrix(), theirs_mass),
        "bias": apart(sim.bias, data.qfrc_bias, force),
        "passive": apart(sim.passive, data.qfrc_passive, force),
        "actuator": apart(owned_forces(sim, model), data.actuator_force),
        "contacts": contacts_apart(sim, data, geoms),
        "constraint": apart(sim.constraint_force, data.qfrc_constraint, force),
        "qacc": apart(sim.qacc, data.qacc, force / np.abs(theirs_mass).max()),
        "sensordata": sensors_apart(sim, model, data),
    }
    for name, value in note.items():
        worst.note(name, value, index)


def note_step(
    worst: Worst, index: int, sim: sc.Sim, model: mujoco.MjModel, data: mujoco.MjData, state: State
) -> None:
    """Both engines' step from `state`, and how far apart they land."""
    state.to_mujoco(model, data)
    state.to_stepcore(sim)
    mujoco.mj_step(model, data)
    sim.step(1)
    worst.note("qpos", apart(sim.qpos, data.qpos), index)
    worst.note("qvel", apart(sim.qvel, data.qvel), index)
    worst.note("act", apart(sim.act, data.act), index)


def rows_seen(model: mujoco.MjModel, data: mujoco.MjData, states: list[State]) -> dict[str, int]:
    """At how many of the states each kind of row is there; friction also by whether it slips."""
    kind = mujoco.mjtConstraint
    groups = {
        "equality": (kind.mjCNSTR_EQUALITY,),
        "friction": (kind.mjCNSTR_FRICTION_DOF, kind.mjCNSTR_FRICTION_TENDON),
        "limit": (kind.mjCNSTR_LIMIT_JOINT, kind.mjCNSTR_LIMIT_TENDON),
        "contact": (
            kind.mjCNSTR_CONTACT_FRICTIONLESS,
            kind.mjCNSTR_CONTACT_PYRAMIDAL,
            kind.mjCNSTR_CONTACT_ELLIPTIC,
        ),
    }
    count = dict.fromkeys((*groups, "slips", "sticks"), 0)
    for state in states:
        state.to_mujoco(model, data)
        mujoco.mj_forward(model, data)
        for name, kinds in groups.items():
            active = np.isin(data.efc_type, [int(k) for k in kinds]) & (data.efc_force != 0.0)
            count[name] += bool(active.any())
        loss = np.isin(data.efc_type, [int(k) for k in groups["friction"]])
        slips = np.abs(data.efc_force[loss]) >= data.efc_frictionloss[loss] * (1 - 1e-12)
        count["slips"] += bool(slips.any())
        count["sticks"] += bool((~slips).any())
    return count
