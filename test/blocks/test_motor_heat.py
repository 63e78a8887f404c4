"""motor_heat: temperatures that follow the squared torque, and cool down."""

from __future__ import annotations

import numpy as np
import pytest

from unicon_base.errors import UniconError
from unicon_core.workflow import Program, load_document


def heated(folder, options, ticks, offset=0.1):
    path = folder / "w.yaml"
    path.write_text(
        "robot: go2\nplatform: fake\nrate: 50\nflow: hold\n"
        f"deferred: [{{motor_heat: {{{options}}}}}]\n"
    )
    program = Program(load_document(path))
    states = program.states
    tick = next(block.tick for block in program.blocks if block.name == "motor_heat")
    states["joint_stiffness"][...] = 60.0
    states["joint_pos_target"][...] = states["joint_pos"] + np.float32(offset)
    rows = [states["motor_temperature"].copy()]
    for _ in range(ticks):
        tick()
        rows.append(states["motor_temperature"].copy())
    program.close()
    return np.array(rows)


def test_it_goes_to_what_the_torque_heats_it_to(tmp_path):
    """6 N·m, 0.5 K/(N·m)²: 18 K in the end, 63 % of them after the time constant."""
    rows = heated(tmp_path, "rise: 0.5, time_constant: 2.0, ambient: 20.0", 1000)
    assert rows[0].tolist() == [20.0] * 12
    assert rows[100, 0] == pytest.approx(20.0 + 18.0 * (1.0 - np.exp(-1.0)), abs=0.01)
    assert rows[-1, 0] == pytest.approx(38.0, abs=0.01)


def test_a_slow_motor_is_not_lost_to_rounding(tmp_path):
    rows = heated(tmp_path, "rise: 0.001, time_constant: 1000.0", 2000)
    assert rows[-1, 0] == pytest.approx(25.0 + 0.036 * (1.0 - np.exp(-0.04)), abs=1e-4)


def test_torque_ends_at_the_limit(tmp_path):
    rows = heated(tmp_path, "rise: 0.1, time_constant: 0.1", 100, offset=10.0)
    assert rows[-1, 0] == pytest.approx(25.0 + 0.1 * 23.7**2, rel=1e-3)


@pytest.mark.parametrize(
    "options", ["rise: -1", "rise: .inf", "ambient: 200", "ambient: .nan", "time_constant: 0"]
)
def test_nonsense_is_refused(tmp_path, options):
    with pytest.raises(UniconError, match=options.split(":")[0]):
        heated(tmp_path, options, 1)


def test_the_bench_builds_it(bench):
    with pytest.raises(UniconError, match="motor_temperature"):
        bench().block("motor_heat")  # no workflow declared its state
