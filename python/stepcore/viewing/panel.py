"""The controls and figures of a live view: `SimPanel` of a Sim, `RunPanel` of recorded runs."""

from __future__ import annotations

import math
import threading
from abc import ABC, abstractmethod
from bisect import bisect_left
from collections.abc import Sequence
from functools import partial
from html import escape
from time import monotonic
from typing import Any

import numpy as np

from stepcore.needs import need
from stepcore.report.plot.style import TINTS, VIEW
from stepcore.report.units import metres
from stepcore.viewing.drawing import ARROW, drawing_of
from stepcore.viewing.frames import Instant, Replayed, instant_of, poses_of, rms_distance
from stepcore.viewing.stage import Stage

SPEEDS = {"1/20 ×": 0.05, "1/10 ×": 0.1, "1/4 ×": 0.25, "1/2 ×": 0.5, "1 ×": 1.0, "2 ×": 2.0}
# The curves of energy, and the prefix of their names.
ENERGIES = {"kinetic": "", "potential": "Δ ", "total": "Δ "}
# The states that a live view can go back to, sixty a second of motion.
KEPT_STATES = 3000
# The longest time for which the page waits for steps or for new curves [s].
LONGEST_WAIT = 0.2


def _plot(
    gui: Any, title: str, names: Sequence[tuple[str, str]], span: tuple[float, float] | None
) -> Any:
    """Add a plot of curves over time; names: with their colours. span: of its axis [s]."""
    uplot = need("viser.uplot", "a view")
    lines = [uplot.Series(label=name, stroke=colour, width=2) for name, colour in names]
    axis = uplot.Scale(time=False, **({"auto": True} if span is None else {"range": span}))
    return gui.add_uplot(
        tuple(np.array([0.0]) for _ in range(len(lines) + 1)),
        (uplot.Series(label="time [s]"), *lines),
        title=title,
        scales={"x": axis},
        aspect=2.0,
        height=150,
    )


class Panel(ABC):
    """The common part of all views: pause, speed, time, overlays and figures."""

    def __init__(self, server: Any, stage: Stage) -> None:
        self.server, self.stage, self.gui = server, stage, server.gui
        # Buttons act in other threads than the clock.
        self.lock = threading.RLock()
        self.playing, self.sent = True, 0.0
        self.pause = self.gui.add_button("Pause")
        self.on = self.gui.add_button("Step")
        self.speed = self.gui.add_dropdown("Speed", tuple(SPEEDS), initial_value="1 ×")
        self.figures = self.gui.add_html("")
        self.pause.on_click(self._locked(lambda _: self.play(not self.playing)))
        self.on.on_click(self._locked(lambda _: self._step()))

    def _locked(self, call: Any) -> Any:
        def locked(event: Any) -> None:
            with self.lock:
                call(event)

        return locked

    def _overlays_and_curves(self, span: tuple[float, float] | None = None) -> None:
        """Add the check boxes of the overlays, and the plots of energy and residual."""
        with self.gui.add_folder("Shown"):
            for name in ("contacts", "forces"):
                box = self.gui.add_checkbox(name.capitalize(), True)
                box.on_update(self._locked(partial(self._switch, name)))
            follow = self.gui.add_checkbox("Follow", False, hint="keep what moves in the picture")
            follow.on_update(self._locked(lambda _: self.stage.follow(follow.value, self.seen)))
            through = self.gui.add_checkbox("See through", False, hint="forces inside bodies too")
            through.on_update(lambda _: self.stage.see_through(through.value))
            if self.stage.hidden:
                hidden = self.gui.add_checkbox("All geoms", False)
                hidden.on_update(lambda _: self.stage.show_hidden(hidden.value))
        energies = [(f"{sign}{name}", VIEW[name]) for name, sign in ENERGIES.items()]
        residual = [("log10", VIEW["residual"])]
        self.energy = _plot(self.gui, "energy [J]", energies, span)
        self.residual = _plot(self.gui, "log10 of the residual in m/s", residual, span)

    def _draw_curves(self, instants: Sequence[Instant], *more: tuple[Any, Any]) -> None:
        """Draw the curves until now; while it plays only if they were not drawn lately.

        more: further plots, each with its values, (curves, times).
        """
        if self.playing and monotonic() - self.sent < LONGEST_WAIT:
            return
        self.sent = monotonic()
        time = np.array([instant.time for instant in instants])
        kinetic, potential = np.array([instant.energy for instant in instants]).T
        total = kinetic + potential
        # The zero of potential energy is arbitrary.
        energies = [kinetic, potential - potential[0], total - total[0]]
        # A residual of zero has a logarithm too.
        residuals = np.log10([[max(instant.residual, 1e-20) for instant in instants]])
        # A plot is some hundred points wide.
        pick = np.unique(np.linspace(0, len(time) - 1, min(len(time), 1000)).astype(int))
        for plot, values in ((self.energy, energies), (self.residual, residuals), *more):
            plot.data = tuple(np.ascontiguousarray(row[pick], float) for row in (time, *values))

    def _switch(self, name: str, event: Any) -> None:
        setattr(self.stage, name, event.target.value)
        self.draw()

    def play(self, on: bool) -> None:
        """Play or pause."""
        self.playing = on
        self.pause.label = "Pause" if on else "Play"

    def _step(self) -> None:
        self.play(False)
        self.step()
        self.draw()

    def pass_time(self, seconds: float) -> None:
        """Advance by an interval of wall time, and draw."""
        with self.lock:
            if self.playing:
                self.advance(seconds * SPEEDS[self.speed.value])
                self.draw()

    def say(self, rows: Sequence[tuple[str, str]]) -> None:
        """Show the figures."""
        newtons, length = self.stage.newtons, ARROW * self.stage.extent
        rows = [*rows, ("arrow of " + f"{newtons:.3g} N", f"{length:.3g} m")]
        lines = "".join(
            f'<tr><td>{escape(name)}</td><td style="text-align:right">{escape(value)}</td></tr>'
            for name, value in rows
        )
        style = "width:calc(100% - 1.3em);margin:0 0.65em;font-size:0.8em;"
        style += "font-variant-numeric:tabular-nums"
        self.figures.content = f'<table style="{style}">{lines}</table>'

    @property
    @abstractmethod
    def seen(self) -> Instant:
        """The present instant of the first run."""

    @abstractmethod
    def advance(self, seconds: float) -> None:
        """Advance by an interval of simulated time."""

    @abstractmethod
    def step(self) -> None:
        """Advance by one step."""

    @abstractmethod
    def draw(self) -> None:
        """Draw the present instant."""


def figures_of(instant: Instant) -> list[tuple[str, str]]:
    """Return time, energy, contacts, residual and, where it is measured, the error as text."""
    kinetic, potential = instant.energy
    error = metres(instant.error) if math.isfinite(instant.error) else "not known"
    return [
        ("time", f"{instant.time:.3f} s"),
        ("kinetic energy", f"{kinetic:.4g} J"),
        ("potential energy", f"{potential:.4g} J"),
        ("total", f"{kinetic + potential:.4g} J"),
        ("contacts with force", f"{len(instant.places)}"),
        ("residual", f"{instant.residual:.1e} m/s"),
        *([] if math.isnan(instant.error) else [("estimated error", error)]),
    ]


class SimPanel(Panel):
    """Runs a copy of a Sim with sliders for its controls, and can go back in time."""

    def __init__(self, server: Any, sim: Any) -> None:
        judged = {} if getattr(sim, "_finer", None) is None else {"error_bar": True}
        self.sim = type(sim)(sim.model, **judged)
        self.begin = sim.state()
        self.sim.restore(self.begin)
        super().__init__(server, Stage(server, [drawing_of(sim.model, self.sim)]))
        self.failed = ""
        self.owed = 0.0
        self.states = [self.begin]
        self.times = [self.sim.time]
        self.past: list[Instant] = []
        reset = self.gui.add_button("Reset")
        reset.on_click(self._locked(lambda _: self.restart(None)))
        keys = {name or f"#{k}": k for k, name in enumerate(sim.model.key_names)}
        if keys:
            key = self.gui.add_dropdown("Keyframe", ("(start)", *keys))
            key.on_update(self._locked(lambda _: self.restart(keys.get(key.value))))
        self.back = self.gui.add_slider(
            "Back in time", 0.0, 1.0, 0.001, 1.0, hint="drag to go back"
        )
        self.back.on_update(self._locked(self._go_back))
        self.sliders = self._controls()
        self._overlays_and_curves()
        self.draw()
        self.stage.look([self.instant])

    @property
    def seen(self) -> Instant:
        return self.instant

    def _controls(self) -> list[Any]:
        model, sliders = self.sim.model, []
        if not model.nu:
            return []
        with self.gui.add_folder("Controls"):
            # A model of more actuators has no slider for the others.
            for k in range(min(model.nu, 40)):
                low, high = model.actuator_ctrlrange[k].tolist()
                now = float(self.sim.ctrl[k])
                low = low if np.isfinite(low) else min(-1.0, 2 * now)
                high = high if np.isfinite(high) else max(1.0, 2 * now)
                name = model.called("actuator")[k].replace("`", "")
                start = min(max(now, low), high)
                slider = self.gui.add_slider(name, low, high, (high - low) / 1000, start)
                slider.on_update(self._locked(partial(self._set, k)))
                sliders.append(slider)
        return sliders

    def _set(self, k: int, event: Any) -> None:
        # Only a person's hand has a client; values that the view sets have none.
        if event.client_id is not None:
            self.sim.ctrl[k] = self.sliders[k].value

    def restart(self, key: int | None) -> None:
        """Begin again, from the start of the view or a keyframe."""
        if key is None:
            self.sim.restore(self.begin)
        else:
            self.sim.reset(key=key)
        self.failed = ""
        self.states, self.times, self.past = [self.sim.state()], [self.sim.time], []
        self.stage.begin_again(poses_of(self.sim))
        for k, slider in enumerate(self.sliders):
            slider.value = min(max(float(self.sim.ctrl[k]), slider.min), slider.max)
        self.draw()

    def _go_back(self, event: Any) -> None:
        if event.client_id is None:
            return
        self.play(False)
        k = round(self.back.value * (len(self.states) - 1))
        ctrl = np.array(self.sim.ctrl)
        self.sim.restore(self.states[k])
        self.sim.ctrl[:] = ctrl
        self.failed = ""
        self.draw()

    def advance(self, seconds: float) -> None:
        dt = self.sim.settings.dt
        self.owed += seconds
        count = int(self.owed / dt + 1e-9)
        self.owed -= count * dt
        begin = monotonic()
        for _ in range(count):
            self.step()
            # The view still responds if the scene runs slower than real time.
            if self.failed or monotonic() - begin > LONGEST_WAIT:
                self.owed = 0.0
                return

    def step(self) -> None:
        if self.failed:
            return
        # The motion continues from here: the states after an earlier time are deleted.
        while len(self.times) > 1 and self.times[-1] > self.sim.time:
            self.times.pop()
            self.states.pop()
        while self.past and self.past[-1].time > self.sim.time:
            self.past.pop()
        try:
            self.sim.step()
        except (RuntimeError, ValueError) as error:
            self.failed = str(error)
            self.play(False)
            return
        if self.sim.time - self.times[-1] >= 1 / 60 - 1e-9:
            self.states.append(self.sim.state())
            self.times.append(self.sim.time)
            del self.states[:-KEPT_STATES], self.times[:-KEPT_STATES]

    def draw(self) -> None:
        try:
            self.instant = instant_of(self.sim)
        except (RuntimeError, ValueError) as error:
            self.failed = str(error)
            self.play(False)
        self.stage.show([self.instant])
        rows = figures_of(self.instant)
        if self.failed:
            rows.append(("failed", self.failed))
        self.say(rows)
        # The curves end here; later instants are kept.
        now = self.instant.time
        at = bisect_left(self.past, now, key=lambda instant: instant.time)
        if at == len(self.past) or self.past[at].time > now:
            self.past.insert(at, self.instant)
        self._draw_curves(self.past[: at + 1])
        del self.past[:-KEPT_STATES]
        if self.playing:
            self.back.value = 1.0


class RunPanel(Panel):
    """Plays recorded runs over each other."""

    def __init__(self, server: Any, runs: Sequence[Replayed]) -> None:
        self.runs = runs
        self.names = names = [run.label or f"run {k + 1}" for k, run in enumerate(runs)]
        others = [(name, TINTS[k % len(TINTS)]) for k, name in enumerate(names[1:])]
        if others:
            lines = [f"{escape(names[0])}: in its own colours"]
            lines += [f'<span style="color:{tint}">■</span> {escape(n)}' for n, tint in others]
            style = "margin:0 0.65em;font-size:0.8em"
            self.legend = server.gui.add_html(f'<div style="{style}">{"<br>".join(lines)}</div>')
        super().__init__(server, Stage(server, [run.drawing for run in runs]))
        self.gaps = [1000 * rms_distance(runs[0], run) for run in runs[1:]]
        self.times = [run.time for run in runs]
        self.begin, self.end = float(self.times[0][0]), max(float(t[-1]) for t in self.times)
        self.now = self.begin
        length = max(self.end - self.begin, 1e-9)
        self.slider = self.gui.add_slider("Time", 0.0, length, length / 5000, 0.0)
        self.slider.on_update(self._locked(self._go))
        span = self.begin, self.end
        self.apart = _plot(self.gui, "distance [mm]", others, span) if others else None
        self._overlays_and_curves(span)
        self.stage.look(runs[0].instants)
        self.draw()

    @property
    def seen(self) -> Instant:
        return self.runs[0].instants[self._at()[0]]

    def _at(self) -> list[int]:
        now = min(self.now, self.end) + 1e-9
        return [max(0, int(np.searchsorted(t, now, side="right")) - 1) for t in self.times]

    def _go(self, event: Any) -> None:
        if event.client_id is not None:
            self.play(False)
            self.now = self.begin + self.slider.value
            self.draw()

    def advance(self, seconds: float) -> None:
        self.now += seconds
        # The replay waits a second at the end, and begins again.
        if self.now > self.end + 1.0:
            self.now = self.begin

    def step(self) -> None:
        time = self.times[0]
        after = np.searchsorted(time, self.now + 1e-9, side="right")
        self.now = float(time[min(int(after), len(time) - 1)])

    def draw(self) -> None:
        now = min(self.now, self.end)
        at = self._at()
        instants = [run.instants[k] for run, k in zip(self.runs, at, strict=True)]
        self.stage.show(instants)
        rows = figures_of(instants[0])
        for name, gap in zip(self.names[1:], self.gaps, strict=True):
            # Nothing is compared after the end of the other run.
            apart = f"{gap[at[0]]:.3g} mm" if np.isfinite(gap[at[0]]) else "–"
            rows.append((f"distance of {name}", apart))
        self.say(rows)
        self.slider.value = min(max(0.0, now - self.begin), self.end - self.begin)
        # Curves end at the present time of the motion.
        end = at[0] + 1
        gaps = [(self.apart, [gap[:end] for gap in self.gaps])] if self.gaps else []
        self._draw_curves(self.runs[0].instants[:end], *gaps)
