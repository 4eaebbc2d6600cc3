"""`Replay`, a failed run that can be repeated, and `PostMortem`, the energy of elements in it."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from stepcore import _core, checks, files
from stepcore._core import Settings, SimulationError
from stepcore.engine.arrays import INPUTS, Floats, digest
from stepcore.report.result import Result
from stepcore.report.table import Table

if TYPE_CHECKING:
    from stepcore.engine.model import Model

KIND = "stepcore replay"
# Increases when the layout of the file changes.
VERSION = 2
CHECK = '"check": "{}"'
# Attributes of the error in a replay; the file also has the error's text and the last state.
ATTRIBUTES = (
    *("step", "time", "world", "gained", "growth", "stable_dt"),
    *("element", "element_id", "shares", "share_ids"),
)


@dataclass(frozen=True, repr=False)
class Replay:
    """A run from a good state to its failure, available as `SimulationError.replay`.

    name: the name of the scene.
    settings: the settings of the run.
    state: the complete state (`Sim.state`) from which the run fails again.
    inputs: (step, ctrl, qfrc_applied, xfrc_applied, eq_active, mocap_pos, mocap_quat) at each
        change of an input; steps count from `state`.
    steps: the number of steps to the last finite state. The next step gives a non-finite value; or,
        with a ledger, the last finite state has more energy than is physically possible, or an
        impossible speed.
    happened: the attributes and the text of the error, a digest of the last finite state, and
        "finite": whether that state is the failure, instead of the step after it.

    >>> import stepcore as sc
    >>> sim = sc.Sim(sc.lesson.spring(), dt=0.205, integrator="semi-implicit", ledger=True)
    >>> sim.reset("start")
    >>> try:
    ...     sim.step(1000)
    ... except sc.SimulationError as error:
    ...     failure = error.replay
    >>> failure
    <Replay of "spring": 64 steps, energy from spring of joint `spring`>
    >>> failure.run().same
    True
    """

    name: str
    settings: Settings
    state: bytes
    inputs: list[tuple[Any, ...]]
    steps: int
    happened: dict[str, Any]
    # The scene of the compiled model, or the plain data of a file.
    _scene: Any = field(compare=False)

    @property
    def scene(self) -> dict[str, Any]:
        """The scene as plain data, as returned by `Scene.to_dict`."""
        scene: dict[str, Any] = self._scene
        return scene if isinstance(scene, dict) else self._scene.to_dict()

    def run(self) -> PostMortem:
        """Repeat the run; see `stepcore.replay`."""
        settings = self.settings.replace(ledger=False)
        model = _core.compile(self.scene)
        sim = _core.Sim(model, settings)
        sim.unwatch()
        sim.restore(self.state, None)
        sim_arrays = dict(sim.arrays())
        changes = {step: arrays for step, *arrays in self.inputs}
        time, energy, steps = list[float](), list[float](), list[dict[Any, float]]()
        # A replay that fails too early differs from the run.
        with contextlib.suppress(SimulationError):
            for step in range(self.steps):
                _put(sim_arrays, changes.get(step))
                before, after, injected = sim.taped_step()
                energy += [before, after] if step == 0 else [after]
                time.append(sim.time)
                steps.append(dict(injected))
        _put(sim_arrays, changes.get(self.steps))
        work = {
            model.element_name(*element): np.array([step.get(element, 0.0) for step in steps])
            for element in sorted({element for injected in steps for element in injected})
        }
        return PostMortem(
            name=self.name or "scene",
            replay=self,
            same=_fails(self, sim, sim_arrays),
            time=np.array(time),
            energy=np.array(energy),
            work=work,
        )

    def to_json(self) -> str:
        """Return the text of the file, with meshes and height fields as base64."""
        body = {
            "name": self.name,
            "scene": self.scene,
            "settings": self.settings.as_dict(),
            "state": base64.b64encode(self.state).decode("ascii"),
            "inputs": [list(change) for change in self.inputs],
            "steps": self.steps,
            "happened": self.happened,
        }
        head = {"kind": KIND, "version": VERSION, "check": ""}
        text = json.dumps(head | body, indent=1, default=_packed)
        return text.replace(CHECK.format(""), CHECK.format(_checksum(text.encode())), 1)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a file for `stepcore.replay` and ``stepcore replay FILE``."""
        Path(files.as_path("path", path)).write_bytes(self.to_json().encode() + b"\n")

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Replay:
        """Read a replay file.

        path: the file to read.

        Raises a one-line ValueError for a file that is no replay file, was changed or has another
        version; FileNotFoundError for a missing file; IsADirectoryError for a folder.
        """
        shown = checks.cut(files.as_path("path", path), 300)
        text = files.contents(path, "a replay file")
        try:
            data = json.loads(text)
        except (ValueError, RecursionError):
            raise ValueError(f"{shown}: not a replay file, or incomplete") from None
        if not isinstance(data, dict) or data.get("kind") != KIND:
            raise ValueError(f"{shown}: not a replay file")
        version = data.get("version")
        if version != VERSION:
            other = f"version {checks.shown(version)} of a replay file"
            raise ValueError(f"{shown}: {other}; this stepcore reads version {VERSION}")
        check = CHECK.format(data.get("check")).encode()
        blank = text.removesuffix(b"\n").replace(check, CHECK.format("").encode(), 1)
        if check != CHECK.format(_checksum(blank)).encode():
            raise ValueError(f"{shown}: this replay file was edited or damaged")
        try:
            return _made(json.loads(text, object_hook=_unpacked))
        except (ValueError, TypeError) as error:
            raise _unusable(shown, error) from None

    def __repr__(self) -> str:
        name = f" of {checks.quoted(self.name)}" if self.name else ""
        element = checks.cut(self.happened["element"], 200)
        return f"<Replay{name}: {self.steps} steps, energy from {element}>"


def _made(data: dict[str, Any]) -> Replay:
    """Create a replay from the data of a file."""
    happened = data["happened"]
    element = happened["element_id"]
    happened["element_id"] = None if element is None else tuple(element)
    happened["share_ids"] = [tuple(element) for element in happened["share_ids"]]
    return Replay(
        name=data["name"],
        settings=Settings(**data["settings"]),
        state=base64.b64decode(data["state"]),
        inputs=[tuple(change) for change in data["inputs"]],
        steps=data["steps"],
        happened=happened,
        _scene=data["scene"],
    )


def _unusable(shown: str, error: Exception) -> ValueError:
    text = checks.cut(getattr(error, "text", checks.one_line(error)))
    return ValueError(f"{shown}: this replay file cannot be used: {text}")


def _packed(array: Any) -> Any:
    """Return an array as JSON data: type, shape and bytes."""
    array = np.asarray(array)
    packed = array.astype(array.dtype.newbyteorder("<"), copy=False)
    text = base64.b64encode(packed.tobytes()).decode("ascii")
    return {"array": [packed.dtype.str, list(packed.shape), text]}


def _unpacked(data: dict[str, Any]) -> Any:
    """Return an object of a file, or the array that it represents."""
    if set(data) != {"array"} or not isinstance(data["array"], list):
        return data
    kind, shape, text = data["array"]
    array = np.frombuffer(base64.b64decode(text), kind).reshape(shape)
    return array.astype(array.dtype.newbyteorder("="))


def _checksum(text: bytes) -> str:
    """Return the checksum of a file's text in which the field "check" is empty."""
    return hashlib.sha256(text).hexdigest()


@dataclass(repr=False)
class PostMortem(Result):
    """A repeated failure, with the energy that each element injected in each step.

    same: whether the replay failed in the same step with the same bits.
    time: the time after each step [s], shape (n,).
    energy: kinetic energy plus the energy of springs and penalty contacts [J], before the first
        step and after each step, shape (n + 1,).
    work: for each element, the energy that the element injected in each step [J], shape (n,): the
        work on the motion plus the change of the stored energy. The sum over all elements is the
        change of the total energy, including gravity. In an exact motion a conservative element
        injects no energy.
    shares: each element's share of the energy injected, the largest first.

    >>> import stepcore as sc
    >>> sim = sc.Sim(sc.lesson.spring(), dt=0.1, integrator="explicit", ledger=True)
    >>> sim.reset("start")
    >>> try:
    ...     sim.step(1000)
    ... except sc.SimulationError as error:
    ...     again = error.replay.run()
    >>> bool(again.energy[-1] > 1e9 * again.energy[0]), list(again.shares)
    (True, ['spring of joint `spring`'])
    """

    kind = "postmortem"
    units: ClassVar = {"energy": "J", "time": "s", "work": "J"}

    replay: Replay
    same: bool
    time: Floats
    energy: Floats
    work: dict[str, Floats]

    @property
    def settings(self) -> Settings:
        return self.replay.settings

    @property
    def paragraph(self) -> str:
        """The text of the error."""
        return str(self.replay.happened["text"])

    @property
    def shares(self) -> dict[str, float]:
        """Share of each element in the injected energy, largest first."""
        shares: dict[str, float] = self.replay.happened["shares"]
        return shares

    @property
    def title(self) -> str:
        return f"{self.name}: post-mortem"

    @property
    def sentences(self) -> list[str]:
        """The text of the error, and whether the replay reproduced the failure."""
        text, replay = self.paragraph, self.replay
        outcome = f"The replay fails again after {replay.steps} steps, with the same bits."
        if not self.same:
            step = replay.happened["step"]
            outcome = f"The replay does not fail in step {step} with the same bits as the run."
        sentences = [text[:1].upper() + text[1:].removesuffix(".") + ".", outcome]
        if not len(self.time):
            sentences.append(
                "With ledger=True in its settings a run records the steps before a failure."
            )
        return sentences

    @property
    def table(self) -> Table:
        """For each step, the energy after the step and the energy injected by each element [J]."""
        return self._steps(list(self.work), len(self.time))

    def tables(self, full: bool) -> list[Table]:
        """Return the last steps of the leading elements; `full`: all steps and elements."""
        if not len(self.time):
            return []
        most, count = (len(self.work), len(self.time)) if full else (5, 12)
        table = self._steps(self.leading(most), count)
        table.heading = (
            "Kinetic and spring energy [J], and what each element injected in the step [J]"
        )
        return [table]

    def _steps(self, names: list[str], most: int) -> Table:
        count = len(self.time)
        first = self.replay.happened["step"] - count + 1
        records = [
            {"step": first + k, "energy": float(self.energy[k + 1])}
            | {name: float(self.work[name][k]) for name in names}
            for k in range(max(count - most, 0), count)
        ]
        return Table(records, ["step", "energy", *names], dict.fromkeys(names, ".3g"))

    def details(self) -> dict[str, Any]:
        """Return the recorded steps as arrays, and the data of the failure."""
        steps = {"steps": self.replay.steps, "same": self.same, "happened": self.replay.happened}
        return steps | {"time": self.time, "energy": self.energy, "work": self.work}

    def leading(self, most: int) -> list[str]:
        """Return the leading elements: by share, then by the largest energy moved in a step."""
        shares, moved = list(self.shares), dict[str, float]()
        for name, work in self.work.items():
            moved[name] = float(np.abs(work[np.isfinite(work)]).max(initial=0.0))
        rest = sorted((name for name in moved if name not in shares), key=lambda n: -moved[n])
        names = [name for name in shares if name in moved]
        return (names + [name for name in rest if moved[name] > 0])[:most]


def _put(arrays: dict[str, Floats], inputs: list[list[float]] | None) -> None:
    if inputs is not None:
        for name, values in zip(INPUTS, inputs, strict=True):
            arrays[name].reshape(-1)[:] = values


def _fails(failure: Replay, sim: _core.Sim, arrays: dict[str, Floats]) -> bool:
    """Return whether the present state equals the failure's last finite state and fails too."""
    happened = failure.happened
    if digest(arrays["qpos"], arrays["qvel"]) != happened["state"]:
        return False
    if happened["finite"]:
        return True
    try:
        sim.step(1)
    except SimulationError as error:
        return error.step == happened["step"]
    return False


def attach(error: SimulationError, model: Model, qpos: Floats, qvel: Floats) -> None:
    """Attach a `replay` to an error.

    qpos, qvel: the last finite state of the world that failed.
    """
    happened = {name: getattr(error, name) for name in ATTRIBUTES}
    private = error.__dict__
    happened |= {"finite": private.pop("_finite"), "text": str(error), "state": digest(qpos, qvel)}
    error.replay = Replay(
        name=model.scene.name,
        settings=model.settings,
        state=private.pop("_start"),
        inputs=private.pop("_changes"),
        steps=private.pop("_steps"),
        happened=happened,
        _scene=model.scene,
    )


def replay(source: str | os.PathLike[str] | Replay) -> PostMortem:
    """Repeat a failure, and return the energy that each element injected.

    source: the path of a replay file, or a `Replay` (an error's ``replay``).

    Raises the same errors as `Replay.load` for a file, and ValueError if scene, state and inputs
    are inconsistent.

    >>> import stepcore as sc
    >>> sim = sc.Sim(sc.lesson.spring(), dt=0.205, integrator="semi-implicit", ledger=True)
    >>> sim.reset("start")
    >>> try:
    ...     sim.step(1000)
    ... except sc.SimulationError as error:
    ...     again = sc.replay(error.replay)
    >>> again.same, max(again.shares, key=again.shares.get)
    (True, 'spring of joint `spring`')
    """
    if isinstance(source, Replay):
        return source.run()
    if not isinstance(source, (str, os.PathLike)):
        limit = "a path or a Replay"
        raise ValueError(f"replay: source = {checks.shown(source)}: must be {limit}")
    loaded = Replay.load(source)
    try:
        return loaded.run()
    except ValueError as error:
        raise _unusable(checks.cut(os.fsdecode(source), 300), error) from None
