"""The fields of `Settings` as keywords of `Sim` and its like, for type checkers and editors.

What each means stands at `stepcore.Settings`; a test compares the names.
"""

from __future__ import annotations

from typing import TypedDict


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
