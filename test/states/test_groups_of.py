"""The groups of a workflow: what is measured, and what leaves for the motors."""

from __future__ import annotations

from unicon_core.states import Layout, StateSpec, standard_states
from unicon_core.states.groups import groups_of
from unicon_core.states.standard import COMMAND_STATES


def test_commands_are_a_group_of_their_own():
    groups = groups_of(Layout(standard_states(["hip", "knee"]), num_robots=3))
    assert list(groups) == ["measured", "command"]
    assert tuple(groups["command"].specs) == COMMAND_STATES
    assert not set(groups["measured"].specs) & set(COMMAND_STATES)
    assert {layout.num_robots for layout in groups.values()} == {3}


def test_a_group_without_states_is_left_out():
    assert list(groups_of(Layout({"lamp": StateSpec()}))) == ["measured"]
    assert list(groups_of(Layout({"joint_damping": StateSpec((2,))}))) == ["command"]
    assert groups_of(Layout({})) == {}
