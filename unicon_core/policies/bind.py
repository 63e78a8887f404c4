"""Binding the network of a policy to arrays, and those to the states, once, when it is built."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from math import prod

import numpy as np

from unicon_base.arrays import Array, Float32
from unicon_base.errors import PolicyError
from unicon_core.policies.contract import ObservationSpec, ObservationTerm, PolicyContract
from unicon_core.policies.networks import Network, Tensor
from unicon_core.policies.observation import Observation
from unicon_core.policies.policy_step import Input, PolicyStep, Published
from unicon_core.policies.prefixed import PackedStates
from unicon_core.policies.terms import TermSlice

_TIME_STEP = "time_step"


class Binding:
    """Arrays for the inputs and outputs of a network: feeds, fetches, and what is published.

    Args:
        contract: the policy.
        states: the states.
        robot_joints: the robot's joint order.
        network: the network.
    """

    def __init__(
        self,
        contract: PolicyContract,
        states: PackedStates,
        robot_joints: Sequence[str],
        network: Network,
    ) -> None:
        self._contract, self._states, self._network = contract, states, network
        self._joints = robot_joints
        self._rows = states.num_robots or 1
        self._tensors_in = {tensor.name: tensor for tensor in network.inputs}
        self._tensors_out = {tensor.name: tensor for tensor in network.outputs}
        self._feeds: dict[str, Array] = {}
        self._fetches: dict[str, Array] = {}
        self._published: list[Published] = []

    def lane(self) -> PolicyStep:
        """Bind the network to arrays and those to the states.

        Raises:
            PolicyError: an input or output that is missing, or of another size or type.
        """
        observation: Observation | None = None
        obs = np.zeros((self._rows, 0), np.float32)
        inputs: list[Input] = []
        self._check_joints()
        for canonical, name in self._contract.inputs.items():
            tensor = self._tensor("input", name, self._tensors_in)
            if canonical == "observation":
                observation = Observation(self._contract, self._states, self._joints)
                self._check_size(observation, tensor)
                self._feeds[name] = obs = np.zeros(observation.shape, np.float32)
                if canonical in self._states:
                    self._published.append((self._view(canonical, observation.size), obs))
            else:
                item = self._input(canonical, tensor)
                self._feeds[name] = item.values if item.cast is None else item.cast
                inputs.append(item)
        action = self._outputs()
        memory = self._memory()
        for name, tensor in self._tensors_in.items():
            if name not in self._feeds:
                raise self._fail(
                    f"nothing feeds input {tensor}; name it in 'inputs' or 'recurrent'"
                )
        return PolicyStep(observation, obs, action, inputs, memory, self._calls(), self._published)

    def _fail(self, message: str) -> PolicyError:
        return PolicyError(f"policy {self._contract.name}: {message}")

    def _tensor(self, what: str, name: str, tensors: dict[str, Tensor]) -> Tensor:
        if name not in tensors:
            listed = ", ".join(str(tensor) for tensor in tensors.values())
            raise self._fail(f"the network has no {what} {name!r}; it has {listed}")
        return tensors[name]

    def _view(self, name: str, size: int) -> Float32:
        """A state as rows of so many elements."""
        view = self._states[name]
        if view.dtype != np.float32 or view.size != self._rows * size:
            raise self._fail(
                f"state {name!r} is {view.dtype} of shape {view.shape}; declare it as float32 "
                f"with {size} elements (policy_states gives it)"
            )
        return view.reshape(self._rows, size)

    def _check_joints(self) -> None:
        """The action has the joints' number; a wrong one is seen in the observation's size, too."""
        action = self._contract.action
        tensor = self._tensors_out.get(self._contract.outputs.get("action", ""))
        if tensor is not None and not tensor.takes(len(action.joints)):
            key = "joints" if action.joints == self._contract.joints else "action.joints"
            raise self._fail(
                f"{key} has {len(action.joints)} names, the network's output {tensor.name!r} "
                f"{tensor.width} values: {', '.join(action.joints)}; {self._remedy(key)}"
            )

    def _remedy(self, key: str) -> str:
        contract = self._contract
        if contract.source == "policy.yaml":
            return f"correct {key} in {contract.path.name}"
        return f"give {key} under 'given'"

    def _check_size(self, observation: Observation, tensor: Tensor) -> None:
        if tensor.dtype != "float32":
            raise self._fail(f"input {tensor} is not float32; export the network in float32")
        takes = tensor.width
        if not isinstance(takes, int) or takes == observation.size:
            return
        start, parts = 0, []
        for part in observation.slices:
            elements, history = part.elements.size, part.term.history
            width = elements * history
            times = f" = {elements} × {history}" if history > 1 else ""
            parts.append(f"{part.term.name} [{start}:{start + width}]{times}")
            start += width
        contract = self._contract
        counts = [len(each) for each in (self._joints, contract.joints, contract.action.joints)]
        why = explain_size(observation.slices, takes, self._joints, counts)
        raise self._fail(
            f"the observation has {observation.size} values and the network's input "
            f"{tensor.name!r} takes {takes}"
            + (f": {why}" if why else f"; terms: {', '.join(parts)}")
            + f"; {self._remedy('observation.terms')}"
        )

    def _input(self, canonical: str, tensor: Tensor) -> Input:
        """An input that takes a state, or counts the calls."""
        if canonical == _TIME_STEP and _TIME_STEP not in self._states:
            values, gather = np.zeros((self._rows, 1), np.float32), None
        else:
            spec = ObservationSpec((ObservationTerm(canonical, canonical),))
            gather = Observation(self._contract, self._states, self._joints, spec)
            values = np.zeros(gather.shape, np.float32)
            if not tensor.takes(gather.size):
                raise self._fail(
                    f"input {tensor} takes {tensor.width} values and state {canonical!r} has "
                    f"{gather.size}; correct 'inputs' or 'joints'"
                )
        return Input(
            gather, values, None if tensor.dtype == "float32" else values.astype(tensor.dtype)
        )

    def _outputs(self) -> Float32:
        """Fetch the action, which is returned, and the outputs that are states."""
        joints, outputs = self._contract.action.joints, self._contract.outputs
        if "action" not in outputs:
            raise self._fail("'outputs' names no action; add 'outputs: {action: NAME}'")
        action = np.zeros((self._rows, len(joints)), np.float32)
        for canonical, name in outputs.items():
            tensor = self._tensor("output", name, self._tensors_out)
            if canonical == "action":
                self._fetches[name] = action
                if canonical in self._states:
                    self._published.append((self._view(canonical, len(joints)), action))
            elif canonical in self._states:
                width = self._states[canonical].size // self._rows
                axes = [axis for axis in tensor.shape[1:] if isinstance(axis, int)]
                if len(axes) < len(tensor.shape[1:]) or prod(axes) != width:
                    raise self._fail(
                        f"output {tensor} does not fill state {canonical!r} of {width} elements; "
                        "correct 'outputs'"
                    )
                self._fetches[name] = values = np.zeros((self._rows, *axes), np.float32)
                rows = values.reshape(self._rows, width)
                self._published.append((self._view(canonical, width), rows))
        return action

    def _memory(self) -> list[tuple[Array, Array]]:
        """Feed and fetch what is recurrent; return each output with its input."""
        memory = []
        for pair in self._contract.recurrent:
            target = self._tensor("recurrent input", pair.input, self._tensors_in)
            source = self._tensor("recurrent output", pair.output, self._tensors_out)
            if target.shape != source.shape or target.dtype != source.dtype:
                raise self._fail(f"recurrent {target} and {source} differ; correct 'recurrent'")
            if self._rows > 1 and not target.free_batch:
                raise self._fail(
                    f"its memory {target} is of one robot and there are num_robots {self._rows}; "
                    "export it with a free first axis, or run one workflow for each robot"
                )
            shape = [axis if isinstance(axis, int) else 1 for axis in target.shape]
            if target.free_batch:
                shape[0] = self._rows
            self._feeds[pair.input] = np.zeros(shape, target.dtype)
            self._fetches[pair.output] = np.zeros(shape, target.dtype)
            memory.append((self._fetches[pair.output], self._feeds[pair.input]))
        return memory

    def _calls(self) -> list[Callable[[], None]]:
        """One call for all rows where every first axis is free, else one for each row."""
        tensors = {**self._tensors_in, **self._tensors_out}
        used = [tensors[name] for name in (*self._feeds, *self._fetches)]
        batched = [tensor for tensor in used if len(tensor.shape) > 1]
        slices = [slice(None)]
        if self._rows > 1 and not (
            len(batched) == len(used)
            and all(t.free_batch or t.shape[0] == self._rows for t in batched)
        ):
            slices = [slice(i, i + 1) for i in range(self._rows)]
            for tensor in batched:
                if not tensor.free_batch and tensor.shape[0] != 1:
                    raise self._fail(
                        f"{tensor} is for {tensor.shape[0]} robots at once and there are "
                        f"{self._rows}; export it with a free batch axis"
                    )

        def part(arrays: dict[str, Array], row: slice) -> dict[str, Array]:
            return {
                name: array[row].reshape(-1) if len(tensors[name].shape) == 1 else array[row]
                for name, array in arrays.items()
            }

        return [
            self._network.bind(part(self._feeds, row), part(self._fetches, row)) for row in slices
        ]


# Values of what most policies see, the last one of one phase.
_OFTEN = {"projected_gravity": 3, "base_ang_vel": 3, "velocity_command": 3, "gait_phase": 2}
# Many policies do without: it is named where nothing else would fit.
_SELDOM = {"base_lin_vel": 3}


def explain_size(
    slices: Sequence[TermSlice], takes: int, joints: Collection[str], counts: Collection[int]
) -> str:
    """Return what would make the observation fit; "" where nothing or more than one thing would.

    Args:
        slices: the terms.
        takes: size of the network's input.
        joints: names of the robot's joints.
        counts: plausible numbers of joints: the robot's, the policy's, the network's.
    """
    missing = takes - sum(part.elements.size * part.term.history for part in slices)
    moved = [part for part in slices if not {*joints}.isdisjoint(part.names)]
    found = {text for count in counts for text in _of_joints(moved, count, missing)}
    histories = {part.term.history for part in slices}
    frame = sum(part.elements.size for part in slices)
    history = max(histories) if len(histories) == 1 else 1
    if len(histories) == 1 and takes % frame == 0:
        found.add(f"it would fit with a history of {takes // frame}, and has {history}")
    seen = " ".join(part.term.state for part in slices).replace("slewed", "velocity")
    for usual in (_OFTEN, _SELDOM):
        for name, size in usual.items() if usual is _OFTEN or not found else ():
            if name not in seen and missing == size * history:
                found.add(f"it would fit with a term of {name} ({size} values)")
    return found.pop() if len(found) == 1 else ""


def _of_joints(parts: Sequence[TermSlice], count: int, missing: int) -> set[str]:
    """Return which terms of one size make up for what is missing if they have so many joints."""
    found = set()
    for size in {part.elements.size for part in parts} - {count}:
        alike = [part for part in parts if part.elements.size == size]
        histories = [part.term.history for part in alike]
        # Of some of them it cannot be told which, and how many only if all have the same history.
        many = len(alike) * missing / ((count - size) * sum(histories))
        if many == len(alike) or (many in range(1, len(alike)) and len({*histories}) == 1):
            some = "" if many == len(alike) else f"{many:g} of "
            has = f"{size} of {count} joints" if count > size else f"{size} joints, not {count},"
            found.add(f"it has {has} in {some}{', '.join(part.term.name for part in alike)}")
    return found
