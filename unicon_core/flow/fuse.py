"""Fusion: neighbouring copies, index maps and looks at ranges become one operation on the buffer.

Measured with sixteen neighbouring copies of 20 floats: as blocks 16 · 135 ns, fused into one slice
copy 80 ns. What is fused stays in its order wherever one map reads or writes what another writes.
Blocks that do nothing while states stay within their `ranges` are called only when some do not.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from unicon_base.arrays import Array, Index
from unicon_base.generated import define
from unicon_core.flow.block import FIXED, Block, LinearMap, Tick
from unicon_core.flow.nodes import Node, Zip, children_of, with_children
from unicon_core.states import States
from unicon_core.states.states import Range, Screen, places

MAX_COPIES = 4
"""Up to so many separate slice copies (80 ns each) one gather and scatter (750 ns) loses."""


def fuse(root: Node, states: States) -> Node:
    """Return the tree with neighbouring linear blocks of each Zip fused.

    Args:
        root: the tree; it stays as it is, nodes without anything to fuse are shared with it.
        states: the states that the maps read and write.
    """
    return _Fuser(states).node(root)


@dataclass
class _Fuser:
    states: States
    known: dict[int, Node] = field(default_factory=dict)

    def node(self, node: Node) -> Node:
        if id(node) not in self.known:
            self.known[id(node)] = self.rewrite(node)
        return self.known[id(node)]

    def rewrite(self, node: Node) -> Node:
        if not isinstance(node, Zip):
            return with_children(node, [self.node(child) for child in children_of(node)])
        flat = [self.node(part) for child in node.children for part in _spliced(child)]
        return with_children(node, list(self.neighbours(list(self.looks(flat)))))

    def looks(self, children: Sequence[Node]) -> Iterator[Node]:
        """Yield the children, neighbours that act beyond ranges as one block.

        What one of them changes would have to be compared anew, so that those stand last.
        """
        group: list[Block] = []
        for child in children:
            block = child if isinstance(child, Block) and _has_ranges(child) else None
            if group and (block is None or (group[-1].amends and not block.amends)):
                yield self.looked(group)
                group = []
            if block is None:
                yield child
            else:
                group.append(block)
        if group:
            yield self.looked(group)

    def looked(self, blocks: list[Block]) -> Block:
        """Return one block in the place of several, which asks them where one comparison fails."""
        if len(blocks) == 1:
            return blocks[0]
        screen = self.screen(blocks)
        stops = [block for block in blocks if not block.amends]
        trips = self.screen(stops) if len(stops) < len(blocks) else None
        stopping = [block.tick for block in stops]
        amending = [block.tick for block in blocks[len(stops) :]]

        def look() -> None:
            if screen():
                return
            if trips is None or not trips():  # one of them trips, and says why
                for tick in stopping:
                    tick()
            for tick in amending:
                tick()

        fused = _joined(blocks, look)
        return replace(fused, warm_up=screen, stage=blocks[0].stage)

    def screen(self, blocks: Iterable[Block]) -> Screen:
        return Screen(self.states, [each for block in blocks for each in _ranges(block)])

    def neighbours(self, children: Sequence[Node]) -> Iterator[Node]:
        group: list[_Piece] = []
        for child in children:
            piece = self.piece(child)
            if piece is None or any(map(piece.clashes, group)):
                yield from self.together(group)
                group = []
            if piece is None:
                yield child
            else:
                group.append(piece)
        yield from self.together(group)

    def piece(self, node: Node) -> _Piece | None:
        """Return the places of a map in the packed buffer; None where it must stay alone."""
        if not isinstance(node, Block) or node.linear is None or node.reset or node.stage in FIXED:
            return None
        linear = node.linear
        packed = self.states.buffer_of(linear.target.dtype)
        read, write = places(linear.source, packed), places(linear.target, packed)
        if read is None or write is None or linear.source.dtype != linear.target.dtype:
            return None
        if packed.dtype.kind != "f" and not linear.is_copy:
            return None
        if linear.index is not None:
            read = read[..., linear.index]
        read, write = read.ravel(), write.ravel()
        written = set(write.tolist())  # np.unique would import numpy.ma, 10 ms of a start
        if len(written) < len(write) or not written.isdisjoint(read.tolist()):
            return None
        return _Piece(node, linear, packed.dtype, read, write)

    def together(self, pieces: list[_Piece]) -> Iterator[Block]:
        if len(pieces) == 1:
            yield pieces[0].block
        elif pieces:
            yield self.fused(pieces)

    def fused(self, pieces: list[_Piece]) -> Block:
        code = _Code()
        for dtype in dict.fromkeys(piece.dtype for piece in pieces):
            same = [piece for piece in pieces if piece.dtype == dtype]
            code.one_dtype(same, self.states.buffer_of(dtype))
        blocks = [piece.block for piece in pieces]
        text = "\n".join(code.lines)
        source = "\n    ".join(["def tick():", *code.lines])
        tick = define(source, code.names, "<fused>")["tick"]
        return replace(_joined(blocks, tick), inline=text, inline_names=code.names)


@dataclass
class _Piece:
    block: Block
    linear: LinearMap
    dtype: np.dtype[Any]
    read: Index
    write: Index

    def clashes(self, other: _Piece) -> bool:
        """Return whether one reads or writes what the other writes: they are not done at once."""
        return self.dtype == other.dtype and bool(
            np.intersect1d(self.read, other.write).size
            or np.intersect1d(self.write, other.write).size
            or np.intersect1d(self.write, other.read).size
        )

    def each(self, value: ArrayLike | None, default: float) -> Array:
        """Return a factor or summand for each element that is written."""
        full = np.broadcast_to(default if value is None else value, self.linear.target.shape)
        return full.ravel().astype(self.dtype)


@dataclass
class _Code:
    """The statements of one fused block and the arrays that they name."""

    lines: list[str] = field(default_factory=list)
    names: dict[str, Any] = field(default_factory=dict)

    def name(self, prefix: str, value: Any) -> str:
        name = f"{prefix}{len(self.names)}"
        self.names[name] = value
        return name

    def one_dtype(self, pieces: list[_Piece], packed: Array) -> None:
        order = np.argsort(np.concatenate([piece.write for piece in pieces]))

        def joined(arrays: Iterable[Array]) -> Array:
            return np.concatenate(list(arrays))[order]

        write, read = joined(p.write for p in pieces), joined(p.read for p in pieces)
        linear = joined(np.full(len(p.write), not p.linear.is_copy) for p in pieces)
        parts = np.flatnonzero((np.diff(write) != 1) | (np.diff(read) != 1) | np.diff(linear)) + 1
        runs = np.split(np.arange(len(write)), parts)
        copies = [run for run in runs if not linear[run[0]]]
        if len(copies) > MAX_COPIES:
            copies = []
        for run in copies:
            self.copy(packed, write[run[0]], read[run[0]], len(run))
        rest = np.setdiff1d(np.arange(len(write)), np.concatenate([*copies, []]))
        if not rest.size:
            return
        then: list[tuple[str, np.ufunc, Array]] = []
        if any(p.linear.scale is not None for p in pieces):
            scale = joined(p.each(p.linear.scale, 1.0) for p in pieces)
            then.append(("multiply", np.multiply, scale[rest]))
        if any(p.linear.offset is not None for p in pieces):
            # x + (-0.0) is x for every x; adding 0.0 would turn -0.0 into 0.0
            offset = joined(p.each(p.linear.offset, -0.0) for p in pieces)
            then.append(("add", np.add, offset[rest]))
        self.gather(packed, write[rest], read[rest], then)

    def copy(self, packed: Array, write: int, read: int, length: int) -> None:
        target: Any = packed[write : write + length].view(np.uint8)
        source: Any = packed[read : read + length].view(np.uint8)
        # memoryviews copy in 80 ns, arrays in 110 ns, np.copyto in 220 ns
        into, out_of = self.name("into", memoryview(target)), self.name("from_", memoryview(source))
        self.lines.append(f"{into}[:] = {out_of}")

    def gather(
        self,
        packed: Array,
        write: Index,
        read: Index,
        then: Iterable[tuple[str, np.ufunc, Array]],
    ) -> None:
        together = write[-1] - write[0] + 1 == len(write)
        result = (
            packed[write[0] : write[-1] + 1] if together else np.empty(len(write), packed.dtype)
        )
        out = self.name("result", result)
        take, index = self.name("take", packed.take), self.name("index", read)
        self.lines.append(f"{take}({index}, 0, {out}, {self.name('mode', 'clip')})")
        for word, operator, value in then:
            call = self.name(word, operator)
            self.lines.append(f"{call}({out}, {self.name(word + '_by', value)}, {out})")
        if not together:
            everything, places = self.name("packed", packed), self.name("places", write)
            self.lines.append(f"{everything}[{places}] = {out}")


def _joined(blocks: Sequence[Block], tick: Tick) -> Block:
    """Return a block in the place of several."""
    return Block(
        name=f"{blocks[0].name} … {blocks[-1].name} ({len(blocks)} fused)",
        tick=tick,
        reads=tuple(dict.fromkeys(name for block in blocks for name in block.reads)),
        writes=tuple(dict.fromkeys(name for block in blocks for name in block.writes)),
        amends=tuple(dict.fromkeys(name for block in blocks for name in block.amends)),
        where=blocks[0].where,
        endless=True,
        parts=tuple(blocks),
    )


def _ranges(block: Block) -> Sequence[Range]:
    return getattr(block.tick, "ranges", ())


def _has_ranges(block: Block) -> bool:
    """Whether a block does nothing, and has nothing to forget, while states stay in its ranges."""
    return bool(_ranges(block)) and block.endless and not block.writes and block.reset is None


def _spliced(node: Node) -> tuple[Node, ...]:
    """Return the parts of a Zip of blocks that never end and have no reset; else the node."""
    if isinstance(node, Zip):
        parts = tuple(part for child in node.children for part in _spliced(child))
        if all(isinstance(p, Block) and p.endless and p.reset is None for p in parts):
            return parts
    return (node,)
