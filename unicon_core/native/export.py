"""A tick as a C++ project without Python, with recorded vectors: `unicon export`.

The code is that of the native tick. All memory lies in one arena, the states first, so that a
snapshot is one copy. `recv` and `send` are the caller's: their states are the input and the output.
What a block's `reset` writes is observed: constants at fixed places, or the block is refused.
"""

from __future__ import annotations

import ast
import json
import os
import shutil
from collections.abc import Callable, Iterator
from importlib import import_module
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter_ns
from typing import Any

import numpy as np

from unicon_base.arrays import Int64
from unicon_base.errors import Fault, WorkflowError, cannot
from unicon_base.generated import parse
from unicon_core.flow.block import Block, Stage
from unicon_core.flow.compiled import Lines, Scope, indent
from unicon_core.flow.compiler import compile_graph
from unicon_core.flow.nodes import blocks_of
from unicon_core.native import network
from unicon_core.native.operands import PRELUDE, Arena
from unicon_core.native.pieces import Piece
from unicon_core.native.stretches import STEPS, Stretches
from unicon_core.native.tick import clean
from unicon_core.platforms.kit.command import BLEND
from unicon_core.states import Layout, States
from unicon_core.states.c_header import c_struct, field_names
from unicon_core.states.groups import Copies, subset
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow import Program, WorkflowDocument
from unicon_core.workflow.tick_tree import tick_tree


def export(document: WorkflowDocument, folder: Path, ticks: int) -> None:
    """Write a workflow's controller as a C++ project, all of it or nothing.

    Args:
        document: of a workflow on a simulator, which records the vectors.
        folder: absent or empty.
        ticks: that are recorded, at most.

    Raises:
        UniconError: blocks that run in Python, each with the reason; no simulator; a fault in the
            recorded run; a folder that holds something or cannot be written.
    """
    program = Program(document, dry=True)
    try:
        files, networks = _project(program, ticks)
    finally:
        program.close()
    with cannot(f"export into {folder}", "name an absent or empty folder where there is room"):
        folder.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as made:
            part = Path(made, "project")
            part.mkdir()
            for name, content in files.items():
                part.joinpath(name).write_bytes(content)
            for number, piece in enumerate(networks):
                models = part / f"network{number}"
                models.mkdir()
                model, *weights = piece.files
                shutil.copyfile(model, models / "model.onnx")
                for each in weights:  # the model finds them by their names
                    shutil.copy(each, models)
            os.rename(part, folder)


def _project(program: Program, ticks: int) -> tuple[dict[str, bytes], list[Piece]]:
    """Return the files of a project by name, and its networks."""
    facts, states, robot = program.platform.facts, program.states, program.robot
    if (
        not facts.simulated
        or states.num_robots is not None
        or not {*COMMAND_STATES}.issubset(facts.reads)
    ):
        raise WorkflowError(
            f"{program.name} has to be of one simulated robot, whose run gives the recorded "
            "vectors; use --set platform=mujoco, and leave out num_robots"
        )
    root, _ = tick_tree({**program.stages, Stage.OBSERVE: []}, states)
    blocks = blocks_of(root)
    recv, send = (
        next(block for block in blocks if block.stage is stage)
        for stage in (Stage.RECV, Stage.SEND)
    )
    graph = Controller(program.name)
    for block in (recv, send):
        graph.given_to_caller(block)
    compile_graph(root, native=graph)
    read = {name for block in blocks for name in (*block.reads, *block.amends)}
    elsewhere = read - {"tick", *facts.reads}.union(*(block.writes for block in blocks))
    layout = states.layout
    structs = {
        "tick_input": subset(layout, read.intersection(facts.writes) | elsewhere),
        "tick_output": subset(layout, facts.reads),
        "tick_states": layout,
    }
    first = States(structs["tick_output"])
    first["joint_pos_target"] = np.nan_to_num(robot.default_joint_pos)
    files = {
        path.name: path.read_text("utf-8") for path in Path(__file__).with_name("cpp").iterdir()
    }
    for word, value in {
        "@NAME@": clean(program.name),
        "@PERIOD@": repr(program.period),
        "@BLEND@": f"{BLEND:g}",
        "@JOINTS@": ", ".join(map(json.dumps, robot.joint_names)),
        "@STRUCTS@": "\n".join(_struct(name, each) for name, each in structs.items()),
    }.items():
        files["controller.h"] = files["controller.h"].replace(word, value)
    damping = np.array(robot.joint_damping, np.float32)
    files["controller.cpp"] = graph.project(states, first.buffer, damping)
    written = {name: text.encode() for name, text in files.items()}

    def recorder(layout: Layout, rows: list[bytes]) -> Callable[[], None]:
        packed = bytearray(layout.nbytes)
        copies = Copies(states, layout, memoryview(packed))

        def record() -> None:
            copies.pack()
            rows.append(bytes(packed))

        return record

    inputs, outputs, took = list[bytes](), list[bytes](), list[int]()
    received = recorder(structs["tick_input"], inputs)
    sent = recorder(structs["tick_output"], outputs)
    take, give = recv.tick, send.tick

    def begin() -> object:
        done = take()
        received()
        took.append(-perf_counter_ns())
        return done

    def end() -> object:
        took[-1] += perf_counter_ns()
        sent()
        return give()

    recv.tick, send.tick = begin, end
    loop, done = compile_graph(root), False
    try:
        while len(took) < ticks and not done:
            done = loop.step()
            took[-1] -= perf_counter_ns()
            done = loop.deferred() or done
            took[-1] += perf_counter_ns()
            states["tick"][...] += 1
    except Fault as fault:
        raise WorkflowError(
            f"{program.name}: the recorded run ends with a fault in tick {len(inputs)}: {fault}; "
            "correct the workflow, or give fewer --ticks"
        ) from fault
    version = import_module("onnxruntime").__version__ if graph.networks else "none"
    spread = [f"{each / 1e3:.1f}" for each in np.percentile(took, (50, 99, 100))]
    words = len(outputs), int(done), len(inputs[0]), len(outputs[0]), version, *spread
    head = f"{' '.join(map(str, words))}\n{_cpu_features()}\n"
    written["vectors.bin"] = head.encode() + b"".join(inputs + outputs)
    return written, graph.networks


def _struct(name: str, layout: Layout) -> str:
    """Return a struct and what lists its fields, in C."""
    fields = "".join(f" DO({field})" for field in field_names(layout.specs).values())
    return f"{c_struct(name, layout)}\n#define UNICON_{name.upper()}(DO){fields}"


def _cpu_features() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return next((line for line in lines if line.startswith(("flags", "Features"))), "")


class Controller(Stretches):
    """The C++ of one graph, all of it.

    Args:
        workflow: its name, for errors.

    Attributes:
        networks: in the order of their folders.
    """

    def __init__(self, workflow: str) -> None:
        super().__init__()
        self.networks: list[Piece] = []
        self._workflow, self._locals = workflow, set[str]()
        self._resets: dict[str, Callable[[], object]] = {}
        self._asked = set[str]()  # calls of twins that answer with 0 or 1

    def call(self, block: Block, scope: Scope) -> str:
        text = super().call(block, scope)
        if not block.inline:
            self._asked.update(text.split())
        return text

    def given_to_caller(self, block: Any) -> None:
        """Let a block do nothing here; before the graph is compiled."""
        self._pieces[id(block)] = [Piece(block.name, block.tick, "")]

    def rewrite(self, scope: Scope, functions: dict[str, Lines], stamps: Int64) -> dict[str, Lines]:
        """Make the functions in C++, and leave those in Python as they are.

        Raises:
            WorkflowError: blocks run in Python; with their names and why.
        """
        self.scope, self._python = scope, set()
        self._outlined = dict(scope.functions)
        every = self._outlined | functions
        self._inside = {*every}
        steps = {name: parse("\n".join(every[name])).body for name in every if STEPS.match(name)}
        for piece in chain.from_iterable(self._pieces.values()):
            if piece.text is None or "PYTHON" in piece.text:
                self.python[piece.name] = piece.why or "C++ does a part of it only"
        if not self.python and not all(
            self.is_native(each) for body in steps.values() for each in body
        ):
            self.python["switch"] = "it has no twin"
        if self.python:
            told = "; ".join(f"{name}: {why}" for name, why in self.python.items())
            raise WorkflowError(
                f"{self._workflow} cannot do without Python ({told}); leave these blocks out, or "
                "use those with a C++ twin, which `unicon show --source=cpp` lists"
            )
        for name, body in steps.items():
            self._locals.clear()
            lines = [line for statement in body for line in self.cpp(statement)]
            held = ["double w = 0.0;", "int64_t c = 0;", "(void)c, (void)w;"]
            held += [f"int64_t {each} = 0;" for each in sorted(self._locals)]
            self.functions += [f"static int64_t {name}() {{", *indent(held + lines), "}"]
        return functions

    # -- statements ------------------------------------------------------------------------------

    def is_native(self, statement: ast.stmt) -> bool:
        match statement:
            case ast.Return():
                return True
            case ast.Expr(value=ast.Call(func=ast.Name(id=name))) if _blend(name):
                return True
            case ast.Assign(value=ast.Call(args=[ast.Call(func=ast.Name(id=asked))])):
                return f"{asked}()" in self._asked
        return super().is_native(statement)

    def callable(self, name: str) -> bool:
        return super().callable(name) or name.startswith("part")

    def cpp(self, statement: ast.stmt) -> Iterator[str]:
        match statement:
            case ast.Return(value=ast.expr() as value):
                yield f"return {self.expression(value)};"
            case ast.Expr(value=ast.Call(func=ast.Name(id=name), args=args)) if _blend(name):
                for each in args:  # the weight, of integers
                    left, right = map(self.expression, (each.left, each.right))  # type: ignore[attr-defined]
                    yield f"w = (double){left} / {right};"
                blender = self.scope.names[name].__self__
                for k in range(len(COMMAND_STATES)):
                    yield self.table.expand(_blend(name).replace("K", str(k)), blender)
            case ast.Assign(value=ast.Call(args=[ast.Call() as asked])):
                yield from super().cpp(ast.Assign(statement.targets, asked))
            case _:
                yield from super().cpp(statement)

    def place(self, name: str) -> str:
        if name in self.scope.state:
            return super().place(name)
        self._locals.add(f"t_{name}")
        return f"t_{name}"

    def given(self, name: str, kind: str, value: str) -> str:
        return f"{self.place(name)} = {value};"

    def asked(self, name: str) -> str:
        if name.startswith("reset"):
            self._resets[name] = self.scope.names[name]
        return f"{name}()"

    # -- the project -----------------------------------------------------------------------------

    def project(self, states: States, sent: Any, damping: Any) -> str:
        """Return controller.cpp; the arrays hold what the first tick begins with.

        Args:
            states: of the program.
            sent: what counts as sent before the first tick, as bytes of an output.
            damping: of the robot, NaN where it is not known, float32, shape (n,).
        """
        table = self.table
        counters = np.array([*(self.scope.state[name] for name in self.places), 0], np.int64)
        used = self.used()
        pieces = {name: piece for name, piece in self.texts.items() if name in used}
        names = ["unicon_open, which has not succeeded", *(p.name for p in pieces.values())]
        self.networks = [piece for piece in pieces.values() if piece.session is not None]
        sessions = {id(piece.session): f"session{i}" for i, piece in enumerate(self.networks)}
        arrays = [array for array in table.arrays if id(array) not in sessions]
        arena = Arena([states.buffer, *arrays, counters, sent, damping])
        bound = [sessions.get(id(array)) or arena.at(array) for array in table.arrays]
        return "\n".join(
            [
                f"// The tick of {clean(self._workflow)}, written by `unicon export`.",
                '#include "controller.h"',
                PRELUDE,
                "#define DATA",
                f"static struct {{ alignas(64) unsigned char memory[{arena.nbytes}];",
                "  double share; int64_t any, fault; } arena;",
                "static int64_t failed(int block) { arena.fault = block; return -1; }",
                f"static const uint8_t IMAGE[] = {{{', '.join(map(str, arena.content()))}}};",
                f"static const char* const NAMES[] = {{{', '.join(map(json.dumps, names))}}};",
                *(f"static int64_t {name}[3];" for name in sessions.values()),
                f"[[maybe_unused]] static auto v = (int64_t*)({arena.at(counters)});",
                f"static auto sent = (unicon_tick_output*)({arena.at(sent)});",
                f"static auto damping = (const float*)({arena.at(damping)});",
                f"static auto ticks = (int64_t*)({arena.at(states['tick'])});",
                *table.declarations,
                *(
                    f"static int64_t {name}() {{\n{_alone(piece.text, number)}\nreturn 0;\n}}"
                    for number, (name, piece) in enumerate(pieces.items(), 2)
                ),
                *(
                    f"static int64_t {name}() {{\n{arena.effect(reset, name)}\nreturn 0;\n}}"
                    for name, reset in self._resets.items()
                ),
                *self.functions,
                f"enum {{ {', '.join(f'{n} = {i}' for n, i in network.PLACES.items())},",
                f"VERSION = {network.VERSION}, SEVERE = {network.SEVERE} }};",
                f"static const int BLOCKS = {len(names)}, SEND = {names.index('send') + 1};",
                f'static const char SPINNING[] = "{network.SPINNING}";',
                "static const int OPTIONS[][2] = {",
                *(f"{{{name}, {value}}}," for name, value in network.OPTIONS.items()),
                "};",
                '#include "runtime.h"',
                "static void open_all(const char* library, const std::string& folder) {",
                "(void)library, (void)folder;",
                f"void* const t[] = {{{', '.join(bound)}}};",
                *table.bindings,
                *(["load(library);"] if self.networks else []),
                *(
                    line
                    for number, piece in enumerate(self.networks)
                    for line in _opened(number, piece, arena)
                ),
                "}",
                "",
            ]
        )


_BLENDS = {
    "capture": "each(#_live.K) $_held.K[i] = $_own.K[i] = $_live.K[i];",
    "resume": "each(#_live.K) $_live.K[i] = $_own.K[i];",
    "mix": "each(#_live.K) { $_own.K[i] = $_live.K[i]; $_live.K[i] = "
    "$_live.K[i] * (float)w + $_held.K[i] * (float)(1.0 - w); }",
}
"""The methods of a `Blender` for its array number K, with the weight `w`."""


def _blend(name: str) -> str:
    """Return what a function of a blender does in C++, "" for others."""
    return _BLENDS.get(name.rstrip("0123456789"), "")


def _alone(text: str | None, number: int) -> str:
    return (text or "").replace("WARN;", "").replace("BAIL", f"return failed({number})")


def _opened(number: int, piece: Piece, arena: Arena) -> Iterator[str]:
    """Yield what opens a network, in C++."""
    yield f'network(session{number}, folder + "/network{number}/model.onnx", {{'
    for bind, arrays in zip(("BindInput", "BindOutput"), piece.arrays):
        for name, array in arrays.items():
            kind, shape = network.TYPES[array.dtype.name], ", ".join(map(str, array.shape))
            place = f"{arena.at(array)}, {array.nbytes}, {kind}, {{{shape}}}"
            yield f"{{{bind}, {json.dumps(name)}, {place}}},"
    yield "});"
