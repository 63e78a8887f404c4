"""Which importer reads a deployment's YAML configuration."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from unicon_core.policies.facts import Facts
from unicon_core.policies.importers.booster import booster_facts, is_booster
from unicon_core.policies.importers.deploy_yaml import deploy_yaml_facts, is_deploy_yaml
from unicon_core.policies.importers.env_yaml import env_yaml_facts, is_env_yaml
from unicon_core.policies.importers.legged_gym import is_legged_gym, legged_gym_facts
from unicon_core.policies.importers.rl_sar import is_rl_sar, is_rl_sar_base, rl_sar_facts
from unicon_core.policies.importers.unitree_rl_gym import is_unitree_rl_gym, unitree_rl_gym_facts

_FORMATS = (
    is_deploy_yaml,
    is_env_yaml,
    is_legged_gym,
    is_rl_sar,
    is_rl_sar_base,
    is_unitree_rl_gym,
)


def is_configuration(values: Any) -> bool:
    """Whether a YAML document is of one of the formats that are read here."""
    return any(is_one(values) for is_one in _FORMATS)


def counts_motors(values: Any) -> bool:
    """Whether a YAML document names joints by the numbers of a robot's motors."""
    legs = is_unitree_rl_gym(values) and "leg_joint2motor_idx" in values
    return legs or is_deploy_yaml(values) or is_booster(values)


def configuration_facts(
    path: Path,
    values: Any,
    motors: Mapping[int, str] | None,
    robot_name: str,
    given: Mapping[str, Any],
) -> tuple[Facts, bool] | None:
    """Read a configuration; None where it is of no known format.

    Args:
        path: the file.
        values: its document.
        motors: motor number of the robot's SDK to joint name, or None.
        robot_name: for messages.
        given: facts of the user.

    Returns:
        What it says, and whether it names its network.

    Raises:
        PolicyError: against its format.
    """
    if is_deploy_yaml(values):
        return deploy_yaml_facts(path, motors, robot_name), False
    if is_env_yaml(values):
        return env_yaml_facts(path, given), False
    if is_legged_gym(values):
        return legged_gym_facts(path, given), False
    if is_rl_sar(values) or is_rl_sar_base(values):
        return rl_sar_facts(path), True
    if is_unitree_rl_gym(values):
        return unitree_rl_gym_facts(path, motors, robot_name, given), True
    if is_booster(values):
        return booster_facts(path, motors, robot_name, given), True
    return None
