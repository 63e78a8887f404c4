"""Which importer reads a deployment's YAML configuration."""

from __future__ import annotations

from typing import Any

from unicon_core.policies.facts import Facts
from unicon_core.policies.importers.booster import booster_facts, is_booster
from unicon_core.policies.importers.deploy_yaml import deploy_yaml_facts, is_deploy_yaml
from unicon_core.policies.importers.env_yaml import env_yaml_facts, is_env_yaml
from unicon_core.policies.importers.legged_gym import is_legged_gym, legged_gym_facts
from unicon_core.policies.importers.rl_sar import is_rl_sar, is_rl_sar_base, rl_sar_facts
from unicon_core.policies.importers.source_reader import Source
from unicon_core.policies.importers.unitree_rl_gym import is_unitree_rl_gym, unitree_rl_gym_facts

_READERS = {
    is_deploy_yaml: deploy_yaml_facts,
    is_env_yaml: env_yaml_facts,
    is_legged_gym: legged_gym_facts,
    is_rl_sar: rl_sar_facts,
    is_rl_sar_base: rl_sar_facts,
    is_unitree_rl_gym: unitree_rl_gym_facts,
    is_booster: booster_facts,
}
"""Whether a document is of a format -> its reader; the first one counts."""


def is_configuration(values: Any) -> bool:
    """Whether a YAML document is of one of the formats that are read here."""
    return any(is_one(values) for is_one in _READERS)


def counts_motors(values: Any) -> bool:
    """Whether a YAML document names joints by the numbers of a robot's motors."""
    legs = is_unitree_rl_gym(values) and "leg_joint2motor_idx" in values
    return legs or is_deploy_yaml(values) or is_booster(values)


def configuration_facts(source: Source) -> Facts | None:
    """Return what a configuration says; None where it is of no known format.

    Raises:
        PolicyError: it is against its format.
    """
    readers = (read for is_one, read in _READERS.items() if is_one(source.located.value))
    read = next(readers, None)
    return None if read is None else read(source)
