"""Pictures by MuJoCo's renderer, from a MuJoCo model that holds the shapes of a drawing."""

from __future__ import annotations

import os
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore.mjcf.appearance import Light
from stepcore.viewing.camera import ANGLE, Camera
from stepcore.viewing.drawing import Drawing, Shape
from stepcore.viewing.frames import Instant
from stepcore.viewing.marks import Mark
from stepcore.viewing.needs import need

# Of a drawing without lights.
SUN = Light(0, (0.0, 0.0, 5.0), (0.3, 0.4, -1.0), (0.4, 0.4, 0.4), "directional", 45.0)


class MujocoPicture:
    """Draws instants of a drawing with OpenGL: EGL where there is no display, else a window's.

    Raises ImportError without mujoco, and RuntimeError where OpenGL does not work.
    """

    name = "mujoco"

    def __init__(self, drawing: Drawing, width: int, height: int) -> None:
        if sys.platform == "linux" and not os.environ.get("DISPLAY"):
            # MuJoCo reads it when its renderer is first imported.
            os.environ.setdefault("MUJOCO_GL", "egl")
        mujoco = need("mujoco", "MuJoCo's renderer", "video")
        self.mujoco, self.drawing = mujoco, drawing
        self.model = self._model(width, height)
        self.data = mujoco.MjData(self.model)
        try:
            self.renderer = mujoco.Renderer(self.model, height, width, max_geom=20_000)
        except Exception as error:
            raise RuntimeError(f"OpenGL does not work here: {error}") from None

    def _model(self, width: int, height: int) -> Any:
        mujoco, extent = self.mujoco, self.drawing.extent
        spec = mujoco.MjSpec()
        look = spec.visual
        look.global_.offwidth, look.global_.offheight = width, height
        look.global_.fovy = float(np.rad2deg(ANGLE))
        look.headlight.ambient, look.headlight.diffuse = [0.35] * 3, [0.45] * 3
        if self.drawing.lights:
            look.headlight.diffuse = self.drawing.headlight.diffuse
            look.headlight.ambient = np.maximum(self.drawing.headlight.ambient, 0.25)
        look.headlight.specular = [0.1] * 3
        spec.stat.extent, spec.stat.center = extent, [0, 0, 0]
        look.map.znear, look.map.zfar = 0.01, 100
        spec.add_texture(
            name="sky",
            type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
            rgb1=[0.93, 0.95, 0.98],
            rgb2=[0.82, 0.87, 0.93],
            width=64,
            height=384,
        )
        bodies = [
            spec.worldbody.add_body(name=f"body{k}", mocap=True)
            for k in range(len(self.drawing.bodies))
        ]
        for light in self.drawing.lights or [SUN]:
            # MuJoCo's renderer passes by lights of type "point"; a spot of 180 degrees is one.
            wide = light.kind == "point"
            kind = "SPOT" if wide else light.kind.upper()
            bodies[light.body].add_light(
                type=getattr(mujoco.mjtLightType, f"mjLIGHT_{kind}"),
                pos=light.pos,
                dir=light.dir,
                diffuse=light.diffuse,
                cutoff=180.0 if wide else light.cutoff,
                castshadow=False,
            )
        for k, shape in enumerate(self.drawing.shapes):
            if shape.shown:
                self._add(spec, bodies[shape.body], shape, k)
        return spec.compile()

    def _add(self, spec: Any, body: Any, shape: Shape, k: int) -> None:
        mujoco = self.mujoco
        kind = "mesh" if shape.surface is not None else shape.kind
        own: dict[str, Any] = {"size": [*shape.size, 0, 0, 0][:3]}
        if shape.surface is not None:
            vertices, faces = shape.surface
            mesh = spec.add_mesh(name=f"mesh{k}")
            mesh.uservert = np.asarray(vertices, float).ravel()
            mesh.userface = np.asarray(faces, np.int32).ravel()
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            own = {"meshname": mesh.name}
        if shape.kind == "plane":
            # The third is the spacing of its grid, which MuJoCo wants above 0.
            own["size"][2] = own["size"][2] or 1.0
            own["material"] = self._squares(spec, shape, k)
        body.add_geom(
            type=getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}"),
            pos=shape.pos,
            quat=shape.quat,
            rgba=[1, 1, 1, 1] if shape.kind == "plane" else shape.rgba,
            contype=0,
            conaffinity=0,
            group=0,
            **own,
        )

    def _squares(self, spec: Any, shape: Shape, k: int) -> str:
        """Add a checker material, which makes motion over a plane visible."""
        mujoco = self.mujoco
        one, other = (rgba[:3] for rgba in shape.checks)
        texture = spec.add_texture(
            name=f"squares{k}",
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
            rgb1=one,
            rgb2=other,
            width=256,
            height=256,
        )
        tile = float(2.0 ** np.round(np.log2(self.drawing.extent / 2)))
        material = spec.add_material(name=f"squares{k}", texuniform=True)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture.name
        material.texrepeat = [0.5 / tile, 0.5 / tile]
        return str(material.name)

    def draw(self, instant: Instant, camera: Camera, marks: list[Mark]) -> NDArray[np.uint8]:
        """Draw an instant; returns shape (height, width, 3)."""
        mujoco = self.mujoco
        self.data.mocap_pos[:], self.data.mocap_quat[:] = instant.xpos, instant.xquat
        mujoco.mj_forward(self.model, self.data)
        own = mujoco.MjvCamera()
        own.lookat, own.distance = camera.target, camera.far
        own.azimuth = np.rad2deg(camera.turn) + 180.0
        own.elevation = -np.rad2deg(camera.lift)
        self.renderer.update_scene(self.data, own)
        for mark in marks:
            self._mark(mark)
        picture: NDArray[np.uint8] = self.renderer.render()
        return picture

    def _mark(self, mark: Mark) -> None:
        mujoco, scene = self.mujoco, self.renderer.scene
        if scene.ngeom >= scene.maxgeom:
            return
        geom, width = scene.geoms[scene.ngeom], mark.width
        kinds = {"ball": "SPHERE", "arrow": "ARROW", "rod": "CAPSULE"}
        kind = getattr(mujoco.mjtGeom, f"mjGEOM_{kinds[mark.kind]}")
        rgba = np.array([*mark.colour, 1.0], np.float32)
        size, place = np.full(3, width), np.asarray(mark.start, float)
        mujoco.mjv_initGeom(geom, kind, size, place, np.eye(3).ravel(), rgba)
        if mark.kind != "ball":
            way = np.asarray(mark.end, float) - place
            # MuJoCo's arrows are drawn at half the length of their connector.
            far = 2.0 if mark.kind == "arrow" else 1.0
            mujoco.mjv_connector(geom, kind, width, place, place + far * way)
        geom.emission = 0.4
        scene.ngeom += 1

    def close(self) -> None:
        """Free the renderer."""
        self.renderer.close()
