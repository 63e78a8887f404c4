"""What differed first: the chain of two runs names the right signal, or none."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from made_runs import CALF, save, walk

from unicon_base.errors import WorkflowError
from unicon_core.flow import Block, Stage
from unicon_core.policies import load_policy, policy_states
from unicon_core.policies.observation import Observation
from unicon_core.states import States, StateSpec, standard_states
from unicon_core.workflow import HookBlocks, Program
from unicon_lab.analysis import comparison as module
from unicon_lab.analysis.comparison import divergence, signals_of
from unicon_lab.analysis.paired_runs import bring_together
from unicon_lab.analysis.run import read_run
from unicon_lab.recording import open_record
from unicon_ros.cli.main import main

FAULT = 3.0  # [s] in the walks of 6 s


def chain(folder: Path, real: Any, sim: Any, **options: Any) -> dict[str, Any]:
    """Return the divergence of two files, or of two made-up runs."""
    paths = [
        each if isinstance(each, Path) else save(folder / f"{name}.npz", each)
        for name, each in (("real", real), ("sim", sim))
    ]
    return divergence(bring_together(*(read_run(p, more=signals_of) for p in paths), **options))


def ranks(found: dict[str, Any]) -> dict[str, int]:
    """Return the rank of each signal that differs, in the order of the chain."""
    return {each["signal"]: each["rank"] for each in found["signals"] if each["rank"]}


def of(found: dict[str, Any], signal: str) -> dict[str, Any]:
    [one] = [each for each in found["signals"] if each["signal"] == signal]
    return dict(one)


def test_runs_that_are_one_differ_nowhere(tmp_path: Path) -> None:
    found = chain(tmp_path, walk(), walk())
    assert ranks(found) == {}
    assert {each["size"] for each in found["signals"]} == {0.0}
    assert found["shift_s"] == 0.0
    signals = [each["signal"] for each in found["signals"]]
    assert {"joint_pos", "base_ang_vel", "tracking_error", "power"} <= {*signals}


def test_noise_alone_is_no_difference(tmp_path: Path) -> None:
    for seed in range(1, 6):
        assert ranks(chain(tmp_path, walk(seed=seed), walk(seed=seed + 10))) == {}


@pytest.mark.parametrize("begin", [0.0, 0.74])
@pytest.mark.parametrize(
    ("fault", "signal", "element"),
    [
        ("offset", "base_ang_vel", "x"),
        ("sign", "base_ang_vel", ""),
        ("calf", "joint_effort", "RL_calf"),
        ("gains", "joint_damping", "FR_hip"),
    ],
)
def test_the_signal_with_the_fault_is_first(
    tmp_path: Path, fault: str, signal: str, element: str, begin: float
) -> None:
    real, sim = walk(begin=begin, seed=1), walk(seed=2)
    late = round(FAULT * 50)
    if fault == "offset":
        real["base_ang_vel"][late:, 0] += 0.1
    elif fault == "sign":
        real["base_ang_vel"][late:] *= -1.0
    elif fault == "calf":
        real["joint_effort"][late:, CALF] *= 0.5
    else:
        real["joint_damping"][late:] += 1.0
    found = chain(tmp_path, real, sim)
    assert next(iter(ranks(found))) == signal
    one = of(found, signal)
    assert one["time_s"] == pytest.approx(FAULT, abs=0.1 if fault in ("sign", "calf") else 1e-6)
    assert one["element"] == element or not element
    alike = {"base_ang_vel": 1, "joint_effort": 1, "joint_damping": 1, "power": 2}
    assert {*ranks(found)} <= {*alike}
    assert found["shift_s"] == pytest.approx(-begin)
    assert one["relative"] > 0.3 or fault == "gains"


def test_what_comes_later_stands_later_and_what_comes_at_once_shares_a_rank(
    tmp_path: Path,
) -> None:
    real, sim = walk(), walk()
    for at, signal in ((200, "joint_vel"), (150, "base_ang_vel"), (150, "joint_stiffness")):
        real[signal][at:] += 5.0
    found = ranks(chain(tmp_path, real, sim))
    assert found["base_ang_vel"] == found["joint_stiffness"] == 1
    assert found["joint_vel"] == found["power"] == 2
    real["joint_vel"] = walk()["joint_vel"]
    real["joint_vel"][100:102] += 5.0  # a spike
    assert "joint_vel" not in ranks(chain(tmp_path, real, sim))


def test_what_grows_slowly_began_earlier_than_it_became_large(tmp_path: Path) -> None:
    real, sim = walk(), walk()
    real["joint_pos_target"][100:, 0] += np.linspace(0.0, 0.2, 200)
    real["joint_vel"][130:] += 1.0
    found = chain(tmp_path, real, sim)
    assert next(iter(ranks(found))) in ("joint_pos_target", "tracking_error")
    assert of(found, "joint_pos_target")["time_s"] == pytest.approx(2.02)


def test_what_differs_from_the_beginning_is_no_level(tmp_path: Path) -> None:
    real, sim = walk(seed=1), walk(seed=2)
    real["joint_damping"] += 1.0
    real["base_ang_vel"] *= -1.0
    found = chain(tmp_path, real, sim)
    assert of(found, "joint_damping")["time_s"] == 0.0
    assert of(found, "base_ang_vel")["time_s"] < 0.1
    assert "joint_pos" not in ranks(found)


def test_what_is_not_a_number_differs(tmp_path: Path) -> None:
    real = walk()
    real["base_ang_vel"][150:160, 1] = np.nan
    found = chain(tmp_path, real, walk())
    assert ranks(found) == {"base_ang_vel": 1}
    one = of(found, "base_ang_vel")
    assert (one["time_s"], one["element"]) == (pytest.approx(3.0), "y")
    assert ranks(chain(tmp_path, real, real)) == {}
    resampled = of(chain(tmp_path, real, walk(rate=25.0)), "base_ang_vel")
    assert resampled["time_s"] == pytest.approx(3.0, abs=0.05)


def test_short_runs_and_other_joints_are_compared(tmp_path: Path) -> None:
    def short(run: dict[str, Any]) -> dict[str, Any]:
        return {key: v if key == "joint_names" else v[:16] for key, v in run.items()}

    assert ranks(chain(tmp_path, short(walk()), short(walk()))) == {}
    other = walk()
    other["joint_names"] = np.array([*other["joint_names"][:-1], "tail"])
    assert ranks(chain(tmp_path, walk(), other)) == {}


# Records


def flow(folder: Path, **more: Any) -> Path:
    """Write a workflow in which a Go2 walks from the first tick on."""
    values = {
        "schema": "unicon.workflow/1",
        "robot": "go2",
        "platform": "mujoco",
        "policies": {"walk": "go2_velocity"},
        "rate": 50,
        "duration": 3.0,
        "commands": [{"velocity_command": {"schedule": [[0.0, 0.5, 0.0, 0.0]]}}],
        "flow": {"policy": "walk"},
    }
    path = folder / "walk.yaml"
    path.write_text(yaml.safe_dump(values | more, sort_keys=False), "utf-8")
    return path


def from_tick(
    first: int, stage: Stage, name: str, change: Callable[[Any], object]
) -> Callable[[Program], HookBlocks]:
    """Return a hook that changes a state from a tick on."""

    def hook(program: Program) -> HookBlocks:
        state, tick = program.states[name], count()

        def spoil() -> None:
            if next(tick) >= first:
                change(state)

        return {stage: [Block("spoil", spoil, amends=(name,))]}

    return hook


def recorded(folder: Path, name: str, *hooks: Any, **more: Any) -> Path:
    for needed in ("mujoco", "onnxruntime", "rosbags"):
        pytest.importorskip(needed)
    from test_recorded_runs import recorded as record

    path = folder / f"{name}.mcap"
    platform = more.get("platform", "mujoco")
    record(flow(folder, **more), path, hooks, platform=platform)
    return path


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A walk without a fault."""
    return recorded(tmp_path_factory.mktemp("sound"), "sim")


def negate(state: Any) -> None:
    state *= -1.0


def double(state: Any) -> None:
    state *= 2.0


def shift(state: Any) -> None:
    state += 0.1


@pytest.mark.parametrize(
    ("stage", "state", "change", "together", "then"),
    [
        (Stage.RECV, "base_ang_vel", negate, "observation base_ang_vel", "joint_vel"),
        (Stage.RECV, "base_ang_vel", shift, "observation base_ang_vel", "joint_vel"),
        (Stage.TUNE, "joint_damping", double, "joint_damping", "joint_vel"),
    ],
)
def test_a_fault_in_a_walk_is_first_in_the_chain(
    tmp_path: Path, sound: Path, stage: Any, state: str, change: Any, together: str, then: str
) -> None:
    real = recorded(tmp_path, "real", from_tick(75, stage, state, change))
    found = chain(tmp_path, real, sound)
    first = ranks(found)
    assert next(iter(first)) == state
    assert first[together] == 1
    assert first[then] == 2
    assert of(found, state)["time_s"] == pytest.approx(1.5)
    assert found["shift_s"] == 0.0
    if stage is Stage.RECV:
        assert first["action"] == 1
        assert first["observation last_action"] == 2
    json.dumps(found)


def test_the_same_walk_twice_differs_nowhere(
    tmp_path: Path,
    sound: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    again = recorded(tmp_path, "again")
    pytest.importorskip("matplotlib")
    monkeypatch.setattr("unicon_lab.analysis.report.PICTURES", {})
    assert main(["analyze", str(again), str(sound), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "No signal differs by more than 4 times what it does from 0.02 to 0.76 s" in said
    assert "observation joint_pos_rel" in said
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "<h2>What differed first</h2>" in page
    result = json.loads((tmp_path / "out" / "analysis.json").read_text("utf-8"))
    assert result["divergence"]["agree_s"] is None
    assert {each["rank"] for each in result["divergence"]["signals"]} == {None}


def test_terms_are_those_of_the_contract(sound: Path) -> None:
    record = open_record(sound)
    notes: list[str] = []
    found, elements = signals_of(record, notes)
    assert notes == []
    assert [*found] == [
        *("action", "observation base_ang_vel", "observation projected_gravity"),
        *("observation velocity_command", "observation joint_pos_rel"),
        *("observation joint_vel_rel", "observation last_action"),
    ]
    assert elements["observation base_ang_vel"] == ("x", "y", "z")
    values = found["observation base_ang_vel"]
    np.testing.assert_allclose(values, 0.25 * record.states("base_ang_vel"), rtol=1e-6)


@pytest.mark.parametrize("layout", ["term_major", "frame_major"])
@pytest.mark.parametrize("newest", ["first", "last"])
def test_the_newest_frame_of_a_history_counts(
    monkeypatch: pytest.MonkeyPatch, layout: Any, newest: Any
) -> None:
    given = load_policy("go2_velocity")
    terms = tuple(replace(term, history=3) for term in given.terms)
    spec = replace(given.observation, terms=terms, layout=layout, newest=newest)
    contract = replace(given, observation=spec)
    feet = {"foot_contact": StateSpec((4,), names=("FR", "FL", "RR", "RL"))}
    own = policy_states(contract, contract.joints)
    states = States(standard_states(contract.joints) | own | feet)
    write = Observation(contract, states, contract.joints).bind(states["observation"][None])
    rows: dict[str, list[Any]] = {name: [] for name in states}
    for value in range(5):
        states["joint_vel"][...] = np.arange(12) + 100.0 * value
        states["foot_contact"][...] = value % 2
        write()
        for name, kept in rows.items():
            kept.append(states[name].copy())
    record: Any = SimpleNamespace(
        layout=states.layout, policies={"walk": {}}, states=lambda name: np.array(rows[name])
    )
    monkeypatch.setattr(module, "workflow_of", lambda record: None)
    monkeypatch.setattr(module, "load_robot_of", lambda document: None)
    monkeypatch.setattr(module, "load_policies", lambda *_: {"walk": contract})
    values, names = signals_of(record, [])
    assert names["observation joint_vel_rel"] == contract.joints
    expected = 0.05 * (np.arange(12) + 100.0 * np.arange(5)[:, None])
    np.testing.assert_allclose(values["observation joint_vel_rel"], expected, rtol=1e-5)
    assert names["foot_contact"] == ("FR", "FL", "RR", "RL")
    assert values["foot_contact"][:, 0].tolist() == [0.0, 1.0, 0.0, 1.0, 0.0]


def test_an_observation_that_cannot_be_read_is_noted(
    tmp_path: Path, sound: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone(*_: Any) -> None:
        raise WorkflowError("it is gone")

    monkeypatch.setattr(module, "load_policies", gone)
    both = bring_together(*(read_run(sound, more=signals_of) for _ in range(2)))
    assert "sim.mcap: its observation is not compared: it is gone" in both.notes
    assert "action" in both.real
    given = load_policy("go2_velocity")
    fewer = replace(given, observation=replace(given.observation, terms=given.terms[:2]))
    monkeypatch.setattr(module, "load_policies", lambda *_: {"walk": fewer})
    notes: list[str] = []
    signals_of(open_record(sound), notes)
    assert "has 6 values, the record 45; restore the recorded file" in notes[0]


def test_without_a_policy_states_alone_are_compared(tmp_path: Path) -> None:
    held = recorded(
        tmp_path, "held", platform="fake", policies={}, flow={"hold": {"duration": 1.0}}
    )
    notes: list[str] = []
    assert signals_of(open_record(held), notes) == ({}, {})
    assert notes == []
    assert ranks(chain(tmp_path, held, held)) == {}
