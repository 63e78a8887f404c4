"""Modules that remember from call to call, and one that does not."""

from __future__ import annotations

import torch
from policies_of_all_kinds import INPUTS, JOINTS

__all__ = ["Asking", "Counter", "Gru", "Lstm", "Past", "Plain"]


class Lstm(torch.nn.Module):
    """Memory as exporters of legged robots' policies keep it: buffers, written in place."""

    def __init__(self) -> None:
        super().__init__()
        self.memory = torch.nn.LSTM(INPUTS, 16)
        self.actor = torch.nn.Linear(16, JOINTS)
        self.register_buffer("hidden_state", torch.zeros(1, 1, 16))
        self.register_buffer("cell_state", torch.zeros(1, 1, 16))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        out, (h, c) = self.memory(x.unsqueeze(0), (self.hidden_state, self.cell_state))
        self.hidden_state[:] = h
        self.cell_state[:] = c
        return self.actor(out.squeeze(0))

    @torch.jit.export
    def reset_memory(self) -> None:
        self.hidden_state[:] = 0.0
        self.cell_state[:] = 0.0


class Gru(torch.nn.Module):
    """Memory that is set anew, without a `reset_memory`."""

    def __init__(self) -> None:
        super().__init__()
        self.memory = torch.nn.GRU(INPUTS, 16)
        self.actor = torch.nn.Linear(16, JOINTS)
        self.register_buffer("hidden_state", torch.full((1, 1, 16), 0.1))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        out, hidden = self.memory(x.unsqueeze(0), self.hidden_state)
        self.hidden_state = hidden
        return self.actor(out.squeeze(0))


class Counter(torch.nn.Module):
    """Memory that is not a buffer: a number, a tensor and a list, one in a submodule."""

    def __init__(self) -> None:
        super().__init__()
        self.steps = 0
        self.seen = torch.zeros(1, INPUTS)
        self.inner = Past()
        self.actor = torch.nn.Linear(INPUTS, JOINTS)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        self.steps += 1
        self.seen += x
        return self.actor(self.seen) + 0.01 * self.steps + self.inner(x)


class Past(torch.nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.past = [torch.zeros(1, 1)]

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        self.past.append(x[:, :1])
        return self.past[-2] * 0.1 * len(self.past)


class Plain(torch.nn.Module):
    """No memory, though it has buffers: a normalization that is only read."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("mean", torch.full((INPUTS,), 0.1))
        self.actor = torch.nn.Sequential(torch.nn.Linear(INPUTS, 16), torch.nn.ELU())
        self.last = torch.nn.Linear(16, JOINTS)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.last(self.actor(x - self.mean))


class Asking(torch.nn.Module):
    """A `reset_memory` that cannot be called as exporters' can."""

    def __init__(self) -> None:
        super().__init__()
        self.actor = torch.nn.Linear(INPUTS, JOINTS)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.actor(x)

    @torch.jit.export
    def reset_memory(self, rows: int) -> None:
        pass
