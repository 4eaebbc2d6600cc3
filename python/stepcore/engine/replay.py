"""`Replay`: a failed run to be repeated: its scene, settings, complete state and inputs."""

from __future__ import annotations

import base64
import hashlib
import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stepcore import checks, files
from stepcore._core import Settings, SimulationError
from stepcore.engine.arrays import Floats, digest
from stepcore.engine.postmortem import PostMortem, run_again
from stepcore.engine.replay_checks import ATTRIBUTES, checked, unpacked

if TYPE_CHECKING:
    from stepcore.engine.model import Model

KIND = "stepcore replay"
# Goes up when the layout of the file changes.
VERSION = 1


@dataclass(frozen=True, repr=False)
class Replay:
    """A run from a good state to its failure; an error has it as `SimulationError.replay`.

    name: the name of the scene.
    settings: the settings of the run.
    state: the complete state (`Sim.state`) from which the run fails again.
    inputs: (step, ctrl, qfrc_applied, xfrc_applied, eq_active, mocap_pos, mocap_quat) wherever they
        change; steps count from that state.
    steps: the number of steps to the last finite state. In the step after it something is not
        finite; or, with a ledger, that state has energy that it cannot have gained.
    happened: the attributes of the error, its text, and a digest of the last finite state.

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
    # The compiled model's own scene, or the plain data that a file has.
    _scene: Any = field(compare=False)

    @property
    def scene(self) -> dict[str, Any]:
        """The scene as plain data: what `Scene.to_dict` returns."""
        scene: dict[str, Any] = self._scene
        return scene if isinstance(scene, dict) else self._scene.to_dict()

    def run(self) -> PostMortem:
        """Run it again; see `stepcore.replay`."""
        return run_again(self)

    def to_json(self) -> str:
        """The file's text. Meshes and height fields stand in it byte by byte, as base64."""
        body = {
            "name": self.name,
            "scene": self.scene,
            "settings": self.settings.as_dict(),
            "state": base64.b64encode(self.state).decode("ascii"),
            "inputs": [list(change) for change in self.inputs],
            "steps": self.steps,
            "happened": self.happened,
        }
        head = {"kind": KIND, "version": VERSION, "check": _check(body)}
        return json.dumps(head | body, indent=1, default=_packed)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the file that `stepcore.replay` and ``stepcore replay FILE`` read."""
        Path(files.path("path", path)).write_text(self.to_json() + "\n", encoding="utf-8")

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Replay:
        """Read a replay file.

        Raises ValueError, in one line, for a file that is no replay file, was damaged or has
        another version; FileNotFoundError for a missing file, IsADirectoryError for a folder.
        """
        shown = checks.cut(files.path("path", path), 300)
        text = files.read(path, "a replay file")
        try:
            data = json.loads(text)
        except (ValueError, RecursionError):
            raise ValueError(f"{shown}: not a replay file, or incomplete") from None
        if not isinstance(data, dict) or data.pop("kind", None) != KIND:
            raise ValueError(f"{shown}: not a replay file")
        version = data.pop("version", None)
        if version != VERSION:
            what = f"version {checks.shown(version)} of a replay file"
            raise ValueError(f"{shown}: {what}; this stepcore reads version {VERSION}")
        check = data.pop("check", None)
        try:
            if check != _check(data):
                raise ValueError("it was edited or damaged")
            return _made(data)
        except (ValueError, TypeError, OverflowError, RecursionError) as error:
            raise _unusable(shown, error) from None

    def __repr__(self) -> str:
        of = f" of {checks.quoted(self.name)}" if self.name else ""
        element = checks.cut(self.happened["element"], 200)
        return f"<Replay{of}: {self.steps} steps, energy from {element}>"


def _made(data: dict[str, Any]) -> Replay:
    """The replay of a file's data, each field checked; ValueError or TypeError with its name."""
    data = checked(data)
    return Replay(
        name=data["name"],
        settings=Settings(**data["settings"]),
        state=data["state"],
        inputs=data["inputs"],
        steps=data["steps"],
        happened=data["happened"],
        _scene=unpacked(data["scene"]),
    )


def _unusable(shown: str, error: Exception) -> ValueError:
    text = checks.cut(getattr(error, "text", checks.one_line(error)))
    return ValueError(f"{shown}: this replay file cannot be used: {text}")


def _packed(array: Any) -> Any:
    """An array in JSON: type, shape and bytes."""
    array = np.asarray(array)
    packed = array.astype(array.dtype.newbyteorder("<"), copy=False)
    text = base64.b64encode(packed.tobytes()).decode("ascii")
    return {"array": [packed.dtype.str, list(packed.shape), text]}


def _check(body: dict[str, Any]) -> str:
    """A checksum of everything that the file holds."""
    text = json.dumps(body, sort_keys=True, separators=(",", ":"), default=_packed)
    return hashlib.sha256(text.encode()).hexdigest()


def attach(error: SimulationError, model: Model, qpos: Floats, qvel: Floats) -> None:
    """Give an error its `replay`. qpos, qvel: the last finite state of the world that failed."""
    happened = {name: getattr(error, name) for name in ATTRIBUTES}
    happened |= {"text": str(error), "state": digest(qpos, qvel)}
    private = error.__dict__
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
    """Run a failure again, and returns what each element did on the way.

    source: the path of a replay file, or a `Replay` (an error's ``replay``).

    Raises what `Replay.load` raises for a file, and ValueError for one whose scene, state or inputs
    do not go together.

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
        return run_again(source)
    if not isinstance(source, (str, os.PathLike)):
        limit = "a path or a Replay"
        raise ValueError(f"replay: source = {checks.shown(source)}: must be {limit}")
    loaded = Replay.load(source)
    try:
        return run_again(loaded)
    except ValueError as error:
        raise _unusable(checks.cut(os.fsdecode(source), 300), error) from None
