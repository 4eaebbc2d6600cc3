"""`tune`: gains of servos and softness of contacts for a wanted behaviour, verified by runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Unpack

from stepcore import checks
from stepcore._core import Settings
from stepcore.experiment.arguments import MeasurementFields, Source, measurement, set_up
from stepcore.experiment.change import Change
from stepcore.experiment.motion import Motion
from stepcore.experiment.motion_words import scene_in_words, start_in_words
from stepcore.experiment.schedule import home
from stepcore.measure.tune.contacts import resting_geoms, tuned_contact
from stepcore.measure.tune.goal import At, Goal, Tuned
from stepcore.measure.tune.ground import asking, ground_of, hung
from stepcore.measure.tune.servos import for_motors, servos_of, tuned_servos
from stepcore.report import units
from stepcore.report.result import Result
from stepcore.report.settings import label
from stepcore.report.table import Table
from stepcore.report.units import counted

__all__ = ["Tuning", "tune"]

SERVO, CONTACT = ("bandwidth", "settling", "sag"), ("depth", "settling")
# The keyframe is the only field of a motion that tune uses.
OTHERS = tuple(field.name for field in fields(Motion) if field.name != "key")


@dataclass(eq=False, repr=False)
class Tuning(Result):
    """Proposed gains, or solref and solimp; `stepcore.tune` returns it.

    settings: the settings under which every proposal was run.
    found: the proposals, one per servo or geom; see `Tuned`.
    """

    kind = "tuning"
    units: ClassVar = {"wanted": "Hz, s, rad or m", "measured": "as wanted"}

    settings: Settings
    found: list[Tuned]

    @property
    def title(self) -> str:
        """The scene."""
        return f"{self.name}: tune"

    @property
    def setup(self) -> str:
        return f"Under {label(self.settings)}."

    @property
    def mjcf(self) -> str:
        """The attributes to paste into the MJCF file, one line per element."""
        return "\n".join(line for tuned in self.found if tuned.reached for line in tuned.lines)

    @property
    def rows(self) -> list[Tuned]:
        """The proposals."""
        return self.found

    @property
    def sentences(self) -> list[str]:
        """The proposals with their measured values; goals that are not reached, with the reason."""
        if not self.found:
            return [
                "There is nothing to tune: no position servo or motor of a joint, and nothing that "
                "rests."
            ]
        reached = sum(tuned.reached for tuned in self.found)
        said = [f"{reached} of {len(self.found)} reached, each run as it is printed:"]
        said = said if reached else ["Not reached:"]
        alike = dict[object, list[Tuned]]()
        for tuned in self.found:
            reason = id(tuned) if tuned.reached else (tuned.wanted, tuned.why)
            alike.setdefault(reason, []).append(tuned)
        for group in alike.values():
            names = ", ".join(tuned.called for tuned in group)
            said.append(f"- {names[0].upper()}{names[1:]}, {group[0].said}")
            said += [f"  {line}" for line in group[0].lines] if group[0].reached else []
        return said

    @property
    def table(self) -> Table:
        """The proposals in numbers."""
        columns = ["kind", "name", "goal", "wanted", "measured", "expected", "reached", "mjcf"]
        formats = {"wanted": ".4g", "measured": ".4g", "expected": ".4g"}
        return Table((tuned.record() for tuned in self.found), columns, formats)

    def tables(self, full: bool) -> list[Table]:
        """Return the proposals without the MJCF attributes, which are in the sentences."""
        table = self.table
        return [Table(table, table.columns[:-1], table.formats)] if self.found else []

    def details(self) -> dict[str, Any]:
        return {"mjcf": self.mjcf}


@measurement(without=OTHERS)
def tune(
    model: Source,
    *,
    bandwidth: float | None = None,
    settling: float | str | None = None,
    sag: float | None = None,
    depth: float | str | None = None,
    servo: str | Sequence[str] | None = None,
    geom: str | Sequence[str] | None = None,
    dt: float | str | None = None,
    **fields: Unpack[MeasurementFields],
) -> Tuning:
    """Find gains of position servos, or solref and solimp of contacts, for one wanted value.

    Every proposal is applied to a copy of the model and run before it is returned. The result gives
    the wanted value, the measured value and the closed form's value. If the time step does not
    allow the wanted value, the result gives the best possible one.

    Motors of joints are replaced by servos, which represent the PD controllers of robots with
    motors; kp and kv are the controllers' gains. A URDF has no actuators, so joints with a limit of
    effort get motors.

    model: a Model, a Scene, or the path of an MJCF file (or "package:name").
    bandwidth: for servos, the frequency at which the response falls to 1/√2 [Hz].
    settling: the time until the response to a step of the target (for contacts, of the load) stays
        within 2 % [s], or a text such as "200ms".
    sag: for servos, the distance from the target under the load of the pose [rad or m].
    depth: the depth of contacts at rest, a length such as 1e-4 or "0.1mm".
    servo: the name of a servo, or several; by default all on hinges and slides.
    geom: the name of a geom, or several; by default those that rest on something after 2 s.
    dt: the time step [s]; by default the model's.
    key: the keyframe of the pose and controls; by default the first, or the pose of the scene.
    threads, executor, progress, seconds: see `stepcore.experiment.arguments.Workers`.

    Raises ValueError unless exactly one wanted value is given, and for values outside their limits.

    >>> from stepcore import loads
    >>> arm = loads('''<mujoco><worldbody><body><joint name="hip" axis="0 1 0"/>
    ... <geom type="capsule" size=".03" fromto="0 0 0 0 0 -.5" mass="1"/></body></worldbody>
    ... <actuator><position name="hip" joint="hip"/></actuator></mujoco>''')
    >>> tune(arm, bandwidth=3.0).mjcf
    '<position name="hip" kp="79" kv="5.25"/>'
    """
    given = {"bandwidth": bandwidth, "settling": settling, "sag": sag, "depth": depth}
    goals = [Goal(name, _value(name, value)) for name, value in given.items() if value is not None]
    if len(goals) != 1:
        raise ValueError(f"give one of {', '.join(given)}")
    (goal,) = goals
    if servo is not None and geom is not None:
        raise ValueError("servo and geom are both given: tune one kind at a time")
    for kind, names, fit in (("servo", servo, SERVO), ("geom", geom, CONTACT)):
        if names is not None and goal.name not in fit:
            raise ValueError(f"{kind} and {goal.name} do not go together: give {', '.join(fit)}")
    setup = set_up(tune, model, None, fields, missing="nothing to tune")
    compiled, motion, workers = setup.model, setup.motion, setup.workers
    if dt is not None:
        compiled = Change(dt=units.time("dt", dt)).of(compiled)
    at, found, ran = At(*home(compiled, motion.key)), list[Tuned](), "nothing was run"
    is_servo = goal.name in SERVO and geom is None
    driven, motors = for_motors(compiled, _names(servo)) if is_servo else (compiled, set())
    servos = servos_of(driven, _names(servo)) if is_servo else []
    if servos:
        at = asking(driven, at)
        ground, base, falls = ground_of(driven, at, goal.name)
        hanging, lifted = hung(driven, at, setup.engine.size)
        place = f" in place of {counted(len(motors), 'motor')}" if motors else ""
        if falls and goal.name == "sag":
            called = driven.called("actuator")
            found = [
                Tuned("servo", called[drive.index], goal, "rad", why=falls) for drive in servos
            ]
        else:
            found = tuned_servos(hanging, lifted, servos, goal, motors, workers.deadline, ground)
        ran = f"{'servos' if motors else 'the servos'}{place} hold the pose{base}"
    elif goal.name in CONTACT:
        law, ran = compiled.settings.law, "2 s or more to come to rest"
        if law != "solref":
            raise ValueError(f"{goal.name}: contacts under law {law} have no solref to tune")
        geoms = resting_geoms(compiled, at, _names(geom))
        made: list[Tuned | None] = []
        with workers.deadline.stage("the rest of the geoms"):
            workers.each(lambda one: tuned_contact(compiled, at, one, goal), geoms, "geoms", made)
        found = [tuned for tuned in made if tuned is not None]
    begin = start_in_words(compiled, motion.key)
    return Tuning(
        compiled.settings,
        found,
        name=setup.name,
        ran=f"from {begin}; {ran}; {scene_in_words(compiled)}",
        notes=list(compiled.scene.notes),
    )


def _value(name: str, value: Any) -> float:
    if name == "settling":
        return units.time(name, value)
    if name == "depth":
        return units.length("tune", name, value, 1.0)
    number: float = checks.real(above=0)("tune", name, value)
    return number


def _names(value: str | Sequence[str] | None) -> list[str] | None:
    return None if value is None else [value] if isinstance(value, str) else list(value)
