"""Bodies that a contact hardly moves: a wheel whose axle passes its centre at 1e-9 to 1e-3 m.

Law: the acceleration is that of the contact problem. The axle leaves one unknown, so that there is
an exact solution on MuJoCo's own rows: in fractions (pyramids, piecewise linear), and in sixty
digits (cones). The edges of the pyramid carry up to 1e14 N, which cancel.
"""

from decimal import Decimal, localcontext
from fractions import Fraction

import mujoco
import numpy as np
import peers
import pytest

import stepcore as sc

OFFSETS = (1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3)
WHEEL = """<mujoco><option cone="{cone}"/><worldbody><frame quat="{quat}">
<geom type="plane" size="1 1 1"/>
<body pos="0 0 .099"><joint axis="0 1 0" pos="{off} 0 0" name="axle"/>
<geom size=".1" mass="1"/></body></frame>
</worldbody><actuator><motor joint="axle" gear="3"/></actuator></mujoco>"""


def wheel(cone, off, rng):
    """The text, and MuJoCo's data at a state of it."""
    quat = rng.normal(size=4)
    text = WHEEL.format(cone=cone, off=off, quat=" ".join(repr(float(q)) for q in quat))
    model = peers.strict(mujoco.MjModel.from_xml_string(text))
    data = mujoco.MjData(model)
    data.ctrl[:], data.qvel[:] = 1.0, 0.3
    mujoco.mj_forward(model, data)
    return text, model, data


def qacc(text, **settings):
    sim = sc.Sim(sc.loads(text), **peers.EXACT | settings)
    sim.ctrl[:], sim.qvel[:] = 1.0, 0.3
    sim.forward()
    return float(sim.qacc[0])


def pyramid(model, data):
    """The least of ½ M (a − a₀)² + Σ ½ D min(0, J a − r)²: between two kinks it is a parabola."""
    mass = Fraction(float(peers.mass_matrix(model, data)[0, 0]))
    free = Fraction(float(data.qacc_smooth[0]))
    columns = (data.efc_J.ravel(), data.efc_D, data.efc_aref)
    rows = [tuple(Fraction(float(x)) for x in row) for row in zip(*columns, strict=True)]

    def slope(a):
        return mass * (a - free) + sum(d * j * min(Fraction(0), j * a - r) for j, d, r in rows)

    kinks = sorted(r / j for j, _, r in rows if j)
    low = max((kink for kink in kinks if slope(kink) < 0), default=kinks[0] - 1)
    high = min((kink for kink in kinks if slope(kink) >= 0), default=kinks[-1] + 1)
    inside = (low + high) / 2
    active = [(j, d, r) for j, d, r in rows if j * inside < r]
    pull = mass * free + sum(d * j * r for j, d, r in active)
    return float(pull / (mass + sum(d * j * j for j, d, _ in active)))


def cone(model, data):
    """The zero of the slope of the cost, which grows, by halving."""
    contact = data.contact[0]
    with localcontext() as context:
        context.prec = 60

        def exact(values):
            return [Decimal(float(value)) for value in np.ravel(values)]

        (mass,), (free,) = exact(peers.mass_matrix(model, data)), exact(data.qacc_smooth)
        jacobian, weights, targets = (exact(x) for x in (data.efc_J, data.efc_D, data.efc_aref))
        (mu,), friction = exact(contact.mu), exact(contact.friction[:2])
        scales = [mu, *friction]

        def slope(a):
            off = [j * a - r for j, r in zip(jacobian, targets, strict=True)]
            seen = [s * o for s, o in zip(scales, off, strict=True)]
            across = (seen[1] ** 2 + seen[2] ** 2).sqrt()
            if seen[0] >= mu * across:
                forces = [Decimal(0)] * 3
            elif mu * seen[0] + across <= 0:
                forces = [-d * o for d, o in zip(weights, off, strict=True)]
            else:
                normal = -mu * weights[0] / (mu**2 * (1 + mu**2)) * (seen[0] - mu * across)
                along = zip(seen[1:], friction, strict=True)
                tangents = [-normal / across * u * f for u, f in along]
                forces = [normal, *tangents]
            return mass * (a - free) - sum(j * f for j, f in zip(jacobian, forces, strict=True))

        low, high = Decimal(-10_000), Decimal(10_000)
        assert slope(low) < 0 < slope(high)
        for _ in range(180):
            middle = (low + high) / 2
            low, high = (middle, high) if slope(middle) < 0 else (low, middle)
        return float(low)


EXACT = {"pyramidal": pyramid, "elliptic": cone}


@pytest.mark.parametrize("kind", EXACT)
def test_the_acceleration_is_the_exact_one(kind):
    """Under either cone, at any angle of the floor; MuJoCo's Newton finds it too."""
    rng = np.random.default_rng(0)
    for off in OFFSETS:
        for _ in range(8):
            text, model, data = wheel(kind, off, rng)
            want = EXACT[kind](model, data)
            size = abs(data.qacc_smooth[0])
            assert abs(data.qacc[0] - want) < 1e-9 * size
            assert abs(qacc(text) - want) < 1e-9 * size, (off, qacc(text), want)


@pytest.mark.parametrize("kind", EXACT)
def test_in_single_precision_to_its_digits(kind):
    """Three of them are spent."""
    rng = np.random.default_rng(1)
    for off in OFFSETS:
        text, model, data = wheel(kind, off, rng)
        want = EXACT[kind](model, data)
        found = qacc(text, precision="f32")
        assert abs(found - want) < 2e-3 * abs(data.qacc_smooth[0]), (off, found, want)
