"""Policies: networks with their contracts, from whatever format, as blocks."""

from unicon_core.policies.action_map import TermSlice, term_slices
from unicon_core.policies.contract import (
    ActionSpec,
    ObservationSpec,
    ObservationTerm,
    PhaseSpec,
    PolicyContract,
    Recurrent,
)
from unicon_core.policies.hints import MotionSpec
from unicon_core.policies.load import ImportReport, import_policy, load_policy, policy_names
from unicon_core.policies.observation import Observation
from unicon_core.policies.phase import GaitPhase
from unicon_core.policies.policy import Policy
from unicon_core.policies.policy_states import policy_states
from unicon_core.policies.policy_yaml import write_policy_yaml
from unicon_core.policies.table import (
    joint_rows,
    joint_table,
    observation_rows,
    observation_table,
    policies_rows,
    policies_table,
    policy_table,
)

__all__ = [
    "ActionSpec",
    "GaitPhase",
    "ImportReport",
    "MotionSpec",
    "Observation",
    "ObservationSpec",
    "ObservationTerm",
    "PhaseSpec",
    "Policy",
    "PolicyContract",
    "Recurrent",
    "TermSlice",
    "import_policy",
    "joint_rows",
    "joint_table",
    "load_policy",
    "observation_rows",
    "observation_table",
    "policies_rows",
    "policies_table",
    "policy_names",
    "policy_states",
    "policy_table",
    "term_slices",
    "write_policy_yaml",
]
