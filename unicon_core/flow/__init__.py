"""Flow: blocks composed by zip, chain and loop, checked and compiled, for workflow authors."""

from unicon_core.flow.block import Access, Amends, Block, Reads, Tick, Writes, as_block
from unicon_core.flow.compiler import CompiledGraph, compile_graph
from unicon_core.flow.nodes import (
    Blender,
    Chain,
    Deferred,
    Every,
    Loop,
    Node,
    Switch,
    When,
    Zip,
    as_node,
    blocks_of,
    children_of,
)

__all__ = [
    "Access",
    "Amends",
    "Blender",
    "Block",
    "Chain",
    "CompiledGraph",
    "Deferred",
    "Every",
    "Loop",
    "Node",
    "Reads",
    "Switch",
    "Tick",
    "When",
    "Writes",
    "Zip",
    "as_block",
    "as_node",
    "blocks_of",
    "children_of",
    "compile_graph",
]
