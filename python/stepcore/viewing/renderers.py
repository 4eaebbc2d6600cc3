"""The renderers of pictures: MuJoCo's, with OpenGL, and Mitsuba, on the processor alone.

Both draw the shapes of a drawing, from a camera, with marks; see `stepcore.viewing.camera`.
"""

from __future__ import annotations

import os
import sys
import tempfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore import checks
from stepcore.report.plot.style import SKY, rgb
from stepcore.scene import frames
from stepcore.viewing.camera import ANGLE, LARGEST, Camera, Mark
from stepcore.viewing.drawing import Drawing, Shape
from stepcore.viewing.frames import Instant
from stepcore.viewing.needs import need

# The direction in which the sun of a picture shines.
SUN = (0.3, 0.4, -1.0)


class MujocoPicture:
    """Draws instants of a drawing with OpenGL: EGL where there is no display, else a window's.

    MuJoCo draws a model that holds the shapes. Raises ImportError without mujoco, and RuntimeError
    where OpenGL does not work.
    """

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
            dir=SUN,
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
        own: dict[str, Any] = {"size": [*shape.size, 0, 0, 0][:3], "rgba": shape.rgba}
        if shape.surface is not None:
            vertices, faces = shape.surface
            mesh = spec.add_mesh(name=f"mesh{k}")
            mesh.uservert = np.asarray(vertices, float).ravel()
            mesh.userface = np.asarray(faces, np.int32).ravel()
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
            own = {"meshname": mesh.name, "rgba": shape.rgba}
        if shape.kind == "plane":
            # The third is the spacing of its grid, which MuJoCo wants above 0.
            own["size"][2] = own["size"][2] or 1.0
            own |= {"rgba": [1, 1, 1, 1], "material": self._squares(spec, shape, k)}
        body.add_geom(
            type=getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}"),
            pos=shape.pos,
            quat=shape.quat,
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
        material = spec.add_material(name=f"squares{k}", texuniform=True)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture.name
        material.texrepeat = [0.5 / self.drawing.cell] * 2
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


class MitsubaPicture:
    """Draws instants of a drawing by ray tracing, in a second or less a picture."""

    def __init__(self, drawing: Drawing, width: int, height: int) -> None:
        self.mi = need("mitsuba", "a picture without MuJoCo's renderer", "video")
        self.mi.set_variant("scalar_rgb")
        self.drawing, self.size = drawing, (width, height)
        self.shapes = [(shape, self._group(shape)) for shape in drawing.shapes if shape.shown]

    def _group(self, shape: Shape) -> Any:
        """Return the shape in the frame of its body; each picture places it anew."""
        mi = self.mi
        vertices, faces = shape.triangles(self.drawing.reach)
        vertices = vertices @ np.array(frames.matrix(shape.quat)).T + shape.pos
        # Sides that share no corner are lit as sides.
        corners = vertices[np.asarray(faces)].reshape(-1, 3)
        mesh = mi.Mesh("shape", len(corners), len(faces))
        values = mi.traverse(mesh)
        values["vertex_positions"] = np.asarray(corners, np.float32).ravel()
        values["faces"] = np.arange(len(corners), dtype=np.uint32)
        values.update()
        with tempfile.TemporaryDirectory() as folder:
            # The one way in which a mesh gets its material.
            path = os.path.join(folder, "shape.ply")
            mesh.write_ply(path)
            own = {"face_normals": True, "bsdf": _diffuse(shape.rgba)}
            ply = {"type": "ply", "filename": path, **own}
            return mi.load_dict({"type": "shapegroup", "shape": ply})

    def draw(self, instant: Instant, camera: Camera, marks: list[Mark]) -> NDArray[np.uint8]:
        """Draw an instant; returns shape (height, width, 3)."""
        mi = self.mi
        scene: dict[str, Any] = {
            "type": "scene",
            # Each ray asks for a light six times, and takes one of them each time.
            "integrator": {"type": "direct", "emitter_samples": 6, "bsdf_samples": 0},
            "lamp": _light(camera.target - camera.position, 0.42),
            "sun": _light(SUN, 0.45),
            "camera": self._camera(camera),
        }
        for k, (shape, group) in enumerate(self.shapes):
            pose = np.eye(4)
            pose[:3, :3] = frames.matrix(instant.xquat[shape.body].tolist())
            pose[:3, 3] = instant.xpos[shape.body]
            place = mi.ScalarTransform4f(pose)
            # A scene finds the groups of its instances among its own things.
            scene[f"group{k}"] = group
            scene[f"shape{k}"] = {"type": "instance", "group": group, "to_world": place}
        for k, mark in enumerate(marks):
            scene |= {f"mark{k}{part}": each for part, each in enumerate(_parts(mark))}
        image = mi.render(mi.load_dict(scene), spp=9)
        drawn = np.array(mi.util.convert_to_bitmap(image, uint8_srgb=True))
        # Where nothing is, the sky.
        clear = 1 - np.clip(np.array(image)[..., 3:4], 0, 1)
        sky = 255 * np.mean([rgb(colour) for colour in SKY], axis=0)
        return np.clip(drawn[..., :3] + clear * sky, 0, 255).astype(np.uint8)

    def _camera(self, camera: Camera) -> dict[str, Any]:
        width, height = self.size
        look = self.mi.ScalarTransform4f().look_at(
            camera.position.tolist(), np.asarray(camera.target).tolist(), [0, 0, 1]
        )
        film = {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgba"}
        return {
            "type": "perspective",
            "fov": ANGLE,
            "fov_axis": "y",
            "near_clip": 0.01 * self.drawing.extent,
            "far_clip": 100 * self.drawing.extent,
            "to_world": look,
            "film": {**film, "rfilter": {"type": "box"}},
        }

    def close(self) -> None:
        """Do nothing: this renderer holds no resources."""


def _light(direction: Any, strength: float) -> dict[str, Any]:
    irradiance = {"type": "rgb", "value": strength}
    way = np.asarray(direction).tolist()
    return {"type": "directional", "direction": way, "irradiance": irradiance}


def _parts(mark: Mark) -> list[dict[str, Any]]:
    """Return the spheres and cylinders of a mark."""
    start, end = (np.asarray(each, float).tolist() for each in (mark.start, mark.end))
    radius = 2.2 * mark.width if mark.kind == "arrow" else mark.width
    own = {"bsdf": _diffuse(mark.colour)}
    ball = {"type": "sphere", "center": end, "radius": radius, **own}
    rod = {"type": "cylinder", "p0": start, "p1": end, "radius": mark.width, **own}
    return {"ball": [ball], "rod": [rod], "arrow": [rod, ball]}[mark.kind]


def _diffuse(colour: Any) -> dict[str, Any]:
    """Return the material of a colour (sRGB), which Mitsuba takes as linear light."""
    c = np.minimum(colour[:3], 1.0)
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    reflectance = {"type": "rgb", "value": linear.tolist()}
    return {"type": "twosided", "material": {"type": "diffuse", "reflectance": reflectance}}


RENDERERS = {"mujoco": MujocoPicture, "mitsuba": MitsubaPicture}


def renderer_of(drawing: Drawing, width: int, height: int, name: str | None = None) -> Any:
    """Return the renderer of this name, or the first that works."""
    for field, value in (("width", width), ("height", height)):
        checks.whole(2, LARGEST)("picture", field, value)
    checks.one_of(None, *RENDERERS)("picture", "renderer", name)
    if name is not None:
        return RENDERERS[name](drawing, width, height)
    try:
        return MujocoPicture(drawing, width, height)
    except (ImportError, RuntimeError, ValueError):
        return MitsubaPicture(drawing, width, height)
