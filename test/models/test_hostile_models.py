"""Model files that ask for more than a model: refused in one line, and nothing else is read."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from unicon_base.errors import ModelError
from unicon_core.models.load import load_model
from unicon_core.robots import load_robot

GO2 = Path(__file__).resolve().parents[2] / "config" / "models" / "go2" / "go2.xml"
LAUGHS = '<!DOCTYPE l [<!ENTITY l0 "ha">' + "".join(
    f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 12)
)
OUTSIDE = '<!DOCTYPE x [<!ENTITY e SYSTEM "file://{secret}">'
URDF = '<?xml version="1.0"?>{head}<robot name="{name}"><link name="base"/></robot>'
MJCF = '{head}<mujoco model="{name}"><worldbody>{body}</worldbody></mujoco>'


def refused(path, text):
    path.write_text(text)
    begun = time.process_time()
    with pytest.raises(ModelError) as caught:
        load_model(path, load_robot("go2"), quiet=True)
    assert time.process_time() - begun < 5.0
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("head", [LAUGHS, OUTSIDE])
@pytest.mark.parametrize(("name", "text"), [("m.urdf", URDF), ("m.xml", MJCF)])
def test_entities_are_not_expanded(tmp_path, head, name, text):
    secret = tmp_path / "secret.txt"
    secret.write_text("the secret")
    head = head.replace("{secret}", str(secret)) + "]>"
    told = refused(tmp_path / name, text.format(head=head, name="&l11;&e;", body=""))
    assert "the secret" not in told
    assert "haha" not in told
    if name == "m.urdf":
        assert told.endswith("it has a DOCTYPE or entities; take them out")


@pytest.mark.parametrize(
    "body",
    [
        '<include file="m.xml"/>',
        '<include file="/dev/zero"/>',
        '<include file="other.xml"/>',
        '<replicate count="100000000"><geom size="1"/></replicate>',
        "<body>" * 2000 + "</body>" * 2000,
        '<geom type="mesh" mesh="none"/>',
        '<replicate count="&#49;00000000"><geom size="1"/></replicate>',
        '<replicate sep="a>b" count="100000000"><geom size="1"/></replicate>',
        '<replicate count="+100000000" count="1"><geom size="1"/></replicate>',
        '<replicate count="10"><replicate count="1000"><geom size="1"/></replicate></replicate>',
        '<body name="b"><flexcomp name="f" type="grid" count="20 20 20" dim="3"/></body>',
        '<replicate count="1000"><include file="thousand.xml"/></replicate>',
        '<include file="laughs0.xml"/>' * 10,
        '</worldbody><asset><model name="s" file="m.xml"/></asset><worldbody>',
        '</worldbody><asset><model name="s" file="attached0.xml"/></asset><worldbody>',
        '</worldbody><asset><hfield name="h" file="pipe" size="1 1 1 1"/></asset><worldbody>',
        '</worldbody><asset><hfield name="h" nrow="99999" ncol="9"/></asset><worldbody>',
        '</worldbody><asset><mesh builtin="cone" params="100000000 1"/></asset><worldbody>',
        '</worldbody><size nuser_body="2000000000"/><worldbody>',
        '</worldbody><size nkey="2000000000"/><worldbody>',
    ],
)
def test_a_model_that_includes_or_repeats_without_end_is_refused(tmp_path, body):
    (tmp_path / "other.xml").write_text('<mujoco><include file="m.xml"/></mujoco>')
    thousand = '<replicate count="1000"><geom size="1"/></replicate>'
    (tmp_path / "thousand.xml").write_text(f"<mujocoinclude>{thousand}</mujocoinclude>")
    for k in range(8):
        ten = f'<include file="laughs{k + 1}.xml"/>' * 10
        (tmp_path / f"laughs{k}.xml").write_text(f"<mujocoinclude>{ten}</mujocoinclude>")
        asset = f'<asset><model name="s" file="attached{k + 1}.xml"/></asset>'
        ten = "".join(f'<attach model="s" body="b" prefix="{i}"/>' for i in range(10))
        (tmp_path / f"attached{k}.xml").write_text(
            f'<mujoco>{asset}<worldbody><body name="b">{ten}</body></worldbody></mujoco>'
        )
    leaf = '<body name="b"><geom size="1"/></body>'
    (tmp_path / "laughs8.xml").write_text(f"<mujocoinclude>{leaf}</mujocoinclude>")
    (tmp_path / "attached8.xml").write_text(MJCF.format(head="", name="a", body=leaf))
    os.mkfifo(tmp_path / "pipe")
    refused(tmp_path / "m.xml", MJCF.format(head="", name="m", body=body))


def test_repetitions_beside_each_other_add_up_and_those_in_comments_do_not_count(tmp_path):
    hundred = '<replicate count="100"><geom size="1"/></replicate>'
    comment = '<replicate count="100">' * 5
    told = refused(
        tmp_path / "m.xml", MJCF.format(head="", name="m", body=f"<!-- {comment} -->{hundred * 5}")
    )
    assert "no joint 'FR_hip_joint'" in told


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be", "utf-32", "utf-7"])
@pytest.mark.parametrize("name", ["m.urdf", "m.xml"])
def test_no_encoding_hides_entities(tmp_path, encoding, name):
    head = f'<?xml version="1.0" encoding="{encoding}"?>{LAUGHS}]>'
    text = f'{head}<robot name="&l5;"><link name="base"><inertial/><inertial/></link></robot>'
    (tmp_path / name).write_bytes(text.encode(encoding))
    with pytest.raises(ModelError, match=r"^[^\n]*$") as caught:
        load_model(tmp_path / name, load_robot("go2"), quiet=True)
    assert "no joint" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "<a" * 1_000_000,
        '<a "' * 500_000,
        "<!--" * 500_000,
        f"<a {'b ' * 500_000}>",
        "".join(f'<compiler meshdir="{k}"/><a file="{k}"/>' for k in range(9000)),
    ],
)
def test_a_file_that_is_no_model_is_soon_refused(tmp_path, text):
    refused(tmp_path / "m.xml", text)


def test_a_pipe_or_a_device_is_no_model(tmp_path):
    os.mkfifo(tmp_path / "pipe.urdf")
    for path in (Path("/dev/zero"), tmp_path / "pipe.urdf"):
        with pytest.raises(ModelError, match="is not a file"):
            load_model(path, load_robot("go2"), quiet=True)


def test_elements_without_end_that_are_mended_are_refused(tmp_path):
    twice = '<link name="a"><visual><origin/><origin/></visual></link>'
    deep = f'<robot name="r">{twice}{"<a>" * 5000}{"</a>" * 5000}</robot>'
    assert refused(tmp_path / "m.urdf", deep).endswith("its elements are nested too deep")


@pytest.mark.parametrize("figure", ["nan", "inf"])
def test_a_urdf_whose_inertia_is_not_a_number_is_refused(tmp_path, figure):
    terms = f'ixx="{figure}" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"'
    link = f'<link name="a"><inertial><mass value="{figure}"/><inertia {terms}/></inertial></link>'
    refused(tmp_path / "m.urdf", f'<robot name="r">{link}</robot>')


@pytest.mark.parametrize(
    ("given", "bad", "told"),
    [
        ('armature="0.01"', 'armature="nan"', "dof_armature"),
        ('timestep="0.002"', 'timestep="nan"', "timestep"),
    ],
)
def test_a_model_with_figures_which_are_none_is_refused(tmp_path, given, bad, told):
    text = GO2.read_text("utf-8")
    assert given in text
    assert told in refused(tmp_path / "m.xml", text.replace(given, bad, 1))
