"""The scenes of the benches, as MJCF text that both engines read."""

from __future__ import annotations

import numpy as np

from stepcore.loading import find_asset

FLOOR = '<geom name="floor" type="plane" size="5 5 .1"/>'
GYM = (
    "inverted_pendulum",
    "inverted_double_pendulum",
    "reacher",
    "hopper",
    "walker2d",
    "half_cheetah",
    "ant",
)


def gym_path(name: str) -> str:
    """The MJCF file of a gymnasium model."""
    return str(find_asset("gymnasium", name))


def spring() -> str:
    """A mass of 1 kg on a spring of 100 N/m, no gravity, drawn out by 0.1 m."""
    body = (
        '<body><joint type="slide" axis="1 0 0" stiffness="100"/>'
        '<geom size=".1" mass="1" contype="0" conaffinity="0"/></body>'
    )
    return _mjcf("spring", body, 'timestep="0.01" gravity="0 0 0"', key='<key qpos="0.1"/>')


def ball() -> str:
    """A ball of 1 kg on a vertical slide, 0.3 m over a floor."""
    return _mjcf("ball", FLOOR + _sliding_ball(0.4))


def stack() -> str:
    """Two such balls, one just over the floor and one just over the other."""
    return _mjcf("stack", FLOOR + _sliding_ball(0.1) + _sliding_ball(0.3))


def chain(links: int = 20) -> str:
    """A chain of capsules on parallel hinges, let go from the horizontal; nothing collides.

    Its end whips at 100 rad/s: at 2 ms it gains energy without end, at 0.5 ms 3 % in a second.
    """
    text = ""
    for link in range(links):
        text += f'<body pos="{0.1 if link else 0} 0 0"><joint axis="0 1 0"/>'
        text += (
            '<geom type="capsule" fromto="0 0 0 .1 0 0" size=".02" contype="0" conaffinity="0"/>'
        )
    return _mjcf(f"chain{links}", text + "</body>" * links, 'timestep="0.0005"')


def capsules(side: int = 3, seed: int = 1) -> str:
    """side³ capsules at random angles, dropped in a loose grid on a floor."""
    rng = np.random.default_rng(seed)
    text = FLOOR
    for i in range(side**3):
        x, y, z = i % side - (side - 1) / 2, i // side % side - (side - 1) / 2, i // side**2
        quat = rng.normal(size=4)
        turn = " ".join(f"{q:.6f}" for q in quat / np.linalg.norm(quat))
        text += f'<body pos="{0.16 * x:.3f} {0.16 * y:.3f} {0.2 + 0.35 * z:.3f}" quat="{turn}">'
        text += '<freejoint/><geom type="capsule" size=".05 .08"/></body>'
    return _mjcf(f"capsules{side**3}", text, memory="64M")


def free_ball() -> str:
    """A ball of 1 kg, free, 0.3 m over a floor."""
    body = '<body pos="0 0 .4"><freejoint/><geom size=".1" mass="1"/></body>'
    return _mjcf("free ball", FLOOR + body)


def pile_centres(side: int, radius: float = 0.05, seed: int = 0) -> tuple[float, np.ndarray]:
    """Half the width of a box, and the centres of side² columns of spheres over its floor."""
    half = 1.15 * radius * side
    rng = np.random.default_rng(seed)
    grid = np.array([(x, y, z) for z in range(side) for y in range(side) for x in range(side)])
    centres = (2 * grid + 1) * np.array([half / side, half / side, 1.2 * radius])
    centres[:, :2] -= half
    return half, centres + rng.uniform(-0.05 * radius, 0.05 * radius, centres.shape)


def pile(side: int = 4, radius: float = 0.05) -> str:
    """side³ spheres of 1 kg dropped into a box without a lid."""
    half, centres = pile_centres(side, radius)
    return _spheres_in_a_box(f"pile{side**3}", half, centres, radius)


def _spheres_in_a_box(name: str, half: float, centres: np.ndarray, radius: float) -> str:
    return _in_a_box(name, half, centres, f'size="{radius}"')


def _in_a_box(name: str, half: float, centres: np.ndarray, shape: str, memory: str = "256M") -> str:
    text = FLOOR
    for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        text += (
            f'<geom type="plane" size="5 5 .1" pos="{-x * half} {-y * half} 0" zaxis="{x} {y} 0"/>'
        )
    for x, y, z in centres:
        text += f'<body pos="{x:.6f} {y:.6f} {z:.6f}"><freejoint/>'
        text += f'<geom {shape} mass="1"/></body>'
    return _mjcf(name, text, memory=memory)


def spheres(count: int, radius: float = 0.05) -> str:
    """As `pile`, for any number of spheres: the lowest ones of the next larger pile."""
    side = next(side for side in range(1, count + 1) if side**3 >= count)
    half, centres = pile_centres(side, radius)
    return _spheres_in_a_box(f"spheres{count}", half, centres[:count], radius)


def _sliding_ball(height: float) -> str:
    return (
        f'<body pos="0 0 {height}"><joint type="slide" axis="0 0 1"/>'
        '<geom size=".1" mass="1"/></body>'
    )


def _mjcf(
    name: str, world: str, option: str = 'timestep="0.002"', key: str = "", memory: str = "8M"
) -> str:
    return (
        f'<mujoco model="{name}"><option {option}/><size memory="{memory}"/>'
        f"<worldbody>{world}</worldbody><keyframe>{key}</keyframe></mujoco>"
    )


def box_stack(count: int = 10, half: float = 0.1) -> str:
    """A tower of equal boxes of 1 kg, each on the one below, not quite in line."""
    text = FLOOR
    for i in range(count):
        x, y = 0.02 * half * ((7 * i) % 5 - 2), 0.02 * half * ((3 * i) % 5 - 2)
        text += f'<body pos="{x:.6f} {y:.6f} {(2 * i + 1) * half:.6f}"><freejoint/>'
        text += f'<geom type="box" size="{half} {half} {half}" mass="1"/></body>'
    return _mjcf(f"boxstack{count}", text, memory="64M")


def boxes(count: int, half: float = 0.05) -> str:
    """Boxes of 1 kg in columns of a box without a lid, the lowest of the next larger pile."""
    side = next(side for side in range(1, count + 1) if side**3 >= count)
    width, centres = pile_centres(side, half)
    shape = f'type="box" size="{half} {half} {half}"'
    memory = "256M" if count < 500 else "4G"
    return _in_a_box(f"boxes{count}", width, centres[:count], shape, memory)


def in_the_air(count: int, radius: float = 0.1) -> str:
    """Spheres of 1 kg far over a floor, none near another."""
    side = next(side for side in range(1, count + 1) if side**3 >= count)
    text = FLOOR
    for i in range(count):
        x, y, z = (3 * radius * k for k in (i % side, i // side % side, i // side**2))
        text += f'<body pos="{x:.6f} {y:.6f} {z + 50:.6f}"><freejoint/>'
        text += f'<geom size="{radius}" mass="1"/></body>'
    return _mjcf(f"air{count}", text)


def balls666(seed: int = 6) -> str:
    """SimBenchmark's 6 × 6 × 6 spheres without friction, dropped on a floor."""
    rng = np.random.default_rng(seed)
    grid = np.array([(x, y, z) for z in range(6) for y in range(6) for x in range(6)])
    centres = 0.21 * grid + [0.0, 0.0, 0.101] + 0.001 * rng.uniform(size=(216, 3))
    text = '<geom type="plane" size="5 5 .1" friction="0 0 0"/>'
    for x, y, z in centres:
        text += f'<body pos="{x:.9f} {y:.9f} {z:.9f}"><freejoint/>'
        text += '<geom size=".1" mass="10" friction="0 0 0"/></body>'
    return _mjcf("666", text, memory="256M")
