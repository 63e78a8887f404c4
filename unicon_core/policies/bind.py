"""Binding the network of a policy to arrays, and those to the states, once, when it is built."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import PolicyError
from unicon_core.policies.contract import ObservationSpec, ObservationTerm, PolicyContract
from unicon_core.policies.lane import Input, Lane, Published
from unicon_core.policies.networks import Network, Tensor
from unicon_core.policies.observation import Observation
from unicon_core.policies.terms import PackedStates

__all__ = ["build_lane"]

_TIME_STEP = "time_step"


def build_lane(
    contract: PolicyContract,
    states: PackedStates,
    robot_joints: Sequence[str],
    network: Network,
) -> Lane:
    """Bind a network to arrays and those to the states.

    Args:
        contract: the policy.
        states: the states.
        robot_joints: the robot's joint order.
        network: the network.

    Raises:
        PolicyError: an input or output that is missing, or of another size or type.
    """
    rows = states.num_robots or 1
    label = f"policy {contract.name}"
    tensors_in = {tensor.name: tensor for tensor in network.inputs}
    tensors_out = {tensor.name: tensor for tensor in network.outputs}
    feeds: dict[str, NDArray[Any]] = {}
    fetches: dict[str, NDArray[Any]] = {}
    observation: Observation | None = None
    obs = np.zeros((rows, 0), np.float32)
    inputs: list[Input] = []
    published: list[Published] = []
    for canonical, name in contract.inputs.items():
        tensor = _tensor(label, "input", name, tensors_in)
        if canonical == "observation":
            observation = Observation(contract, states, robot_joints)
            _check_size(label, contract, observation, tensor)
            obs = np.zeros(observation.shape, np.float32)
            if "observation" in states:
                view = _rows(states["observation"], rows, observation.size, "observation", label)
                published.append((view, obs))
            feeds[name] = obs
            continue
        if canonical == _TIME_STEP and _TIME_STEP not in states:
            values, gather = np.zeros((rows, 1), np.float32), None
        else:
            term = ObservationTerm(canonical, canonical)
            gather = Observation(contract, states, robot_joints, ObservationSpec((term,)))
            values = np.zeros(gather.shape, np.float32)
            size = tensor.shape[-1] if tensor.shape else 1
            if isinstance(size, int) and size != gather.size:
                raise PolicyError(
                    f"{label}: input {tensor} takes {size} values and state {canonical!r} has "
                    f"{gather.size}; correct 'inputs' or 'joints'"
                )
        cast = None if tensor.dtype == "float32" else values.astype(tensor.dtype)
        inputs.append(Input(gather, values, cast))
        feeds[name] = values if cast is None else cast
    action = _bind_outputs(contract, states, rows, tensors_out, fetches, published)
    memory = []
    for pair in contract.recurrent:
        target = _tensor(label, "recurrent input", pair.input, tensors_in)
        source = _tensor(label, "recurrent output", pair.output, tensors_out)
        if target.shape != source.shape or target.dtype != source.dtype:
            raise PolicyError(
                f"{label}: recurrent {target} and {source} differ; correct 'recurrent'"
            )
        shape = tuple(axis if isinstance(axis, int) else 1 for axis in target.shape)
        if rows > 1:
            raise PolicyError(
                f"{label}: it is recurrent and can drive one robot, not num_robots {rows}; "
                "run one workflow for each robot"
            )
        feeds[pair.input] = np.zeros(shape, target.dtype)
        fetches[pair.output] = np.zeros(shape, target.dtype)
        memory.append((fetches[pair.output], feeds[pair.input]))
    unfed = [str(tensor) for name, tensor in tensors_in.items() if name not in feeds]
    if unfed:
        raise PolicyError(
            f"{label}: nothing feeds input {unfed[0]}; name it in 'inputs' or 'recurrent'"
        )
    runs = _bind(label, network, feeds, fetches, rows, {**tensors_in, **tensors_out})
    return Lane(observation, obs, action, inputs, memory, runs, published)


def _bind(
    label: str,
    network: Network,
    feeds: dict[str, NDArray[Any]],
    fetches: dict[str, NDArray[Any]],
    rows: int,
    tensors: dict[str, Tensor],
) -> list[Callable[[], None]]:
    """One call for all rows where every first axis is free, else one for each row."""
    flat = {name for name, t in tensors.items() if len(t.shape) == 1}

    def part(name: str, array: NDArray[Any], row: slice) -> NDArray[Any]:
        piece = array[row]
        return piece.reshape(-1) if name in flat else piece

    used = [tensors[name] for name in (*feeds, *fetches)]
    whole = rows == 1 or all(
        len(tensor.shape) > 1 and (tensor.free_batch or tensor.shape[0] == rows) for tensor in used
    )
    slices = [slice(None)] if whole else [slice(i, i + 1) for i in range(rows)]
    for tensor in used:
        if (
            not whole
            and len(tensor.shape) > 1
            and isinstance(tensor.shape[0], int)
            and tensor.shape[0] != 1
        ):
            raise PolicyError(
                f"{label}: {tensor} is for {tensor.shape[0]} robots at once and there are {rows}; "
                "export it with a free batch axis"
            )
    return [
        network.bind(
            {name: part(name, array, row) for name, array in feeds.items()},
            {name: part(name, array, row) for name, array in fetches.items()},
        )
        for row in slices
    ]


def _bind_outputs(
    contract: PolicyContract,
    states: PackedStates,
    rows: int,
    tensors: dict[str, Tensor],
    fetches: dict[str, NDArray[Any]],
    published: list[Published],
) -> NDArray[np.float32]:
    label = f"policy {contract.name}"
    count = len(contract.action.joints)
    if "action" not in contract.outputs:
        raise PolicyError(f"{label}: 'outputs' names no action; add 'outputs: {{action: NAME}}'")
    action = np.zeros((rows, count), np.float32)
    for canonical, name in contract.outputs.items():
        tensor = _tensor(label, "output", name, tensors)
        size = tensor.shape[-1] if tensor.shape else 1
        if canonical == "action":
            if isinstance(size, int) and size != count:
                raise PolicyError(
                    f"{label}: output {tensor} has {size} values for {count} joints "
                    f"({', '.join(contract.action.joints)}); correct 'joints' or 'action.joints'"
                )
            if "action" in states:
                published.append((_rows(states["action"], rows, count, "action", label), action))
            fetches[name] = action
        elif canonical in states:
            width = states[canonical].size // rows
            if (
                any(not isinstance(axis, int) for axis in tensor.shape[1:])
                or prod(axis for axis in tensor.shape[1:] if isinstance(axis, int)) != width
            ):
                raise PolicyError(
                    f"{label}: output {tensor} does not fill state {canonical!r} of {width} "
                    "elements; correct 'outputs'"
                )
            view = _rows(states[canonical], rows, width, canonical, label)
            fetches[name] = np.zeros((rows, *(int(axis) for axis in tensor.shape[1:])), np.float32)
            published.append((view, fetches[name].reshape(rows, width)))
    return action


def _tensor(label: str, what: str, name: str, tensors: dict[str, Tensor]) -> Tensor:
    if name not in tensors:
        listed = ", ".join(str(tensor) for tensor in tensors.values())
        raise PolicyError(f"{label}: the network has no {what} {name!r}; it has {listed}")
    return tensors[name]


def _rows(view: NDArray[Any], rows: int, size: int, name: str, label: str) -> NDArray[np.float32]:
    if view.dtype != np.float32 or view.size != rows * size:
        raise PolicyError(
            f"{label}: state {name!r} is {view.dtype} of shape {view.shape}; declare it as float32 "
            f"with {size} elements (policy_states gives it)"
        )
    return view.reshape(rows, size)


def _check_size(
    label: str, contract: PolicyContract, observation: Observation, tensor: Tensor
) -> None:
    size = tensor.shape[-1] if tensor.shape else 1
    if tensor.dtype != "float32":
        raise PolicyError(f"{label}: input {tensor} is no float32; export the network in float32")
    if not isinstance(size, int) or size == observation.size:
        return
    start, parts = 0, []
    for name, (elements, history) in observation.table().items():
        width = elements * history
        times = f" = {elements} × {history}" if history > 1 else ""
        parts.append(f"{name} [{start}:{start + width}]{times}")
        start += width
    raise PolicyError(
        f"{label}: the observation has {observation.size} values and the network's input "
        f"{tensor.name!r} takes {size}; terms: {', '.join(parts)}; correct observation.terms in "
        f"{contract.path.name}"
    )
