"""What a file makes of copies and attached models is bounded before MuJoCo makes it."""

import sys

import pytest

import stepcore as sc
from stepcore.mjcf import nodes, through_mujoco

BODY = '<body name="b"><joint name="j"/><geom size=".1"/></body>'


@pytest.fixture
def few(monkeypatch):
    """A limit that tests reach."""
    monkeypatch.setattr(through_mujoco, "MOST_ELEMENTS", 1000)


@pytest.mark.parametrize("outside", ["", '<sensor><jointpos joint="j"/></sensor>' * 60])
def test_copies_and_what_refers_to_them_have_a_limit(few, outside):
    tree = f'<worldbody><replicate count="{{}}">{BODY}</replicate></worldbody>'
    text = f"<mujoco>{tree}{outside}</mujoco>"
    with pytest.raises(sc.MJCFError, match=r"^<string>:1: .*at most 1000 copied elements"):
        sc.loads(text.format(2_000_000_000))
    with pytest.raises(sc.MJCFError, match="at most 1000 copied"):
        sc.loads(text.format(20 if outside else 400))
    assert len(sc.loads(text.format(5)).bodies) == 6


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


def test_models_that_attach_others_twice_count_together(tmp_path, few):
    assert len(sc.load(chain(tmp_path, 4)).bodies) == 17
    for inner in (BODY, ""):
        with pytest.raises(sc.MJCFError, match=r"\d\.xml:1: <attach>: .* at most 1000 copied"):
            sc.load(chain(tmp_path, 20, inner))


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


def test_without_mujoco_the_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    copies = '<replicate count="2"><geom size=".1"/></replicate>'
    text = f"<mujoco><worldbody>\n{copies}</worldbody></mujoco>"
    with pytest.raises(sc.MJCFError, match=r"^<string>:2: <replicate> .*stepcore\[mujoco\]"):
        sc.loads(text)


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
