"""MuJoCo's renderer, for pictures and videos: OpenGL, on a graphics card or on the processor."""

from __future__ import annotations

import importlib
import os
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore import checks
from stepcore.needs import need
from stepcore.report.plot.style import SKY, rgb
from stepcore.viewing.camera import ANGLE, LARGEST_SIDE, Camera, Mark
from stepcore.viewing.drawing import Drawing, Shape
from stepcore.viewing.frames import Instant

ADVICE = (
    "On Debian and Ubuntu `apt-get install libegl1 libgl1-mesa-dri` brings a renderer that needs "
    "no graphics card; a page (`save_html`) needs none of this"
)


class Renderer:
    """Draw instants of a drawing, from a camera, with marks; see `stepcore.viewing.camera`.

    MuJoCo draws a model that holds the shapes. On Linux without a display it uses EGL, unless the
    environment variable MUJOCO_GL selects another platform.

    Raises ValueError for sizes outside their limits, ImportError without mujoco, and RuntimeError
    if OpenGL does not work.
    """

    def __init__(self, drawing: Drawing, width: int, height: int) -> None:
        for field, value in (("width", width), ("height", height)):
            checks.whole(2, LARGEST_SIDE)("picture", field, value)
        mujoco = need("mujoco", "MuJoCo's renderer", "video")
        self.mujoco, self.drawing = mujoco, drawing
        self.model = self._model(width, height)
        self.data = mujoco.MjData(self.model)
        try:
            if sys.platform == "linux" and not any(map(os.environ.get, ("DISPLAY", "MUJOCO_GL"))):
                # MuJoCo reads MUJOCO_GL when it is imported, which may be long ago.
                context: Any = importlib.import_module("mujoco.rendering.classic.gl_context")
                context.GLContext = importlib.import_module("mujoco.egl").GLContext
            self.renderer = mujoco.Renderer(self.model, height, width, max_geom=20_000)
        except Exception as error:
            raise RuntimeError(f"OpenGL does not work here: {error}. {ADVICE}") from None

    def _model(self, width: int, height: int) -> Any:
        mujoco, drawing = self.mujoco, self.drawing
        spec = mujoco.MjSpec()
        look = spec.visual
        look.global_.offwidth, look.global_.offheight = width, height
        look.global_.fovy = ANGLE
        look.headlight.ambient, look.headlight.diffuse = [0.35] * 3, [0.45] * 3
        look.headlight.specular = [0.1] * 3
        spec.stat.extent, spec.stat.center = drawing.extent, [0, 0, 0]
        look.map.znear, look.map.zfar = 0.01, 100
        spec.add_texture(
            name="sky",
            type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
            rgb1=rgb(SKY[0]),
            rgb2=rgb(SKY[1]),
            width=64,
            height=384,
        )
        bodies = [
            spec.worldbody.add_body(name=f"body{k}", mocap=True) for k in range(len(drawing.bodies))
        ]
        spec.worldbody.add_light(
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            dir=(0.3, 0.4, -1.0),
            diffuse=[0.4] * 3,
            castshadow=False,
        )
        for k, shape in enumerate(drawing.shapes):
            if shape.shown:
                self._add(spec, bodies[shape.body], shape, k)
        return spec.compile()

    def _add(self, spec: Any, body: Any, shape: Shape, k: int) -> None:
        mujoco = self.mujoco
        kind = "mesh" if shape.surface is not None else shape.kind
        fields: dict[str, Any] = {"size": [*shape.size, 0, 0, 0][:3], "rgba": shape.rgba}
        if shape.surface is not None:
            vertices, faces = shape.surface
            mesh = spec.add_mesh(name=f"mesh{k}")
            mesh.uservert = np.asarray(vertices, float).ravel()
            mesh.userface = np.asarray(faces, np.int32).ravel()
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            fields = {"meshname": mesh.name, "rgba": shape.rgba}
        if shape.kind == "plane":
            # The third is the spacing of its grid, which MuJoCo wants above 0.
            fields["size"][2] = fields["size"][2] or 1.0
            fields |= {"rgba": [1, 1, 1, 1], "material": self._squares(spec, shape, k)}
        body.add_geom(
            type=getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}"),
            pos=shape.pos,
            quat=shape.quat,
            contype=0,
            conaffinity=0,
            group=0,
            **fields,
        )

    def _squares(self, spec: Any, shape: Shape, k: int) -> str:
        """Add a checker material, which makes motion over a plane visible."""
        mujoco = self.mujoco
        first, other = (rgba[:3] for rgba in shape.checks)
        texture = spec.add_texture(
            name=f"squares{k}",
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
            rgb1=first,
            rgb2=other,
            width=256,
            height=256,
        )
        material = spec.add_material(name=f"squares{k}", texuniform=True)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture.name
        material.texrepeat = [0.5 / self.drawing.cell] * 2
        return str(material.name)

    def draw(self, instant: Instant, camera: Camera, marks: list[Mark]) -> NDArray[np.uint8]:
        """Draw an instant; returns shape (height, width, 3)."""
        mujoco = self.mujoco
        self.data.mocap_pos[:], self.data.mocap_quat[:] = instant.xpos, instant.xquat
        mujoco.mj_forward(self.model, self.data)
        view = mujoco.MjvCamera()
        view.lookat, view.distance = camera.target, camera.far
        view.azimuth = np.rad2deg(camera.turn) + 180.0
        view.elevation = -np.rad2deg(camera.lift)
        self.renderer.update_scene(self.data, view)
        room = self.renderer.scene.maxgeom - self.renderer.scene.ngeom
        for mark in marks[:room]:
            self._mark(mark)
        picture: NDArray[np.uint8] = self.renderer.render()
        return picture

    def _mark(self, mark: Mark) -> None:
        mujoco, scene = self.mujoco, self.renderer.scene
        geom = scene.geoms[scene.ngeom]
        kinds = {"ball": "SPHERE", "arrow": "ARROW", "rod": "CAPSULE"}
        kind = getattr(mujoco.mjtGeom, f"mjGEOM_{kinds[mark.kind]}")
        rgba = np.array([*mark.colour, 1.0], np.float32)
        size, place = np.full(3, mark.width), np.asarray(mark.start, float)
        mujoco.mjv_initGeom(geom, kind, size, place, np.eye(3).ravel(), rgba)
        if mark.kind != "ball":
            # MuJoCo's arrows are drawn at half the length of their connector.
            far = 2.0 if mark.kind == "arrow" else 1.0
            end = place + far * (np.asarray(mark.end, float) - place)
            mujoco.mjv_connector(geom, kind, mark.width, place, end)
        geom.emission = 0.4
        scene.ngeom += 1

    def close(self) -> None:
        """Free the renderer."""
        self.renderer.close()
