"""Which states somebody tells: one answer for topics, viewers, reports and metrics."""

from __future__ import annotations

from unicon_core.flow import Block, Stage
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow import HookBlocks, Program
from unicon_ros.bridge.bindings import told_states


def test_the_platform_blocks_hooks_and_the_wind_down_tell_states() -> None:
    def nothing() -> None:
        return None

    def hook(_: Program) -> HookBlocks:
        return {Stage.INPUT: [Block("given", nothing, writes=("by_hook",), endless=True)]}

    states = {name: {"shape": [2]} for name in ("by_hook", "by_ending", "by_nobody")}
    program = Program(
        robot="go2",
        platform="fake",
        rate=50,
        states=states,
        flow=Block("still", nothing, writes=COMMAND_STATES, endless=True),
        wind_down=Block("ending", nothing, writes=(*COMMAND_STATES, "by_ending"), endless=True),
        hooks=[hook],
    )
    told = told_states(program)
    assert {*program.platform.facts.writes, *COMMAND_STATES, "by_hook", "by_ending"} <= told
    assert "by_nobody" not in told
    program.close()
