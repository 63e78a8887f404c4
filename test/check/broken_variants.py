"""Makes broken variants of the assets' policies and of our own, for the tests of `unicon check`.

Each variant is the good workflow with one mistake that people make; `python broken_variants.py DIR`
writes them all. `culprit` must be named by the first finding; `twin` says that only a run in MuJoCo
can show the mistake.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from drafts import ROOT, WORKFLOWS, Draft
from mistakes import (
    deploy_action,
    deploy_extra_term,
    deploy_gains,
    deploy_gravity,
    deploy_left_right,
    deploy_missing_joint,
    deploy_names_only,
    deploy_no_weights,
    deploy_order,
    deploy_pose,
    deploy_scale,
    deploy_swapped_gains,
    deploy_terms,
    given_absolute,
    given_action,
    given_extra_term,
    given_front_rear,
    given_gravity,
    given_left_right,
    given_missing_joint,
    given_misspelt,
    given_names_only,
    given_no_phase,
    given_one_side,
    given_order,
    given_pose,
    given_scale,
    given_stiff,
    given_swapped_gains,
    given_terms,
    given_training_order,
    low_effort,
    metadata_gains,
    metadata_legs_gains,
    metadata_missing_joint,
    metadata_no_damping,
    metadata_order,
    metadata_twice,
    milliseconds,
    no_collision,
    other_network,
    passive_damping,
    two_rates,
)
from mistakes_in_time import (
    damping_half,
    dance_anchor_misspelt,
    dance_ends_first,
    dance_exchanged,
    dance_quaternion,
    dance_reference_relative,
    dance_scale,
    delayed,
    feedback_raw,
    filter_cut_off,
    filter_extra,
    filter_missing,
    filter_radians,
    filter_turned,
    period_doubled,
    period_halved,
    phase_doubled,
    phase_exchanged,
    phase_halved,
    phase_in_degrees,
    phase_in_milliseconds,
    phase_stands_in_degrees,
    rims_in_radians,
    slew_slow,
    slew_zero,
    term_filter_extra,
    turn_upside_down,
    wheels_exchanged,
    wheels_one_scale,
    wheels_position,
    wheels_scale,
    wheels_stiff,
    wheels_undamped,
)

__all__ = ["VARIANTS", "WORKFLOWS", "Draft", "Variant"]


@dataclass(frozen=True)
class Variant:
    """One mistake.

    Attributes:
        policy: `mjlab`, `go1`, `holosoma` or `go2`.
        name: of the mistake, also of the file.
        culprit: what must be named.
        twin: whether it takes a run in MuJoCo.
        change: changes the draft in place.
    """

    policy: str
    name: str
    culprit: str
    twin: bool
    change: Callable[[Draft], None]

    def write(self, folder: Path, assets: Path) -> Path:
        """Write the workflow and what belongs to it into a folder; return the workflow."""
        draft = Draft(self.policy, folder, assets)
        self.change(draft)
        return draft.write()


def _listed() -> Iterator[Variant]:
    def of(policy: str, *entries: tuple[str, str, bool, Callable[[Draft], None]]) -> list[Variant]:
        return [Variant(policy, *entry) for entry in entries]

    yield from of(
        "mjlab",
        ("delayed", "child.delay", True, delayed),
        ("period_doubled", "policy 'walk', period", True, period_doubled),
        ("order", "joint order", True, deploy_order),
        ("names_only", "joints", False, deploy_names_only),
        ("left_right", "joint order", True, deploy_left_right),
        ("gains_permuted", "stiffness", False, deploy_gains),
        ("gains_swapped", "stiffness and damping", False, deploy_swapped_gains),
        ("gravity", "projected_gravity", True, deploy_gravity),
        ("scale", "observation scales", True, deploy_scale),
        ("pose", "default_joint_pos", False, deploy_pose),
        ("action_scale", "action.scale", False, deploy_action),
        ("two_rates", "rate", False, two_rates),
        ("missing_joint", "joint_ids_map", False, deploy_missing_joint),
        ("extra_term", "base_lin_vel", False, deploy_extra_term),
        ("terms_order", "base_ang_vel", True, deploy_terms),
        ("no_weights", "policy.onnx.data", False, deploy_no_weights),
        ("passive_damping", "passive damping", True, passive_damping),
        ("low_effort", "effort of ", False, low_effort),
    )
    yield from of(
        "go1",
        ("order", "joint order", True, given_order),
        ("names_only", "joints", False, given_names_only),
        ("left_right", "joint order", True, given_left_right),
        ("front_rear", "joint order", True, given_front_rear),
        ("gravity", "projected_gravity", True, given_gravity),
        ("scale", "observation scales", True, given_scale),
        ("pose", "default_joint_pos", True, given_pose),
        ("one_side", "default_joint_pos", False, given_one_side),
        ("action_scale", "action.scale", False, given_action),
        ("milliseconds", "period", False, milliseconds),
        ("two_rates", "rate", False, two_rates),
        ("missing_joint", "default_joint_pos", False, given_missing_joint),
        ("misspelt_joint", "FL_tigh_joint", False, given_misspelt),
        ("extra_term", "acceleration", False, given_extra_term),
        ("terms_order", "gyro", True, given_terms),
        ("gains_swapped", "stiffness and damping", False, given_swapped_gains),
        ("stiff", "stiffness", False, given_stiff),
        ("passive_damping", "passive damping", True, passive_damping),
        ("no_collision", "collision geometry", False, no_collision),
        ("low_effort", "effort of ", False, low_effort),
    )
    yield from of(
        "holosoma",
        ("delayed", "child.delay", True, delayed),
        ("order", "joint order", True, metadata_order),
        ("gains_reversed", "stiffness", False, metadata_gains),
        ("gains_of_legs", "gains", True, metadata_legs_gains),
        ("no_damping", "damping", False, metadata_no_damping),
        ("gravity", "projected_gravity", True, given_gravity),
        ("scales", "scale", True, given_scale),
        ("pose", "default_joint_pos", False, given_pose),
        ("one_side", "default_joint_pos", False, given_one_side),
        ("action_scale", "action.scale", True, given_action),
        ("two_rates", "rate", False, two_rates),
        ("missing_joint", "dof_names", False, metadata_missing_joint),
        ("extra_term", "acceleration", False, given_extra_term),
        ("terms_order", "observation.terms", True, given_terms),
        ("training_order", "observation.terms", True, given_training_order),
        ("no_phase", "phase", False, given_no_phase),
        ("absolute", "dof_pos", True, given_absolute),
        ("phase_exchanged", "order of sines and cosines", True, phase_exchanged),
        ("phase_halved", "phase.period", True, phase_halved),
        ("phase_doubled", "phase.period", True, phase_doubled),
        ("period_halved", "policy 'walk', period", True, period_halved),
        ("phase_in_degrees", "phase.offsets", False, phase_in_degrees),
        ("phase_stands_in_degrees", "phase.stand", False, phase_stands_in_degrees),
        ("phase_in_milliseconds", "phase.period", False, phase_in_milliseconds),
        ("metadata_twice", "kp", False, metadata_twice),
        ("passive_damping", "passive damping", True, passive_damping),
        ("low_effort", "effort of ", False, low_effort),
    )

    yield from of(
        "go2",
        ("delayed", "child.delay", True, delayed),
        ("period_doubled", "policy 'walk', period", True, period_doubled),
        ("order", "joint order", True, given_order),
        ("names_only", "default_joint_pos", False, given_names_only),
        ("left_right", "joint order", True, given_left_right),
        ("front_rear", "joint order", True, given_front_rear),
        ("gravity", "projected_gravity", True, given_gravity),
        ("scales", "observation scales", True, given_scale),
        ("pose", "default_joint_pos", False, given_pose),
        ("one_side", "default_joint_pos", False, given_one_side),
        ("action_scale", "action.scale", False, given_action),
        ("milliseconds", "period", False, milliseconds),
        ("two_rates", "rate", False, two_rates),
        ("missing_joint", "default_joint_pos", False, given_missing_joint),
        ("misspelt_joint", "FL_tigh_joint", False, given_misspelt),
        ("extra_term", "acceleration", False, given_extra_term),
        ("terms_order", "base_ang_vel", True, given_terms),
        ("absolute", "joint_pos_rel", True, given_absolute),
        ("gains_swapped", "stiffness", False, given_swapped_gains),
        ("stiff", "stiffness", False, given_stiff),
        ("other_network", "sha256", False, other_network),
        ("passive_damping", "passive damping", True, passive_damping),
        ("no_collision", "collision geometry", False, no_collision),
        ("low_effort", "effort of ", False, low_effort),
    )

    yield from of(
        "bare",
        ("names_only", "joints", False, given_names_only),
        ("pose", "default_joint_pos", True, given_pose),
        ("one_side", "default_joint_pos", False, given_one_side),
        ("action_scale", "action.scale", True, given_action),
        ("gains_swapped", "stiffness and damping", False, given_swapped_gains),
        ("stiff", "stiffness", False, given_stiff),
        ("missing_joint", "default_joint_pos", False, given_missing_joint),
        ("misspelt_joint", "FL_tigh_joint", False, given_misspelt),
        ("gravity", "projected_gravity", True, given_gravity),
        ("terms_order", "base_ang_vel", True, given_terms),
        ("damping_half", "policy 'walk', damping", True, damping_half),
        ("filter_extra", "action.filter", True, filter_extra),
        ("term_filter_extra", "filter of term 'last_action'", True, term_filter_extra),
    )

    yield from of(
        "filtered",
        ("filter_missing", "action.filter", True, filter_missing),
        ("filter_turned", "action.filter", True, filter_turned),
        ("filter_cut_off", "action.filter", True, filter_cut_off),
        ("filter_radians", "action.filter", True, filter_radians),
        ("feedback_raw", "action.feedback", True, feedback_raw),
        ("order", "joint order", True, given_order),
        ("left_right", "joint order", True, given_left_right),
        ("gravity", "projected_gravity", True, given_gravity),
        ("scales", "observation scales", True, given_scale),
        ("milliseconds", "period", False, milliseconds),
    )

    yield from of(
        "rover",
        ("wheels_exchanged", "joint order", True, wheels_exchanged),
        ("wheels_position", "action.kind", False, wheels_position),
        ("wheels_stiff", "stiffness", False, wheels_stiff),
        ("wheels_undamped", "damping", False, wheels_undamped),
        ("wheels_scale", "action.scale", True, wheels_scale),
        ("wheels_one_scale", "action.scale", False, wheels_one_scale),
        ("rims_in_radians", "rims", True, rims_in_radians),
        ("turn_upside_down", "turn", True, turn_upside_down),
        ("slew_slow", "command.slew", True, slew_slow),
        ("slew_zero", "slew", False, slew_zero),
    )

    yield from of(
        "dance",
        ("quaternion", "motion_body_quat_w", False, dance_quaternion),
        ("anchor_misspelt", "anchor_body", False, dance_anchor_misspelt),
        ("ends_first", "motion.end", False, dance_ends_first),
        ("exchanged", "order within 'motion_command'", True, dance_exchanged),
        ("scale", "action.scale", True, dance_scale),
        ("reference_relative", "subtract of 'motion_command'", True, dance_reference_relative),
        ("terms_order", "observation.terms", False, given_terms),
        ("absolute", "observation.terms[2].subtract", False, given_absolute),
        ("pose", "default_joint_pos", False, given_pose),
        ("one_side", "default_joint_pos", False, given_one_side),
        ("two_rates", "rate", False, two_rates),
        ("low_effort", "effort of ", False, low_effort),
    )


VARIANTS = tuple(_listed())


def main() -> None:
    """Write all variants below a folder, for a look by hand."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--assets", type=Path, default=ROOT.parent / "shared" / "assets")
    arguments = parser.parse_args()
    for variant in VARIANTS:
        folder = arguments.folder / variant.policy / variant.name
        print(variant.write(folder, arguments.assets))


if __name__ == "__main__":
    main()
