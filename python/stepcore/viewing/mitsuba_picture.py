"""Pictures by Mitsuba 3 on the processor alone: no graphics card, driver or display is needed."""

from __future__ import annotations

import os
import tempfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stepcore.scene import frames
from stepcore.viewing.camera import ANGLE, Camera
from stepcore.viewing.drawing import Drawing, Shape
from stepcore.viewing.frames import Instant
from stepcore.viewing.marks import Mark
from stepcore.viewing.needs import need
from stepcore.viewing.primitives import surface_of

# Rays for each point of a picture.
SAMPLES = 9
# How often each of them asks for a light, of which one is chosen each time.
LIT = 6
SKY = (226, 233, 241)


class MitsubaPicture:
    """Draws instants of a drawing by ray tracing, in a second or less a picture."""

    name = "mitsuba"

    def __init__(self, drawing: Drawing, width: int, height: int) -> None:
        self.mi = mi = need("mitsuba", "a picture without MuJoCo's renderer", "video")
        mi.set_variant("scalar_rgb")
        self.drawing, self.size = drawing, (width, height)
        self.shapes = [(shape, self._group(shape)) for shape in drawing.shapes if shape.shown]

    def _group(self, shape: Shape) -> Any:
        """Return the shape in the frame of its body; each picture places it anew."""
        mi = self.mi
        vertices, faces = surface_of(shape, 20 * self.drawing.extent)
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
            material = self._material(shape)
            ply = {"type": "ply", "filename": path, "face_normals": True, "bsdf": material}
            return mi.load_dict({"type": "shapegroup", "shape": ply})

    def _material(self, shape: Shape) -> dict[str, Any]:
        colour = {"type": "rgb", "value": [_linear(c) for c in shape.rgba[:3]]}
        inner = {"type": "diffuse", "reflectance": colour}
        return {"type": "twosided", "material": inner}

    def draw(self, instant: Instant, camera: Camera, marks: list[Mark]) -> NDArray[np.uint8]:
        """Draw an instant; returns shape (height, width, 3)."""
        mi = self.mi
        scene: dict[str, Any] = {
            "type": "scene",
            "integrator": {"type": "direct", "emitter_samples": LIT, "bsdf_samples": 0},
            "lamp": _light((camera.target - camera.position).tolist(), 0.42),
            **self._lights(instant, camera),
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
            scene |= {f"mark{k}{part}": each for part, each in self._mark(mark).items()}
        image = mi.render(mi.load_dict(scene), spp=SAMPLES)
        drawn = np.array(mi.util.convert_to_bitmap(image, uint8_srgb=True))
        # Where nothing is, the sky.
        clear = 1 - np.clip(np.array(image)[..., 3:4], 0, 1)
        return np.clip(drawn[..., :3] + clear * SKY, 0, 255).astype(np.uint8)

    def _lights(self, instant: Instant, camera: Camera) -> dict[str, Any]:
        """Return the lights of the drawing, each as if it were far away, or a sun without them.

        A light that shines to all sides is aimed at the target of the camera.
        """
        lights = self.drawing.lights
        if not lights:
            return {"sun": _light([0.3, 0.4, -1.0], 0.45)}
        brightest = max(1.0, sum(max(light.diffuse) for light in lights))
        found = {}
        for k, light in enumerate(lights):
            turn = np.array(frames.matrix(instant.xquat[light.body].tolist()))
            way = turn @ light.dir
            if light.kind == "point":
                aside = camera.target - (instant.xpos[light.body] + turn @ light.pos)
                way = aside if np.linalg.norm(aside) > 0 else way
            strength = 0.65 * max(light.diffuse) / brightest
            found[f"light{k}"] = _light(way.tolist(), strength)
        return found

    def _camera(self, camera: Camera) -> dict[str, Any]:
        mi, (width, height) = self.mi, self.size
        film = {"type": "hdrfilm", "width": width, "height": height, "rfilter": _BOX}
        film["pixel_format"] = "rgba"
        look = mi.ScalarTransform4f().look_at(
            camera.position.tolist(), np.asarray(camera.target).tolist(), [0, 0, 1]
        )
        return {
            "type": "perspective",
            "fov": float(np.rad2deg(ANGLE)),
            "fov_axis": "y",
            "near_clip": 0.01 * self.drawing.extent,
            "far_clip": 100 * self.drawing.extent,
            "to_world": look,
            "film": film,
        }

    def _mark(self, mark: Mark) -> dict[str, Any]:
        """Return a mark as spheres and cylinders."""
        colour = {"type": "rgb", "value": [_linear(c) for c in mark.colour]}
        material = {"type": "twosided", "material": {"type": "diffuse", "reflectance": colour}}
        start, end = np.asarray(mark.start, float), np.asarray(mark.end, float)
        if mark.kind == "ball":
            return {"a": _round(start, mark.width, material)}
        parts = {"a": _rod(start, end, mark.width, material)}
        if mark.kind == "arrow":
            parts["b"] = _round(end, 2.2 * mark.width, material)
        return parts

    def close(self) -> None:
        """Do nothing: this renderer holds no resources."""


_BOX = {"type": "box"}


def _light(direction: list[float], strength: float) -> dict[str, Any]:
    irradiance = {"type": "rgb", "value": strength}
    return {"type": "directional", "direction": direction, "irradiance": irradiance}


def _round(at: NDArray[Any], radius: float, material: dict[str, Any]) -> dict[str, Any]:
    return {"type": "sphere", "center": at.tolist(), "radius": radius, "bsdf": material}


def _rod(
    start: NDArray[Any], end: NDArray[Any], r: float, material: dict[str, Any]
) -> dict[str, Any]:
    ends = {"p0": start.tolist(), "p1": end.tolist()}
    return {"type": "cylinder", "radius": r, "bsdf": material, **ends}


def _linear(c: float) -> float:
    """Return a colour of a file (sRGB) as linear light."""
    return c / 12.92 if c <= 0.04045 else ((min(c, 1.0) + 0.055) / 1.055) ** 2.4
