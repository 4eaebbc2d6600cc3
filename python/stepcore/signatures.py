"""Signatures with ``**fields`` written out as single keywords, for `help` and editors."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypedDict, TypeVar

from stepcore import checks

# MuJoCo's names of arguments.
MUJOCO = {"timestep": "dt", "iterations": "sweeps"}
F = TypeVar("F", bound=Callable[..., Any])


class SettingsFields(TypedDict, total=False):
    """Single fields of `Settings`, which replace the scene's settings."""

    dt: float
    accuracy: float | str | None
    integrator: str
    solver: str
    acceleration: str
    sweeps: int | str
    tolerance: float
    cost_tolerance: float
    warm_start: bool
    precision: str
    max_contacts: int
    ledger: bool
    law: str
    beta: float
    softness: float
    restitution: float
    slop: float
    max_recovery_speed: float | str
    penalty_stiffness: float
    penalty_damping_ratio: float
    cone: str
    impratio: float
    noslip_iterations: int
    noslip_tolerance: float
    stiction: bool
    sleep: bool
    sleep_tolerance: float
    sleep_time: float
    refsafe: bool


class UnknownArgument(TypeError, ValueError):
    """An error about an unknown argument.

    It is a TypeError, as in Python, and a ValueError, as all errors about arguments in stepcore.
    """


class _Shown(str):
    """A text that `help` shows without quotation marks."""

    def __repr__(self) -> str:
        return str(self)


def keyword(name: str, default: object, annotation: object) -> inspect.Parameter:
    """Return a keyword argument of a signature."""
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
    )


def spell_out(function: F, keywords: Iterable[inspect.Parameter]) -> F:
    """Replace ``**fields`` by `keywords` in the signature of a function."""
    before = inspect.signature(function)
    kept = [p for p in before.parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD]
    named = [p.replace(annotation=_plain(p.annotation)) for p in (*kept, *keywords)]
    signature = inspect.Signature(named, return_annotation=_plain(before.return_annotation))
    function.__signature__ = signature  # type: ignore[attr-defined]
    return function


def _plain(annotation: Any) -> Any:
    return _Shown(annotation) if isinstance(annotation, str) else annotation


def takes_settings(function: F) -> F:
    """Decorate a function: its signature lists each field of `Settings` as a keyword."""
    fields, default = SettingsFields.__annotations__.items(), _Shown("<the scene's>")
    return spell_out(function, [keyword(name, default, annotation(hint)) for name, hint in fields])


def refuse_unknown(call: Callable[..., Any], arguments: Mapping[str, Any]) -> None:
    """Raise UnknownArgument, with the nearest names, for an argument that `call` lacks."""
    takes = inspect.signature(call).parameters if arguments else {}
    for word in arguments:
        if word not in takes:
            ours = MUJOCO.get(word, "")
            near = f'; here it is "{ours}"' if ours in takes else checks.nearest(word, takes)
            raise UnknownArgument(f"{call.__name__}() has no argument {checks.quoted(word)}{near}")


def refuse_unknown_settings(call: Callable[..., Any], fields: SettingsFields) -> None:
    """Do the same for a call whose ``**fields`` are fields of `Settings`.

    The signature is read only for an error: reading it takes as long as creating a Sim.
    """
    if not fields.keys() <= SettingsFields.__annotations__.keys():
        refuse_unknown(call, fields)


def annotation(hint: Any) -> Any:
    """Return the text of an annotation of a TypedDict, which Python stores as a ForwardRef."""
    return getattr(hint, "__forward_arg__", hint)
