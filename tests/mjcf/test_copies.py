"""All copies of a load are counted before they are made, and cost time by their own number."""

import pytest

import stepcore as sc
from stepcore.mjcf import attach, nodes

BODY = '<body name="b"><joint name="j"/><geom size=".1"/></body>'


@pytest.fixture
def made(monkeypatch):
    """How many elements were copied, and a limit that tests reach."""
    found = []
    monkeypatch.setattr(attach, "MOST_COPIES", 1000)
    alone = attach._alone
    monkeypatch.setattr(attach, "_alone", lambda node: found.append(node.tag) or alone(node))
    return found


def replicated(count, section):
    body = f'<worldbody><replicate count="{count}">{BODY}</replicate></worldbody>'
    return f"<mujoco>{body}{section}</mujoco>"


SECTIONS = {
    "sensor": '<jointpos joint="j"/>',
    "actuator": '<motor joint="j"/>',
    "equality": '<joint joint1="j"/>',
    "tendon": '<fixed><joint joint="j" coef="1"/></fixed>',
    "contact": '<exclude body1="b" body2="world"/>',
}


@pytest.mark.parametrize("tag", SECTIONS)
def test_what_refers_to_a_replicated_body_counts_before_it_is_copied(tag, made):
    section = f"<{tag}>{SECTIONS[tag] * 60}</{tag}>"
    with pytest.raises(sc.MJCFError, match=r"<string>:1: <replicate> makes .* at most 1000 copied"):
        sc.loads(replicated(20, section))
    assert not made
    scene = sc.loads(replicated(5, section))
    assert len(scene.bodies) == 6
    assert len(made) <= 1000


def chain(folder, levels, inner=BODY):
    """Files that attach the next one twice: the first has 2 ** levels bodies."""
    for level in range(levels + 1):
        text = inner
        asset = ""
        if level < levels:
            asset = f'<asset><model name="m" file="{level + 1}.xml"/></asset>'
            text = '<attach model="m" prefix="a"/><attach model="m" prefix="b"/>'
        text = f"<mujoco>{asset}<worldbody>{text}</worldbody></mujoco>"
        (folder / f"{level}.xml").write_text(text)
    return folder / "0.xml"


def test_models_that_attach_others_twice_count_together(tmp_path, made):
    assert len(sc.load(chain(tmp_path, 4)).bodies) == 17
    made.clear()
    with pytest.raises(sc.MJCFError, match=r"\d\.xml:1: <attach> makes .* at most 1000 copied"):
        sc.load(chain(tmp_path, 20))
    assert len(made) <= 1000


def test_classes_and_frames_of_attached_models_count(tmp_path, made):
    with pytest.raises(sc.MJCFError, match="copied elements"):
        sc.load(chain(tmp_path, 20, ""))


def test_a_model_is_read_once_however_many_attach_it(tmp_path, monkeypatch):
    read = []
    parse = nodes.parse
    monkeypatch.setattr(nodes, "parse", lambda data, file: read.append(file) or parse(data, file))
    (tmp_path / "leg.xml").write_text(f"<mujoco><worldbody>{BODY}</worldbody></mujoco>")
    assets = "".join(f'<model name="m{i}" file="leg.xml"/>' for i in range(5))
    attach = "".join(f'<attach model="m{i}" prefix="p{i}"/>' for i in range(5))
    text = f"<mujoco><asset>{assets}</asset><worldbody>{attach}</worldbody></mujoco>"
    assert len(sc.loads(text, base=tmp_path).bodies) == 6
    assert len(read) == 1


def test_models_attached_in_turn_have_a_limit(tmp_path):
    for level in range(400):
        asset = f'<asset><model name="m" file="{level + 1}.xml"/></asset>'
        text = '<worldbody><attach model="m" prefix="a"/></worldbody>'
        (tmp_path / f"{level}.xml").write_text(f"<mujoco>{asset}{text}</mujoco>")
    with pytest.raises(sc.MJCFError, match="nested deeper than 50"):
        sc.load(tmp_path / "0.xml")


def test_each_replicate_looks_at_what_refers_to_it_alone(monkeypatch):
    looked = []
    named_by = attach.named_by
    monkeypatch.setattr(attach, "named_by", lambda node: looked.append(1) or named_by(node))
    count = 200
    bodies = "".join(
        f'<replicate count="2"><body><joint name="j{i}x"/><geom size=".1"/></body></replicate>'
        for i in range(count)
    )
    sensors = "".join(f'<jointpos joint="j{i}x"/>' for i in range(count))
    text = f"<mujoco><worldbody>{bodies}</worldbody><sensor>{sensors}</sensor></mujoco>"
    assert len(sc.loads(text).sensors) == 2 * count
    assert len(looked) == 3 * count


def deep_includes(folder, around):
    """Three files of 450 nested bodies each, the outermost within `around`."""
    for level in range(3):
        inner = f'<include file="{level + 1}.xml"/>' if level < 2 else "<joint/>" + BODY
        inner = "<body>" * 450 + inner + "</body>" * 450
        root = "<mujocoinclude>{}</mujocoinclude>" if level else around
        (folder / f"{level}.xml").write_text(root.format(inner))
    return folder / "0.xml"


@pytest.mark.parametrize(
    "around",
    [
        "<mujoco><worldbody>{}</worldbody></mujoco>",
        "<mujoco><worldbody><replicate count='2'>{}</replicate></worldbody></mujoco>",
        "<mujoco><worldbody><frame name='f'>{}</frame><attach frame='f' prefix='a'/>"
        "</worldbody></mujoco>",
    ],
)
def test_includes_nest_no_deeper_than_one_file_may(around, tmp_path):
    with pytest.raises(sc.MJCFError, match=r"1\.xml:1: elements are nested deeper than 500"):
        sc.load(deep_includes(tmp_path, around))


def test_models_attached_in_turn_may_be_deeper_than_one_file(tmp_path):
    for level in range(3):
        inner = '<attach model="m" prefix="a"/>' if level < 2 else "<joint/><geom size='.1'/>"
        inner = "<body>" * 400 + inner + "</body>" * 400
        asset = f'<asset><model name="m" file="{level + 1}.xml"/></asset>' if level < 2 else ""
        text = f"<mujoco>{asset}<worldbody>{inner}</worldbody></mujoco>"
        (tmp_path / f"{level}.xml").write_text(text)
    assert len(sc.load(tmp_path / "0.xml").bodies) == 1201
