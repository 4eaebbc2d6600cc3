"""Heaps: models of so many pairs that these are found as they come near."""

import pickle

import numpy as np
import pytest

import stepcore as sc


def balls(count, *, spread=0.0, law="rigid", excluded=(), seed=3):
    """A cube of free balls over a floor. spread: of their places, in radii."""
    random = np.random.default_rng(seed)
    side = round(count ** (1 / 3) + 0.5)
    scene = sc.Scene()
    scene.add_geom("world", "plane", (0, 0, 1), name="floor")
    for i in range(count):
        place = np.array([i % side, i // side % side, i // side**2]) * 0.205
        place = place + [0, 0, 0.1] + 0.1 * spread * random.uniform(-1, 1, 3)
        body = scene.add_body(f"ball{i}", pos=tuple(place))
        scene.add_joint(body, "free")
        scene.add_geom(body, "sphere", (0.1, 0, 0), name=f"ball{i}", mass=1.0)
    for one, two in excluded:
        scene.exclude(f"ball{one}", f"ball{two}")
    scene.settings = sc.Settings(law=law, solver="pgs", dt=1e-3)
    return scene


def test_a_model_of_many_pairs_is_a_heap_and_says_so(monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    few, many = balls(60).compile(), balls(70).compile()
    assert not few.is_heap and few.npair == len(few.pairs) == 60 * 61 // 2
    assert many.is_heap and many.npair == 70 * 71 // 2
    assert many.heap == {("plane", "sphere"): 70, ("sphere", "sphere"): 70 * 69 // 2}
    for name in ("pairs", "pair_geoms"):
        with pytest.raises(ValueError, match=r"pairs: this model is a heap.*contact_pair"):
            getattr(many, name)
    text = str(many.plan())
    assert "found as they come near" in text and "2485" in repr(many)


def test_contacts_of_a_heap_have_names_and_pairs():
    model = balls(70).compile()
    sim = sc.Sim(model)
    sim.step(300)
    contacts = sim.contacts
    assert len(contacts) >= 70
    for contact in contacts[::17]:
        pair = model.contact_pair(int(contact["index"]))
        assert pair.geoms == (contact["geom1"], contact["geom2"])
        assert pair.condim == 3 and pair.friction == 1.0
        name = model.element_name("contact", int(contact["index"]))
        assert name == f"contact `{contact['name1']}`/`{contact['name2']}`"
    with pytest.raises(ValueError, match="index"):
        model.contact_pair(0)
    weight = 9.81 * 70
    floor = contacts[contacts["name1"] == "floor"]
    assert floor["force"][:, 2].sum() == pytest.approx(weight, rel=0.2)


@pytest.mark.parametrize("law", ["solref", "rigid"])
def test_a_heap_goes_on_from_a_snapshot_bit_for_bit(law):
    model = balls(66, spread=0.1, law=law).compile()
    sim = sc.Sim(model)
    sim.step(150)
    state = sim.state()
    copy = pickle.loads(pickle.dumps(sim))
    sim.step(100)
    copy.step(100)
    again = sc.Sim(model)
    again.restore(state)
    again.step(100)
    for other in (copy, again):
        assert np.array_equal(other.qpos, sim.qpos) and np.array_equal(other.qvel, sim.qvel)


def test_a_batch_of_heaps_is_its_worlds():
    model = balls(66, spread=0.1).compile()
    batch = sc.Batch(model, 3, threads=2)
    worlds = [sc.Sim(model) for _ in range(3)]
    for k, sim in enumerate(worlds):
        sim.qvel[0::6] = batch.qvel[k, 0::6] = 0.5 * k
        sim.step(60)
    batch.step(60)
    for k, sim in enumerate(worlds):
        assert np.array_equal(batch.qpos[k], sim.qpos)


def test_excluded_balls_of_a_heap_pass_through_each_other():
    model = balls(66, excluded=[(0, 1), (3, 2)]).compile()
    assert model.npair == 66 * 67 // 2 - 2
    sim = sc.Sim(model)
    sim.qpos[7:10] = sim.qpos[0:3]
    sim.forward()
    pairs = {tuple(sorted((c["name1"], c["name2"]))) for c in sim.contacts}
    assert ("ball0", "ball1") not in pairs and len(pairs) > 20
    assert "excluded" in str(model.plan())


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("condim", [1, 4, 6])
def test_two_balls_of_a_heap_move_as_two_balls_alone(condim, cone):
    """One ball on another, spinning and rolling; all such pairs stand far from each other."""

    def rolling(count):
        scene = balls(count, law="solref")
        for i, body in enumerate(scene.bodies[1:]):
            body.pos = (3.0 * (i // 2), 0, 0.0999 + 0.1998 * (i % 2))
        for geom in scene.geoms:
            geom.condim, geom.friction = condim, (0.8, 0.02, 0.01)
        sim = sc.Sim(scene.compile(), solver="newton", cone=cone)
        sim.qvel[0::6], sim.qvel[11::12] = 0.3, 2.0
        sim.step(20)
        return sim

    alone, heap = rolling(2), rolling(70)
    assert heap.model.is_heap and not alone.model.is_heap
    assert len(heap.contacts) == 35 * len(alone.contacts)
    for i in (0, 17, 34):
        own = heap.qvel[12 * i : 12 * i + 12]
        assert np.allclose(own, alone.qvel, rtol=1e-8, atol=1e-11)
    assert (abs(heap.qvel[11]) < 1.99) == (condim >= 4)


@pytest.mark.parametrize("law", ["solref", "rigid"])
@pytest.mark.parametrize("high", [0.0, 9.0])
def test_a_step_counts_as_many_operations_a_body_in_a_large_heap(law, high):
    """In the air, and on the floor: counts are the same on every machine. `nbytes` as well."""

    def cost(count):
        scene = balls(count, law=law)
        for i, body in enumerate(scene.bodies[1:]):
            body.pos = (0.3 * (i % 32), 0.3 * (i // 32), 0.0999 + high)
        sim = sc.Sim(scene.compile(), sweeps=5, tolerance=0.0)
        sim.step(1)
        assert len(sim.contacts) == (count if high == 0.0 else 0)
        return sim.count_flops(), sim.nbytes

    few, some, many = (np.array(cost(count)) for count in (128, 256, 1024))
    assert np.all(many - some <= 1.01 * 6 * (some - few))
    assert np.all(many / 1024 <= 1.05 * few / 128)


@pytest.mark.parametrize("count", [3, 80])
def test_fixed_geoms_that_have_no_test_together_never_meet(count):
    """A plane, two height fields and an explicit pair of these, at any number of geoms."""
    scene = balls(count)
    for name in ("hill", "dale"):
        scene.add_hfield(name, np.eye(3), size=(2, 2, 0.1, 0.1))
        scene.add_geom(scene.add_body(name, pos=(0, 0, -9)), "hfield", hfield=name, name=name)
    scene.add_pair("hill", "floor")
    model = scene.compile()
    assert model.is_heap == (count == 80)
    sim = sc.Sim(model)
    sim.step(20)
    names = set(sim.contacts["name1"]) | set(sim.contacts["name2"])
    assert "floor" in names and not names & {"hill", "dale"}
