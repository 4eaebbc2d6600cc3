"""Signatures of calls that take the fields of something as keywords, spelled out for `help`."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypedDict, TypeVar

from stepcore import checks

F = TypeVar("F", bound=Callable[..., Any])


class SettingsFields(TypedDict, total=False):
    """Single fields of `Settings`, in place of those of the scene."""

    dt: float
    integrator: str
    solver: str
    acceleration: str
    sweeps: int | str
    tolerance: float
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
    stiction: bool
    sleep: bool
    sleep_tolerance: float
    sleep_time: float
    refsafe: bool


class UnknownArgument(TypeError, ValueError):
    """An unknown argument: a TypeError, as Python raises, and a ValueError, as every error about an
    argument here."""


class _AsInScene:
    """The default of a settings field: the value that the scene has."""

    def __repr__(self) -> str:
        return "<the scene's>"


class _Annotation(str):
    """An annotation that is shown without quotation marks."""

    def __repr__(self) -> str:
        return str(self)


def keyword(name: str, default: object, annotation: object) -> inspect.Parameter:
    """A keyword argument of a signature."""
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
    )


def spell_out(function: F, keywords: Iterable[inspect.Parameter]) -> F:
    """Lists `keywords` in the signature of a function in place of its ``**fields``."""
    own = inspect.signature(function).parameters.values()
    listed = [p for p in own if p.kind is not inspect.Parameter.VAR_KEYWORD]
    plain = [_plain(parameter) for parameter in (*listed, *keywords)]
    returns = inspect.signature(function).return_annotation
    if isinstance(returns, str):
        returns = _Annotation(returns)
    function.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        plain, return_annotation=returns
    )
    return function


def takes_settings(function: F) -> F:
    """Decorator: the function takes each field of `Settings` as a keyword argument."""
    fields = SettingsFields.__annotations__.items()
    return spell_out(function, [keyword(name, _AsInScene(), _text(hint)) for name, hint in fields])


def refuse_unknown(call: Callable[..., Any], given: Mapping[str, Any]) -> None:
    """Raises UnknownArgument for an argument that `call` does not have, naming the nearest."""
    takes = inspect.signature(call).parameters if given else {}
    for word in given:
        if word not in takes:
            near = checks.nearest(word, takes)
            raise UnknownArgument(f"{call.__name__}() has no argument {checks.quoted(word)}{near}")


def _plain(parameter: inspect.Parameter) -> inspect.Parameter:
    if isinstance(parameter.annotation, str):
        return parameter.replace(annotation=_Annotation(parameter.annotation))
    return parameter


def _text(hint: Any) -> Any:
    """The text of an annotation of a TypedDict, which is kept as a ForwardRef."""
    return getattr(hint, "__forward_arg__", hint)
