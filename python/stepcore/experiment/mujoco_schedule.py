"""The schedule of a motion from MuJoCo's model alone, for a file that stepcore cannot load.

Starts are near the keyframe, as in `schedule`; a flex moves as a whole. Controls are the user's
rows, or one of these kinds: "hold" holds the keyframe's controls, "sines" (the default) sums random
sines within the control ranges, "random" draws new controls in every period, and "fall" sets all
controls to 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from stepcore import checks
from stepcore.engine.coordinates import Coordinates
from stepcore.engine.start import Start
from stepcore.experiment.control_table import PositionTable
from stepcore.experiment.controls import Controls
from stepcore.experiment.default_motion import by_rule
from stepcore.experiment.motion import Motion
from stepcore.experiment.schedule import HORIZON, Schedule, laid_out, played

KINDS = ("hold", "sines", "random", "fall")
# MuJoCo's flag against clamping (mjDSBL_CLAMPCTRL), and its transmissions to a joint.
CLAMPCTRL, JOINTS = 1 << 8, (0, 1)


class Actuators:
    """The actuators of MuJoCo's model, as tables of controls need them."""

    def __init__(self, scene: Any) -> None:
        drives = np.isin(scene.actuator_trntype, JOINTS)
        self.nu = int(scene.nu)
        self.joint_names = [scene.joint(k).name for k in range(scene.njnt)]
        self.actuator_names = [scene.actuator(k).name for k in range(scene.nu)]
        self.actuator_joint = np.where(drives, scene.actuator_trnid[:, 0], -1)

    def called(self, kind: str) -> list[str]:
        return [name or f"{kind} {k}" for k, name in enumerate(self.actuator_names)]


def scheduled_by_mujoco(
    motion: Motion,
    scene: Any,
    coordinates: Coordinates,
    period: float,
    starts: int | None = None,
    horizon: float = HORIZON,
) -> Schedule:
    """Return the schedule of a motion; scene: MuJoCo's model. See `schedule.scheduled`.

    Raises ValueError for a motion that needs stepcore's model.
    """
    if motion.control is not None or isinstance(motion.ctrl, PositionTable):
        given = "control" if motion.control is not None else "follow"
        raise ValueError(f"{given}: needs stepcore's model of the scene; give rows of controls")
    if motion.kind is not None and motion.kind not in KINDS:
        checks.one_of(*KINDS)("a motion by MuJoCo alone", "kind", motion.kind)
    first, held = _home(scene, motion.key)
    drives = Actuators(scene)

    def drive(begin: Sequence[Start], periods: int) -> Controls:
        if motion.ctrl is not None:
            return Controls(played(motion, drives, held, period))
        clamped = scene.actuator_ctrllimited & (not scene.opt.disableflags & CLAMPCTRL)
        ranges = np.where(clamped[:, None], scene.actuator_ctrlrange, (-np.inf, np.inf))
        how = (ranges, held, len(begin), motion.seed, period, periods)
        return by_rule(motion.kind or "sines", "actuators", drives.called("actuator"), *how)

    where = coordinates, first, _overlaps(scene), 1e-4
    return laid_out(motion, float(scene.opt.timestep), *where, drive, period, starts, horizon)


def _home(scene: Any, key: str | int | None) -> tuple[Start, np.ndarray]:
    """Return the state and controls of a keyframe; by default the first, or qpos0."""
    if key is None and not scene.nkey:
        return Start(scene.qpos0.copy(), np.zeros(scene.nv)), np.zeros(scene.nu)
    names = [scene.key(k).name for k in range(scene.nkey)]
    index = names.index(key) if key in names else key if key is not None else 0
    if not isinstance(index, int) or not 0 <= index < scene.nkey:
        near = checks.nearest(str(key), names)
        raise ValueError(f"key = {checks.shown(key)}: the scene has no such keyframe{near}")
    qpos, qvel, act, mpos, mquat, ctrl = (
        getattr(scene, f"key_{name}")[index].copy()
        for name in ("qpos", "qvel", "act", "mpos", "mquat", "ctrl")
    )
    return Start(qpos, qvel, act, (mpos.reshape(-1, 3), mquat.reshape(-1, 4))), ctrl


def _overlaps(scene: Any) -> Callable[[Start], float]:
    """Return a function that measures the deepest overlap of a start's contacts [m]."""
    mj = mujoco()
    data = mj.MjData(scene)

    def overlap(start: Start) -> float:
        data.qpos[:] = start.qpos
        if start.mocap is not None:
            data.mocap_pos[:], data.mocap_quat[:] = start.mocap
        mj.mj_fwdPosition(scene, data)
        return -float(data.contact.dist.min(initial=0.0))

    return overlap


def mujoco() -> Any:
    """Return the module mujoco; ImportError with the command that installs it."""
    try:
        import mujoco  # type: ignore[import-untyped,unused-ignore]
        import mujoco.rollout  # type: ignore[import-untyped,unused-ignore]
    except ModuleNotFoundError as error:
        if error.name != "mujoco":
            raise
        raise ImportError("the engine mujoco needs MuJoCo: pip install mujoco") from None
    except ImportError as error:
        # If Ctrl-C interrupts the import of a compiled module, only the error's text says so.
        if "KeyboardInterrupt" in str(error):
            raise KeyboardInterrupt from None
        raise
    return mujoco
