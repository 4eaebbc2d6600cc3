"""`Scene`: the model to simulate, built by hand or read from MJCF by `stepcore.load`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from stepcore import checks
from stepcore.scene import length_ranges
from stepcore.scene.consistency import check
from stepcore.scene.contents import Contents
from stepcore.scene.elements import Element
from stepcore.scene.layout import Layout
from stepcore.scene.records import essence, plain

if TYPE_CHECKING:
    import os

    from stepcore.engine.model import Model
    from stepcore.engine.sim import Sim
    from stepcore.viewing.live import View


class Scene(Contents):
    """A description of bodies, joints, geoms and forces, in SI units.

    gravity: acceleration [m/s²], shape (3,).
    name: any text.

    The ``add_…`` methods add elements in any order. Elements refer to each other by name or by the
    object that ``add_…`` returned. Their fields can be read and assigned. Names, defaults and
    conventions are MuJoCo's; `Body`, `Joint`, `Geom`, `Mesh`, `HField`, `Site`, `Tendon`,
    `Actuator`, `Equality`, `Pair` and `Key` document the fields with their units.

    Every assignment is checked. A bad value raises a ValueError that names the element, the field,
    the value and the limit. An unknown name raises a ValueError that lists the nearest names.

    bodies, joints, geoms, meshes, hfields, sites, tendons, sensors, actuators, equalities, pairs,
        keys: lists of the elements; ``bodies[0]`` is the world.
    excludes: pairs of bodies that do not collide, except for geoms in `pairs`.
    contact_override: contact parameters that replace the parameters of every contact
        (`ContactOverride`).
    mass_rules: how body masses follow from geoms (`MassRules`: MJCF's ``<compiler>``).
    lengthrange: how `compile` finds the length range of muscles that do not give a range
        (`LengthRange`: MJCF's ``<lengthrange>``); `compile` runs a simulation for this.
    features: the physical effects that the model includes (`Features`: MJCF's ``<flag>``).
    options: the fields of `Settings` that the scene sets; see `settings`.
    ignored: elements of the file that cannot change the motion, one line each.
    notes: translations made by the reader, one line each.
    without: kinds of elements that were left out of the file on purpose, with their number; see
        `stepcore.load`.
    fused: name of each body of the file that the reader merged into another body (fixed links of a
        URDF, MJCF's ``fusestatic``), with the name of that other body; see `stepcore.load`.

    >>> scene = Scene()
    >>> ball = scene.add_body("ball", pos=(0, 0, 1))
    >>> _ = scene.add_joint(ball, "free")
    >>> _ = scene.add_geom(ball, "sphere", 0.1, mass=1.0)
    >>> _ = scene.add_geom("world", "plane", name="floor")
    >>> scene
    <Scene: 1 body, 1 joint (nq 7, nv 6), 2 geoms>
    """

    def compile(self) -> Model:
        """Compile the scene to a `Model`.

        Raises ValueError for a scene that cannot be compiled, and names the element. Raises
        ValueError if the model and one world do not fit into memory, and names the largest demand.
        """
        from stepcore.engine.model import Model

        return Model(self)

    def view(self, *, host: str = "localhost", port: int = 8080, wait: bool | None = None) -> View:
        """Open a live view of the scene, from its first keyframe; see `Sim.view`.

        Raises the errors of `compile`.
        """
        return self._begun().view(host=host, port=port, wait=wait)

    def _begun(self) -> Sim:
        """Return a `Sim` of the scene, at the first keyframe if the scene has one."""
        from stepcore.engine.sim import Sim

        sim = Sim(self)
        if sim.model.keys:
            sim.reset(key=0)
        return sim

    def to_dict(self) -> dict[str, Any]:
        """Return the scene as plain data for the engine, with indices for references.

        Raises ValueError for errors that need the whole scene to be detected: a range on a free
        joint, a plane on a moving body, a key of the wrong length, a name used twice.
        """
        layout = Layout(self)
        check(layout)
        data = plain(layout)
        length_ranges.fill(self, data)
        return data

    def to_mjcf(self) -> str:
        """Return the scene, with its settings, as an MJCF text.

        Angles are in radians, numbers are exact and defaults are left out. Settings that MJCF lacks
        are written to ``<custom>``, which `stepcore.loads` reads: ``loads(scene.to_mjcf()) ==
        scene``. Elements of the scene's file that only draw or sense are not written; a comment
        counts them.

        Raises ValueError for a scene that MJCF cannot express: a scene that cannot be compiled, a
        world with a mass or another name, a name with control characters.

        >>> scene = Scene(gravity=(0, 0, -1.62))
        >>> ball = scene.add_body("ball", pos=(0, 0, 1))
        >>> _ = scene.add_joint(ball, "free")
        >>> _ = scene.add_geom(ball, "sphere", 0.1)
        >>> scene.options["integrator"] = "midpoint"
        >>> print(scene.to_mjcf())
        <mujoco>
          <compiler angle="radian"/>
          <option gravity="0 0 -1.62"/>
          <worldbody>
            <body name="ball" pos="0 0 1">
              <joint type="free"/>
              <geom size="0.1"/>
            </body>
          </worldbody>
          <custom>
            <text name="stepcore" data="integrator=midpoint"/>
          </custom>
        </mujoco>
        <BLANKLINE>
        """
        from stepcore.mjcf.writer import written

        return written(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the scene to an MJCF file, so that ``load(path) == scene``.

        A scene that was read from a file, and whose settings or name alone have changed, keeps the
        file's own text with includes, comments and meshes; only ``<option>``, ``<flag>`` and
        ``<custom>`` are edited. (If the text names other files, `path` must be in their folder.)
        Every other scene is written as by `to_mjcf`.

        Raises the errors of `to_mjcf`, and OSError.
        """
        from stepcore.mjcf.source_edit import save

        save(self, path)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Scene):
            return NotImplemented
        if self.options != other.options:
            from stepcore._core import Settings

            default = Settings().as_dict()
            if default | self.options != default | other.options:
                return False
        return essence(Layout(self)) == essence(Layout(other))

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        layout = Layout(self)
        counts = [(len(self.bodies) - 1, "body", ""), (len(self.joints), "joint", "")]
        if self.joints:
            counts[1] = (len(self.joints), "joint", f" (nq {layout.nq}, nv {layout.nv})")
        rest: dict[str, Sequence[Element]] = {
            "geom": self.geoms,
            "mesh": self.meshes,
            "hfield": self.hfields,
            "site": self.sites,
            "tendon": self.tendons,
            "sensor": self.sensors,
            "actuator": self.actuators,
            "equality": self.equalities,
            "pair": self.pairs,
            "key": self.keys,
        }
        counts += [(len(elements), word, "") for word, elements in rest.items() if elements]
        # Imported here because only printing needs it.
        from stepcore.report.units import counted

        parts = [f"{counted(n, word)}{more}" for n, word, more in counts]
        options = [f"{key}={value!r}" for key, value in self.options.items()]
        name = f" {checks.quoted(self.name)}" if self.name else ""
        return f"<Scene{name}: {', '.join(parts)}{'; ' + ', '.join(options) if options else ''}>"

    def _repr_html_(self) -> str | None:
        """Return HTML for a notebook, with a picture of the scene if a picture can be drawn."""
        from stepcore.viewing.notebook import shown

        return shown(self, len(self.geoms), self._begun)
