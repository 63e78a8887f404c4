"""What a shell offers for a command line that is half written, by argcomplete's own protocol."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from unicon_ros.cli.main import main

pytest.importorskip("argcomplete", reason="argcomplete is not installed")


def offered(line: str) -> list[str]:
    """Return what is offered, as `register-python-argcomplete` asks for it."""
    asked = {"COMP_LINE": line, "COMP_POINT": str(len(line)), "COMP_TYPE": "9"}
    asked |= {"_ARGCOMPLETE": "1", "_ARGCOMPLETE_SHELL": "bash", "_ARGCOMPLETE_IFS": "\n"}
    command = f'exec "{sys.executable}" -c "from unicon_ros.cli.main import main; main()" 8>&1 1>&2'
    said = subprocess.run(
        ["bash", "-c", command],
        env=os.environ | asked,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    return [word.strip() for word in said.stdout.splitlines()]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("unicon pref", ["preflight"]),
        ("unicon run go2_sta", ["go2_stairs", "go2_stand"]),
        ("unicon robots g1", ["g1_23dof", "g1_29dof"]),
        ("unicon robots new --k", ["--kind"]),
        ("unicon assets fetch g1_h", ["g1_holosoma_dancing", "g1_holosoma_ppo"]),
        ("unicon -q policies go2_v", ["go2_velocity"]),
        ("unicon run go2_walk --set platform=unitree_l", ["platform=unitree_legged"]),
        ("unicon vid", ["video"]),
        ("unicon video walk.mcap walk.mp4 --g", ["--ghost"]),
        ("unicon emulate nobo", []),
    ],
)
def test_names_and_options_are_offered(line: str, words: list[str]) -> None:
    assert offered(line) == words


def test_a_shell_whose_argcomplete_is_another_pythons_gets_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("_ARGCOMPLETE", "1")
    monkeypatch.setitem(sys.modules, "argcomplete", None)
    with pytest.raises(SystemExit):
        main(["robots"])
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("words", [["-q", "robots"], ["robots", "--quiet"]])
def test_a_quiet_list_is_its_names(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 0
    names = capsys.readouterr().out.splitlines()
    assert "go2" in names
    assert all(name.replace("_", "").isalnum() for name in names)


def test_verbose_shows_what_parts_log_and_where_an_error_comes_from() -> None:
    code = "import unicon_ros.cli.known as k, logging\n"
    code += "def broken(_): logging.getLogger('part').info('so far'); raise ZeroDivisionError\n"
    code += "k.LISTS['robots'] = broken, ''\n"
    code += "from unicon_ros.cli.main import main; raise SystemExit(main())"
    for words, seen in ((["-v", "robots"], True), (["robots"], False)):
        command = [sys.executable, "-c", code, *words]
        said = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert said.returncode == 1
        assert ("unicon: part: so far" in said.stderr) is seen
        assert ("Traceback" in said.stderr) is seen
        assert ("--verbose shows where it comes from" in said.stderr) is not seen
