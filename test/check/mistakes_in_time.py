"""Mistakes that people make in gait clocks, filters, motions and wheels."""

from __future__ import annotations

from drafts import ALPHA, Draft, swap

# -- gait clocks --------------------------------------------------------------------------------


def phase_exchanged(draft: Draft) -> None:
    """The source has the cosines first, and it was taken for sines first."""
    for term in draft.terms:
        if term["state"].startswith("gait_phase_"):
            term["state"] = {"sin": "gait_phase_cos", "cos": "gait_phase_sin"}[term["state"][-3:]]


def phase_in_degrees(draft: Draft) -> None:
    draft.given["phase"]["offsets"] = [0.0, 180.0]


def phase_stands_in_degrees(draft: Draft) -> None:
    draft.given["phase"]["stand"] = 180.0


def phase_in_milliseconds(draft: Draft) -> None:
    draft.given["phase"]["period"] = 1000.0


# -- filters, feedback, slew -----------------------------------------------------------------


def filter_missing(draft: Draft) -> None:
    del draft.given["action"]["filter"]
    draft.given["action"]["feedback"] = "raw"


def filter_extra(draft: Draft) -> None:
    draft.given["action"]["filter"] = {"low_pass": 1.0}


def filter_turned(draft: Draft) -> None:
    """The program has the weight of the old action."""
    draft.given["action"]["filter"] = {"alpha": 1.0 - ALPHA}


def filter_cut_off(draft: Draft) -> None:
    """α = 0.25 is a cut-off of 2.29 Hz at 50 Hz."""
    draft.given["action"]["filter"] = {"low_pass": 4.0 * 2.29}


def filter_radians(draft: Draft) -> None:
    draft.given["action"]["filter"] = {"low_pass": 2.0 * 3.14159 * 2.29}


def delayed(draft: Draft) -> None:
    """Each action comes 80 ms after its observation, and so does what is fed back."""
    draft.beside["child"] = {"delay": round(0.08 * draft.program.get("rate", 50))}


def feedback_raw(draft: Draft) -> None:
    draft.given["action"]["feedback"] = "raw"


def term_filter_extra(draft: Draft) -> None:
    """Of the last action; what is measured may be smoothed a lot before this policy minds."""
    term = next(t for t in draft.terms if t["state"] == "action")
    term["filter"] = {"moving_average": 5}


# -- motions -----------------------------------------------------------------------------------


def dance_quaternion(draft: Draft) -> None:
    """The reference's quaternion, x first, is taken for one with w first."""
    outputs = draft.given["outputs"]
    outputs["motion_body_quat_w"] = outputs.pop("motion_ref_quat_xyzw")
    draft.given["motion"]["bodies"] = ["torso_link"]


def dance_anchor_misspelt(draft: Draft) -> None:
    draft.given["motion"]["anchor_body"] = "torso"


def dance_ends_first(draft: Draft) -> None:
    draft.given["motion"] |= {"start": 5.0, "end": 2.0}


def dance_exchanged(draft: Draft) -> None:
    """The reference's velocities first."""
    term = next(t for t in draft.terms if t["state"] == "motion_command")
    term["index"] = [*range(29, 58), *range(29)]


def dance_scale(draft: Draft) -> None:
    """The usual scale of walks."""
    draft.given["action"]["scale"] = 0.25


def dance_reference_relative(draft: Draft) -> None:
    """The default pose taken off the reference, too, as off the joints."""
    term = next(t for t in draft.terms if t["state"] == "motion_command")
    term["subtract"] = [*draft.given["default_joint_pos"], *[0.0] * 29]


# -- wheels ------------------------------------------------------------------------------------


def wheels_exchanged(draft: Draft) -> None:
    joints = draft.given["joints"]
    swap(joints, 0, 1)


def wheels_position(draft: Draft) -> None:
    del draft.given["action"]["kind"]


def wheels_stiff(draft: Draft) -> None:
    draft.given["stiffness"] = [10.0, 10.0, 10.0]


def wheels_undamped(draft: Draft) -> None:
    draft.given["damping"] = [0.0, 0.0, 0.5]


def wheels_scale(draft: Draft) -> None:
    draft.given["action.scale"][:2] = [-12.5, -12.5]


def wheels_one_scale(draft: Draft) -> None:
    draft.given["action.scale"][1] *= 0.5


def rims_in_radians(draft: Draft) -> None:
    next(t for t in draft.terms if t["name"] == "rims")["scale"] = 1.0


def turn_upside_down(draft: Draft) -> None:
    next(t for t in draft.terms if t["name"] == "turn")["scale"] = -1.0


def slew_slow(draft: Draft) -> None:
    """In [m/s] for one tick, not in [m/s²]."""
    draft.given["command"]["slew"] = [0.03, 0.02, 0.08]


def slew_zero(draft: Draft) -> None:
    draft.given["command"]["slew"] = [0.0, 0.0, 0.0]


# -- half and twice: a policy walks with them, so several walks are compared --------------------


def damping_half(draft: Draft) -> None:
    draft.given["damping"] = [0.5 * x for x in draft.given["damping"]]


def _period_times(draft: Draft, factor: float) -> None:
    if draft.policy == "mjlab":
        draft.deploy["step_dt"] *= factor
    else:
        draft.given["period"] *= factor


def period_doubled(draft: Draft) -> None:
    _period_times(draft, 2.0)


def period_halved(draft: Draft) -> None:
    _period_times(draft, 0.5)


def phase_halved(draft: Draft) -> None:
    draft.given["phase"]["period"] *= 0.5


def phase_doubled(draft: Draft) -> None:
    draft.given["phase"]["period"] *= 2.0
