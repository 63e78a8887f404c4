"""MuJoCo without its window library, which comes when something draws."""

from __future__ import annotations

import os
import subprocess
import sys
from ctypes.util import find_library

import pytest

pytest.importorskip("mujoco")

BEFORE = "import os, sys\nfrom unicon_core.models.loaded import import_mujoco\n"
QUICKLY = BEFORE + "mujoco = import_mujoco()\nassert 'glfw' not in sys.modules\n"


def ran(code, **environment):
    kept = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        env=kept | environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_it_comes_without_glfw_and_leaves_the_environment_alone():
    ran(QUICKLY + "assert 'MUJOCO_GL' not in os.environ\nassert import_mujoco() is mujoco")


@pytest.mark.parametrize("where", ["mujoco", "mujoco.rendering.classic.gl_context"])
def test_what_draws_gets_the_context_of_a_plain_import(where):
    if where != "mujoco":
        pytest.importorskip(where)
    ran(
        QUICKLY + f"import {where}\nmade = {where}.GLContext\n"
        "assert made.__module__ == 'mujoco.glfw' and mujoco.GLContext is made\n"
        "assert not hasattr(mujoco, 'nothing')"
    )


def test_a_renderer_can_be_made_as_after_a_plain_import():
    draw = (
        "model = mujoco.MjModel.from_xml_string('<mujoco/>')\n"
        "try: print(type(mujoco.Renderer(model, 8, 8)).__name__)\n"
        "except Exception as error: print(type(error).__name__, error)"
    )
    assert ran(QUICKLY + draw) == ran(f"import mujoco\n{draw}")


@pytest.mark.skipif(not find_library("EGL"), reason="no EGL: apt install libegl1")
def test_a_renderer_that_is_asked_for_is_left_as_it_is():
    ran(BEFORE + "assert import_mujoco().GLContext.__module__ == 'mujoco.egl'", MUJOCO_GL="egl")


def test_a_mujoco_that_is_there_already_is_taken():
    ran("import mujoco\n" + BEFORE + "assert import_mujoco() is mujoco and mujoco.GLContext")


def test_names_that_are_not_there_are_told_by_name():
    told = ran(
        QUICKLY + "try: mujoco.nothing\nexcept AttributeError as error: print(error)\n"
        "from mujoco import rollout"
    )
    assert "'nothing'" in told
