"""The lane of a policy: observation, network and action on arrays of its own, bound once.

What a tick computes stays here until it is published into the states, so that a warm-up takes the
very same path. With a second lane on copies the tick after a warm-up took 40 µs in a 50 Hz loop,
with one lane it takes 22.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import TypeAlias

import numpy as np

from unicon_base import PolicyError
from unicon_base.arrays import Array, Float32
from unicon_core.policies.action_map import explain_size
from unicon_core.policies.contract import ObservationSpec, ObservationTerm, PolicyContract
from unicon_core.policies.controller import PackedStates
from unicon_core.policies.networks import Network, Remembering, Tensor
from unicon_core.policies.observation import Observation, nothing
from unicon_core.policies.phase import Filter

_TIME_STEP = "time_step"
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
        output: what the network writes: the action, or its chunk, shape (H, m) or (1, H, m).
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
    output: Float32

    def __post_init__(self) -> None:
        self.infer = self.runs[0] if len(self.runs) == 1 else self._run_rows
        self._remembering = tuple(run for run in self.runs if isinstance(run, Remembering))
        self._write, self._advance = nothing, nothing
        if self.observation is not None:
            self._write, self._advance = self.observation.bind_parts(self.obs)
        self._obs_finite = finite_check(self.obs)
        self.action_finite = finite_check(self.output)
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
        for array in (self.action, *(array for pair in self.recurrent for array in pair)):
            array[...] = 0
        for run in self._remembering:
            run.reset()
        if self._smooth is not None:
            self._smooth.reset()
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


@dataclass(eq=False)
class Binding:
    """Arrays for the inputs and outputs of a network: feeds, fetches, and what is published."""

    contract: PolicyContract
    states: PackedStates
    joints: Sequence[str]
    network: Network
    feeds: dict[str, Array] = field(default_factory=dict)
    fetches: dict[str, Array] = field(default_factory=dict)
    published: list[Published] = field(default_factory=list)
    split: tuple[Published, ...] = ()

    def __post_init__(self) -> None:
        self.rows = self.states.num_robots or 1
        self.tensors = {
            "input": {tensor.name: tensor for tensor in self.network.inputs},
            "output": {tensor.name: tensor for tensor in self.network.outputs},
        }

    def lane(self) -> PolicyStep:
        """Bind the network to arrays and those to the states.

        Raises:
            PolicyError: an input or output that is missing, or of another size or type.
        """
        observation: Observation | None = None
        obs = np.zeros((self.rows, 0), np.float32)
        inputs: list[Input] = []
        self._check_joints()
        for canonical, name in self.contract.inputs.items():
            tensor = self._tensor("input", name)
            if canonical == "observation":
                observation = Observation(self.contract, self.states, self.joints)
                self._check_size(observation, tensor)
                self.feeds[name] = obs = np.zeros(observation.shape, np.float32)
                self._publish(canonical, obs)
            else:
                item = self._input(canonical, tensor)
                self.feeds[name] = item.values if item.cast is None else item.cast
                inputs.append(item)
        action, output = self._outputs()
        memory = self._memory()
        for tensor in self.network.inputs:
            if tensor.name not in self.feeds:
                text = f"nothing feeds input {tensor}; name it in 'inputs' or 'recurrent'"
                raise self._fail(text)
        calls, published = self._calls(), self.published
        return PolicyStep(observation, obs, action, inputs, memory, calls, published, output)

    def _fail(self, message: str) -> PolicyError:
        return PolicyError(f"policy {self.contract.name}: {message}")

    def _tensor(self, side: str, name: str, what: str = "") -> Tensor:
        if name not in self.tensors[side]:
            known = ", ".join(map(str, self.tensors[side].values()))
            raise self._fail(f"the network has no {what}{side} {name!r}; it has {known}")
        return self.tensors[side][name]

    def _publish(self, name: str, values: Float32) -> None:
        """Copy what the network takes or gives into a state after each tick, if it is declared."""
        if name not in self.states:
            return
        view, size = self.states[name], values.size // self.rows
        if view.dtype != np.float32 or view.size != values.size:
            raise self._fail(
                f"state {name!r} is {view.dtype} of shape {view.shape}; declare it as float32 "
                f"with {size} elements (policy_states gives it)"
            )
        self.published.append((view.reshape(self.rows, size), values.reshape(self.rows, size)))

    def _check_joints(self) -> None:
        """The action has the joints' number; a wrong one is seen in the observation's size, too."""
        joints, extra = self.contract.action.joints, self.contract.action.extra
        tensor = self.tensors["output"].get(self.contract.outputs.get("action", ""))
        if tensor is not None and extra is not None:
            if (child := self.contract.child) is not None:
                raise self._fail(f"action.extra does not go with {child.key}; run it in the tick")
            if not isinstance(tensor.width, int) or tensor.width <= len(joints):
                raise self._fail(
                    f"action.extra is {extra!r}, and the output {tensor} has no more than the "
                    f"{len(joints)} joints; leave it out"
                )
        elif tensor and not self.contract.chunk and not tensor.takes(len(joints)):
            key = "joints" if joints == self.contract.joints else "action.joints"
            raise self._fail(
                f"{key} has {len(joints)} names, the network's output {tensor.name!r} "
                f"{tensor.width} values: {', '.join(joints)}; {self._remedy(key)}"
            )

    def _remedy(self, key: str) -> str:
        if self.contract.source == "policy.yaml":
            return f"correct {key} in {self.contract.path.name}"
        return f"give {key} under 'given'"

    def _check_size(self, observation: Observation, tensor: Tensor) -> None:
        if tensor.dtype != "float32":
            raise self._fail(f"input {tensor} is not float32; export the network in float32")
        if tensor.takes(observation.size):
            return
        stop, parts = 0, []
        for part in observation.slices:
            elements, history = part.elements.size, part.term.history
            start, stop = stop, stop + elements * history
            times = f" = {elements} × {history}" if history > 1 else ""
            parts.append(f"{part.term.name} [{start}:{stop}]{times}")
        contract, width = self.contract, int(tensor.width)
        counts = {len(each) for each in (self.joints, contract.joints, contract.action.joints)}
        why = explain_size(observation.slices, width, self.joints, counts)
        raise self._fail(
            f"the observation has {observation.size} values and the network's input "
            f"{tensor.name!r} takes {width}"
            + (f": {why}" if why else f"; terms: {', '.join(parts)}")
            + f"; {self._remedy('observation.terms')}"
        )

    def _input(self, canonical: str, tensor: Tensor) -> Input:
        """An input that takes a state, or counts the calls."""
        gather, values = None, np.zeros((self.rows, 1), np.float32)
        if canonical != _TIME_STEP or _TIME_STEP in self.states:
            spec = ObservationSpec((ObservationTerm(canonical, canonical),))
            gather = Observation(self.contract, self.states, self.joints, spec)
            values = np.zeros(gather.shape, np.float32)
            if not tensor.takes(gather.size):
                raise self._fail(
                    f"input {tensor} takes {tensor.width} values and state {canonical!r} has "
                    f"{gather.size}; correct 'inputs', 'images' or 'joints'"
                )
        cast = None if tensor.dtype == "float32" else values.astype(tensor.dtype)
        return Input(gather, values, cast)

    def _outputs(self) -> tuple[Float32, Float32]:
        """Fetch outputs that are states; return the action, and what the network writes of it."""
        if "action" not in self.contract.outputs:
            raise self._fail("'outputs' names no action; add 'outputs: {action: NAME}'")
        moved, chunk = len(self.contract.action.joints), self.contract.chunk
        action = output = np.zeros((self.rows, moved), np.float32)
        for canonical, name in self.contract.outputs.items():
            tensor, shown = self._tensor("output", name), action
            if canonical != "action":
                if canonical not in self.states:
                    continue
                width = self.states[canonical].size // self.rows
                if tensor.width != width:
                    raise self._fail(
                        f"output {tensor} does not fill state {canonical!r} of {width} elements; "
                        "correct 'outputs'"
                    )
                shown = written = np.zeros((self.rows, width), np.float32)
            elif (extra := self.contract.action.extra) is not None:
                written = np.zeros((self.rows, int(tensor.width)), np.float32)
                rest = np.zeros_like(written[:, moved:])
                self.split = (action, written[:, :moved]), (rest, written[:, moved:])
                self._publish(extra, rest)
            else:
                if chunk is not None:
                    shape = (1, chunk.size, moved)[-max(len(tensor.shape), 2) :]
                    if any(isinstance(a, int) and a != b for a, b in zip(tensor.shape, shape)):
                        rows = f"{chunk.size} × {moved}; {self._remedy('chunk.size')}"
                        raise self._fail(f"output {tensor} is no chunk of {rows}")
                    output = np.zeros(shape, np.float32)
                written = output
            self.fetches[name] = written
            self._publish(canonical, shown)
        return action, output

    def _memory(self) -> list[tuple[Array, Array]]:
        """Feed and fetch what is recurrent; return each output with its input."""
        for pair in self.contract.recurrent:
            target = self._tensor("input", pair.input, "recurrent ")
            source = self._tensor("output", pair.output, "recurrent ")
            if target.shape != source.shape or target.dtype != source.dtype:
                raise self._fail(f"recurrent {target} and {source} differ; correct 'recurrent'")
            if self.rows > 1 and not target.free_batch:
                raise self._fail(
                    f"its memory {target} is of one robot and there are num_robots {self.rows}; "
                    "export it with a free first axis, or run one workflow for each robot"
                )
            shape = [*target.fixed]
            if target.free_batch:
                shape[0] = self.rows
            self.feeds[pair.input] = np.zeros(shape, target.dtype)
            self.fetches[pair.output] = np.zeros(shape, target.dtype)
        return [(self.fetches[p.output], self.feeds[p.input]) for p in self.contract.recurrent]

    def _calls(self) -> list[Callable[[], None]]:
        """One call for all rows where every first axis is free, else one for each row."""
        tensors = {**self.tensors["input"], **self.tensors["output"]}
        used = [tensors[name] for name in (*self.feeds, *self.fetches)]
        flat = {tensor.name for tensor in used if len(tensor.shape) < 2}
        fixed = [t for t in used if t.name not in flat and not t.free_batch]
        slices = [slice(None)]
        if self.rows > 1 and (flat or any(t.shape[0] != self.rows for t in fixed)):
            slices = [slice(i, i + 1) for i in range(self.rows)]
            for t in fixed:
                if t.shape[0] != 1:
                    raise self._fail(
                        f"{t} is for {t.shape[0]} robots at once and there are {self.rows}; "
                        "export it with a free batch axis"
                    )

        def part(arrays: dict[str, Array], row: slice) -> dict[str, Array]:
            return {name: tensors[name].shaped(array[row]) for name, array in arrays.items()}

        calls = [
            self.network.bind(part(self.feeds, row), part(self.fetches, row)) for row in slices
        ]
        return [*calls, self._divide] if self.split else calls

    def _divide(self) -> None:
        for target, source in self.split:
            target[...] = source
