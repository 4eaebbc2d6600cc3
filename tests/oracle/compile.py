"""A scene turned into a `Model`."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import equalities
from .model import Model, Pair, Record
from .place import mass_matrix, place
from .rotation import Array, matrix, unit

# How many numbers of qpos and of qvel each kind of joint has.
WIDTH = {"free": (7, 6), "ball": (4, 3), "slide": (1, 1), "hinge": (1, 1)}
# Kinds of geoms; a pair's first geom is the one that comes first here.
ORDER = ["plane", "hfield", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh"]


def plain(scene: Any) -> Record:
    """The dict of a Scene, or the dict itself."""
    return scene if isinstance(scene, dict) else scene.to_dict()


def geom_mass(geom: Record) -> tuple[float, Array]:
    """Mass [kg] and inertia about the geom's own centre and axes [kg m^2], shape (3, 3)."""
    a, b, c = geom["size"]
    kind = geom["kind"]
    if geom["shell_inertia"]:
        raise ValueError(f"geom '{geom['name']}': the reference has no shell_inertia")
    if kind == "plane":
        return 0.0, np.zeros((3, 3))
    if kind == "sphere":
        volume, inertia = 4 / 3 * np.pi * a**3, 0.4 * np.full(3, a * a)
    elif kind == "box":
        volume = 8 * a * b * c
        inertia = np.array([b * b + c * c, a * a + c * c, a * a + b * b]) / 3
    elif kind == "ellipsoid":
        volume = 4 / 3 * np.pi * a * b * c
        inertia = np.array([b * b + c * c, a * a + c * c, a * a + b * b]) / 5
    elif kind == "cylinder":
        volume, across = 2 * np.pi * a * a * b, a * a / 4 + b * b / 3
        inertia = np.array([across, across, a * a / 2])
    else:
        raise ValueError(f"geom '{geom['name']}': the reference has no {kind}")
    mass = geom["density"] * volume if geom["mass"] is None else geom["mass"]
    return mass, mass * np.diag(inertia)


def compile_scene(scene: Any) -> Model:
    """Scene (or its dict) to Model."""
    scene = plain(scene)
    model = Model(scene, np.array(scene["gravity"], float))
    if not scene["features"]["gravity"]:
        model.gravity[:] = 0
    for geom in scene["geoms"]:
        if geom.get("mesh") is not None or geom.get("hfield") is not None:
            raise ValueError(f"geom '{geom['name']}': the reference has no meshes")
    for tendon in scene.get("tendons", ()):
        acts = ("range", "armature", "frictionloss")
        if any(tendon[field] for field in acts) or any(tendon["stiffness"] + tendon["damping"]):
            raise ValueError(f"tendon '{tendon['name']}': the reference has no tendons")
    lacks = {
        "fluid": scene["density"] > 0 or scene["viscosity"] > 0,
        "surfacevel": any(any(geom["surfacevel"]) for geom in scene["geoms"]),
        "adhesion": any(made["adhesion"] > 0 for made in (*scene["geoms"], *scene["pairs"])),
        "springdamper": any(all(joint["springdamper"]) for joint in scene["joints"]),
        "tendon": any(equality["kind"] == "tendon" for equality in scene["equalities"]),
    }
    for name, has in lacks.items():
        if has:
            raise ValueError(f"the reference has no {name}")
    number_joints(model)
    masses(model)
    check_actuators(model)
    model.actuator_bias = [servo_bias(model, actuator) for actuator in scene["actuators"]]
    model.pairs = candidate_pairs(model)
    model.frames = [equalities.frames(model, equality) for equality in scene["equalities"]]
    return model


def check_actuators(model: Model) -> None:
    """The reference has motors and servos of one control on joints, without activation."""
    for actuator in model.scene["actuators"]:
        kind = next(iter(actuator["target"]))
        muscle = actuator["muscle_gain"] or actuator["muscle_bias"]
        turns = kind == "joint" and model.joints[actuator["target"]["joint"]]["width"] > 1
        for what, there in {
            f"actuator on a {kind}": kind != "joint",
            "activation": actuator["dynamics"] != "none",
            "muscle": muscle is not None,
            "gain that varies": any(actuator["gain"][1:]),
            "servo on a ball or a free joint": turns and any(actuator["bias"][1:]),
            "damping or armature of an actuator": any(actuator["damping"]) or actuator["armature"],
            "actuator that is left out": not actuator["enabled"],
        }.items():
            if there:
                raise ValueError(f"actuator '{actuator['name']}': the reference has no {what}")
    for joint in model.scene["joints"]:
        if joint["actuatorfrcrange"] is not None:
            raise ValueError(f"joint '{joint['name']}': the reference has no actuatorfrcrange")


def servo_bias(model: Model, actuator: Record) -> Array:
    """An actuator's bias, its damping ratio turned into damping: 2 ratio sqrt(kp m)."""
    bias = np.array(actuator["bias"], float)
    if actuator["dampratio"]:
        row = np.zeros(model.nv)
        row[model.joints[actuator["target"]["joint"]]["dof"]] = actuator["gear"][0]
        M = mass_matrix(model, place(model, np.array(model.qpos0, float)))
        easy = row @ np.linalg.solve(M, row)
        bias[2] = -2 * actuator["dampratio"] * np.sqrt(-bias[1] / easy) if easy > 0 else 0.0
    return bias


def number_joints(model: Model) -> None:
    """Addresses in qpos and qvel, and which dof moves what."""
    bodies, joints = model.scene["bodies"], model.scene["joints"]
    for joint in joints:
        nq, nv = WIDTH[joint["kind"]]
        model.joints.append(dict(joint, qpos=model.nq, dof=model.nv, width=nv))
        model.nq, model.nv = model.nq + nq, model.nv + nv
        body = bodies[joint["body"]]
        rest = list(unit(body["quat"]))
        model.qpos0 += {
            "free": list(body["pos"]) + rest,
            "ball": [1.0, 0.0, 0.0, 0.0],
        }.get(joint["kind"], [joint["reference"]])
    nv = model.nv
    model.moves = np.zeros((len(bodies), nv), bool)
    model.carried_by = np.zeros((nv, nv), bool)
    model.angular = np.zeros(nv, bool)
    model.armature = np.zeros(nv)
    model.tree = np.zeros(nv, int)
    root = [0] * len(bodies)
    for b, body in enumerate(bodies[1:], 1):
        model.moves[b] = model.moves[body["parent"]]
        root[b] = root[body["parent"]]
        for joint in (j for j in model.joints if j["body"] == b):
            root[b] = root[b] or b
            own = np.arange(joint["dof"], joint["dof"] + joint["width"])
            turning = {"free": own[3:], "slide": own[:0]}.get(joint["kind"], own)
            model.angular[turning] = True
            model.carried_by[own] = model.moves[b]
            model.moves[b, own] = True
            if joint["kind"] in ("free", "ball"):
                # These axes turn with the body itself; a free joint's first three never turn.
                model.carried_by[turning] = model.moves[b]
                model.carried_by[own[: own.size - 3]] = False
            model.armature[own] = joint["armature"]
            model.tree[own] = root[b]
    model.root = root


def masses(model: Model) -> None:
    """Mass, centre and inertia of each body: as given, or the sum over its geoms."""
    scene = model.scene
    rules = scene["mass_rules"]
    for name in ("bound_mass", "bound_inertia", "balance_inertia"):
        if rules[name]:
            raise ValueError(f"mass_rules: the reference has no {name} (here {rules[name]})")
    rule, (low, high) = rules["from_geoms"], rules["group_range"]
    n = len(scene["bodies"])
    model.mass, model.ipos, model.inertia = np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3, 3))
    model.tree_mass = {}
    for b, body in enumerate(scene["bodies"][1:], 1):
        given = body["inertial"]
        if rule is True or (given is None and rule is None):
            mine = [g for g in scene["geoms"] if g["body"] == b and low <= g["group"] <= high]
            sum_geoms(model, b, mine)
        if given is not None and model.mass[b] == 0:
            xx, yy, zz, xy, xz, yz = given["inertia"]
            model.mass[b], model.ipos[b] = given["mass"], given["pos"]
            model.inertia[b] = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    if rules["total_mass"] > 0 and model.mass.any():
        scale = rules["total_mass"] / model.mass.sum()
        model.mass *= scale
        model.inertia *= scale
    for tree, mass in zip(model.root, model.mass, strict=True):
        model.tree_mass[tree] = model.tree_mass.get(tree, 0.0) + mass


def sum_geoms(model: Model, b: int, geoms: list[Record]) -> None:
    """Mass properties of a body out of its geoms, by the parallel axis theorem."""
    parts = [(*geom_mass(g), np.array(g["pos"], float), g["quat"]) for g in geoms]
    total = sum(mass for mass, *_ in parts)
    if total == 0:
        return
    centre = sum(mass * pos for mass, _, pos, _ in parts) / total
    model.mass[b], model.ipos[b] = total, centre
    for mass, inertia, pos, quat in parts:
        turn, arm = matrix(unit(quat)), pos - centre
        model.inertia[b] += turn @ inertia @ turn.T
        model.inertia[b] += mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))


def candidate_pairs(model: Model) -> list[Pair]:
    """Pairs of geoms that may collide, by MuJoCo's rules and in its order: bodies, then geoms.

    Explicit pairs come first among those of their bodies.
    """
    scene = model.scene
    if scene["contact_override"]:
        raise ValueError("contact_override: the reference has none")
    bodies, geoms, on = scene["bodies"], scene["geoms"], scene["features"]
    weld = list(range(len(bodies)))  # the nearest ancestor with a joint, itself included
    for b in range(1, len(bodies)):
        if not any(j["body"] == b for j in scene["joints"]):
            weld[b] = weld[bodies[b]["parent"]]
    above = [weld[bodies[w]["parent"]] for w in weld]
    excluded = {frozenset(pair) for pair in scene["excludes"]}
    found = []
    for i, first in enumerate(geoms):
        for j in range(i + 1, len(geoms)):
            second = geoms[j]
            b1, b2 = first["body"], second["body"]
            w1, w2 = weld[b1], weld[b2]
            related = w1 and w2 and (above[b1] == w2 or above[b2] == w1)
            wanted = (first["contype"] & second["conaffinity"]) or (
                second["contype"] & first["conaffinity"]
            )
            if w1 == w2 or not wanted or frozenset((b1, b2)) in excluded:
                continue
            if related and on["filterparent"]:
                continue
            swap = ORDER.index(first["kind"]) > ORDER.index(second["kind"])
            found.append((b1, b2, 1, *((j, i) if swap else (i, j))))
    named = {frozenset((pair["geom1"], pair["geom2"])) for pair in scene["pairs"]}
    found = [entry for entry in found if frozenset(entry[3:]) not in named]
    by_rank: dict[tuple[int, ...], Pair] = {
        entry: mix(geoms, entry[3], entry[4]) for entry in found
    }
    for n, pair in enumerate(scene["pairs"]):
        i, j = sorted((pair["geom1"], pair["geom2"]), key=lambda g: (geoms[g]["body"], g))
        b1, b2 = geoms[i]["body"], geoms[j]["body"]
        if weld[b1] != weld[b2]:
            if ORDER.index(geoms[i]["kind"]) > ORDER.index(geoms[j]["kind"]):
                i, j = j, i
            by_rank[b1, b2, 0, n] = explicit(pair, i, j)
    return [by_rank[rank] for rank in sorted(by_rank)]


def explicit(pair: Record, i: int, j: int) -> Pair:
    """An explicit pair of geoms, ordered, with its own parameters."""
    return Pair(i, j, tuple(pair["friction"])[: pair["condim"] - 1])


def mix(geoms: list[Record], i: int, j: int) -> Pair:
    """What two geoms agree on: the higher priority decides, else the larger value."""
    a, b = geoms[i], geoms[j]
    if a["priority"] != b["priority"]:
        a = b = a if a["priority"] > b["priority"] else b
    slide, torsion, roll = (max(both) for both in zip(a["friction"], b["friction"], strict=True))
    condim = max(a["condim"], b["condim"])
    return Pair(i, j, (slide, slide, torsion, roll, roll)[: condim - 1])
