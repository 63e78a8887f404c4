"""Flow: blocks composed by zip, chain and loop, checked and compiled, for workflow authors."""

from unicon_core.flow.block import (
    Amends,
    Block,
    Bundle,
    LinearMap,
    Reads,
    Stage,
    Tick,
    Writes,
    as_block,
)
from unicon_core.flow.checks import check_graph
from unicon_core.flow.compiled import CompiledGraph
from unicon_core.flow.compiler import compile_graph
from unicon_core.flow.critical_path import critical_path
from unicon_core.flow.fuse import fuse
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
    "Amends",
    "Blender",
    "Block",
    "Bundle",
    "Chain",
    "CompiledGraph",
    "Deferred",
    "Every",
    "LinearMap",
    "Loop",
    "Node",
    "Reads",
    "Stage",
    "Switch",
    "Tick",
    "When",
    "Writes",
    "Zip",
    "as_block",
    "as_node",
    "blocks_of",
    "check_graph",
    "children_of",
    "compile_graph",
    "critical_path",
    "fuse",
]
