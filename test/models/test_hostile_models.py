"""Model files that ask for more than a model: refused in one line, and nothing else is read."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from unicon_core.errors import ModelError
from unicon_core.models.load import load_model
from unicon_core.robots import load_robot

LAUGHS = '<!DOCTYPE l [<!ENTITY l0 "ha">' + "".join(
    f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 12)
)
OUTSIDE = '<!DOCTYPE x [<!ENTITY e SYSTEM "file://{secret}">'
URDF = '<?xml version="1.0"?>{head}<robot name="{name}"><link name="base"/></robot>'
MJCF = '{head}<mujoco model="{name}"><worldbody>{body}</worldbody></mujoco>'


def refused(path: Path, text: str) -> str:
    path.write_text(text)
    begun = time.process_time()
    with pytest.raises(ModelError) as caught:
        load_model(path, load_robot("go2"), quiet=True)
    assert time.process_time() - begun < 5.0
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("head", [LAUGHS, OUTSIDE])
@pytest.mark.parametrize(("name", "text"), [("m.urdf", URDF), ("m.xml", MJCF)])
def test_entities_are_not_expanded(tmp_path: Path, head: str, name: str, text: str) -> None:
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
    ],
)
def test_a_model_that_includes_or_repeats_without_end_is_refused(tmp_path: Path, body: str) -> None:
    (tmp_path / "other.xml").write_text('<mujoco><include file="m.xml"/></mujoco>')
    refused(tmp_path / "m.xml", MJCF.format(head="", name="m", body=body))
