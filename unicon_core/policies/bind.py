"""Binding the network of a policy to arrays, and those to the states, once, when it is built."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from math import isfinite, prod
from typing import TypeAlias

import numpy as np

from unicon_base.arrays import Array, Float32
from unicon_base.errors import PolicyError
from unicon_core.policies.contract import ObservationSpec, ObservationTerm, PolicyContract
from unicon_core.policies.controller import PackedStates
from unicon_core.policies.networks import Network, Remembering, Tensor
from unicon_core.policies.observation import Observation, TermSlice, nothing
from unicon_core.policies.phase import Filter

Published: TypeAlias = tuple[Float32, Float32]


@dataclass
class Input:
    """An input beside the observation: a state, or the number of calls since the reset."""

    memory = ("gather",)

    gather: Observation | None
    values: Float32
    cast: Array | None

    def __post_init__(self) -> None:
        self.write = None if self.gather is None else self.gather.bind(self.values)
        self.finite = finite_check(self.values)


@dataclass(eq=False)
class PolicyStep:
    """Arrays and bound calls.

    Attributes:
        observation: assembles the input vector, or None.
        obs: the input vector, shape (rows, size).
        action: the output, shape (rows, m).
        inputs: what else the network takes.
        recurrent: outputs of the network and the inputs that they are fed back to.
        runs: calls of the network, one for all rows or one for each.
        published: views of states and the arrays here that are copied into them after a tick.
        assemble: writes the inputs of this tick; until `advance` it may be done again and again.
        finite: tells whether observation and other inputs hold neither NaN nor infinity.
        infer: runs the network on what is assembled; what it remembers stays as it is.
        action_finite: tells whether the output holds neither NaN nor infinity.
        advance: goes on to the next tick: the history takes the frame, the network's memory is fed
            back; with True, after a warm-up, it does nothing.
        first_step: what an input that counts the calls begins with; see `reset`.
        held: for so many calls after `step_zero` it stays at that.
    """

    memory = ("observation", "action", "inputs", "recurrent", "_remembering", "_smooth", "_steps")

    observation: Observation | None
    obs: Float32
    action: Float32
    inputs: list[Input]
    recurrent: list[tuple[Array, Array]]
    runs: list[Callable[[], None]]
    published: list[Published]

    def __post_init__(self) -> None:
        self.infer = self.runs[0] if len(self.runs) == 1 else self._run_rows
        self._remembering = tuple(run for run in self.runs if isinstance(run, Remembering))
        self._write, self._advance = nothing, nothing
        if self.observation is not None:
            self._write, self._advance = self.observation.bind_parts(self.obs)
        self._obs_finite = finite_check(self.obs)
        self.action_finite = finite_check(self.action)
        self._steps = self.first_step = self.held = 0.0
        self._smooth: Filter | None = None
        # What has neither inputs nor a memory skips them: what only the tick runs is cold then.
        only = not self.inputs
        self.assemble = self._write if only else self._assemble
        self.finite = self._obs_finite if only else self._finite
        nothing_kept = only and not self.recurrent and not self._remembering
        self.advance = _keep if nothing_kept and self._advance is nothing else self._go_on

    def _run_rows(self) -> None:
        for run in self.runs:
            run()

    def _assemble(self) -> None:
        self._write()
        for item in self.inputs:
            if item.write is not None:
                item.write()
            else:
                item.values[...] = max(self._steps, self.first_step)
            if item.cast is not None:
                np.copyto(item.cast, item.values, casting="unsafe")

    def _go_on(self, warm_up: bool = False) -> None:
        if warm_up:
            return
        self._advance()
        self._remember()

    def _remember(self) -> None:
        for source, target in self.recurrent:
            target[...] = source
        for run in self._remembering:
            run.commit()
        self._steps += 1.0

    def behind(self, smooth: Filter) -> None:
        """Let a filter of the action go on with `advance`, and forget with `reset`."""
        advance, self._smooth = self.advance, smooth

        def go_on(warm_up: bool = False) -> None:
            advance(warm_up)
            if not warm_up:
                smooth.advance()

        self.advance = go_on

    def at_step(self, step: float) -> None:
        """Run the network on a zero observation at a step of its motion; nothing is kept of it."""
        self.obs[...] = 0.0
        for item in self.inputs:
            item.values[...] = step if item.write is None else 0.0
            if item.cast is not None:
                np.copyto(item.cast, item.values, casting="unsafe")
        self.infer()

    def step_zero(self) -> None:
        """Run the network at the first step of its motion; its action is dropped."""
        self.at_step(self.first_step)
        self._remember()
        self._steps -= self.held
        self.action[...] = 0.0
        for view, values in self.published:
            view[...] = values

    def reset(self) -> None:
        """Forget history, memory and the number of calls."""
        if self.observation is not None:
            self.observation.reset()
        for source, target in self.recurrent:
            source[...] = 0
            target[...] = 0
        for run in self._remembering:
            run.reset()
        if self._smooth is not None:
            self._smooth.reset()
        self.action[...] = 0.0
        self._steps = self.first_step

    def _finite(self) -> bool:
        return self._obs_finite() and all(item.finite() for item in self.inputs)


def _keep(warm_up: bool = False) -> None:
    """There is nothing to go on with."""


def finite_check(array: Float32) -> Callable[[], bool]:
    """Return a function that tells whether a contiguous array holds neither NaN nor infinity."""
    flat = array.reshape(-1)
    dot = flat.dot

    def finite() -> bool:
        # A dot product costs 0.5 µs against 3 µs for isfinite().all(); it overflows for huge
        # finite values only, and then the exact check decides.
        return isfinite(dot(flat)) or bool(np.isfinite(flat).all())

    return finite


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
