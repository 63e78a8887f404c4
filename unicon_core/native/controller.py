"""All of a graph in C++, as the source of an exported controller."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Callable, Iterator

import numpy as np

from unicon_base.arrays import Int64
from unicon_base.errors import WorkflowError
from unicon_base.generated import parse
from unicon_core.flow.block import Block
from unicon_core.flow.compiled import Lines, Scope, indent
from unicon_core.native import network
from unicon_core.native.arena import Arena
from unicon_core.native.operands import PRELUDE
from unicon_core.native.pieces import Piece
from unicon_core.native.stretches import STEPS, Stretches
from unicon_core.native.tick import clean
from unicon_core.states import States
from unicon_core.states.layout import ALIGNMENT


class ControllerGraph(Stretches):
    """The C++ of one graph, all of it.

    Args:
        workflow: its name, for errors.
        boundary: blocks that are the caller's: they do nothing here.

    Attributes:
        networks: in the order of their folders.

    Raises:
        WorkflowError: from `rewrite` and `project`; it names the blocks that run in Python.
    """

    def __init__(self, workflow: str, boundary: tuple[Block, ...]) -> None:
        super().__init__()
        self.networks: list[Piece] = []
        self._workflow, self._locals = workflow, set[str]()
        self._resets: dict[str, Callable[[], object]] = {}
        for block in boundary:
            self._pieces[id(block)] = [Piece(block.name, block.tick, "")]

    def rewrite(self, scope: Scope, functions: dict[str, Lines], stamps: Int64) -> dict[str, Lines]:
        self.scope, self._python = scope, set()
        self._outlined = dict(scope.functions)
        self._inside = set(self._outlined) | set(functions)
        for pieces in self._pieces.values():
            self.python |= {piece.name: piece.why for piece in pieces if piece.text is None}
        for piece, _ in self.texts.values():
            if "PYTHON" in (piece.text or ""):
                self.python[piece.name] = "C++ does a part of it only"
        self._refuse()
        for name, body in (self._outlined | functions).items():
            if not STEPS.match(name):
                continue
            statements = parse("\n".join(body)).body
            if not all(map(self.is_native, statements)):
                self.python["a switch"] = "it has no twin"
                self._refuse()
            self._locals.clear()
            lines = [line for statement in statements for line in self.cpp(statement)]
            held = [f"int64_t {each} = 0;" for each in sorted(self._locals)]
            self.functions += [f"static int64_t {name}() {{", *indent(["int64_t c = 0; (void)c;"])]
            self.functions += [*indent([*held, *lines]), "}"]
        return functions

    def _refuse(self) -> None:
        if self.python:
            told = "; ".join(f"{name}: {why}" for name, why in self.python.items())
            raise WorkflowError(
                f"{self._workflow} cannot do without Python ({told}); leave these blocks out, or "
                "use those with a C++ twin, which `unicon show --source=cpp` lists"
            )

    # -- statements ------------------------------------------------------------------------------

    def is_native(self, statement: ast.stmt) -> bool:
        return isinstance(statement, ast.Return) or super().is_native(statement)

    def callable(self, name: str) -> bool:
        return super().callable(name) or name.startswith("part")

    def cpp(self, statement: ast.stmt) -> Iterator[str]:
        if isinstance(statement, ast.Return) and statement.value is not None:
            yield f"return {self.expression(statement.value)};"
        else:
            yield from super().cpp(statement)

    def place(self, name: str) -> str:
        if name in self.scope.state:
            return super().place(name)
        self._locals.add(f"t_{name}")
        return f"t_{name}"

    def given(self, name: str, kind: str, value: str) -> str:
        return f"{self.place(name)} {kind.strip('=')}= {value};"

    def asked(self, name: str) -> str:
        if name not in self.texts and not name.startswith("part"):
            self._resets[name] = self.scope.names[name]
        return f"{name}()"

    # -- the project -----------------------------------------------------------------------------

    def project(self, states: States, facts: Lines) -> str:
        """Return controller.cpp; the arrays hold what the first tick begins with.

        Args:
            states: of the program.
            facts: further lines in front of the runtime.
        """
        table = self.table
        counters = np.array([*(self.scope.state[name] for name in self.places), 0], np.int64)
        used = {name for text in self.functions for name in re.findall(r"\bb\d+\w*(?=\(\))", text)}
        pieces = {name: piece for name, (piece, _) in self.texts.items() if name in used}
        self.networks = [piece for piece in pieces.values() if piece.session is not None]
        sessions = {id(piece.session): f"session{i}" for i, piece in enumerate(self.networks)}
        arrays = [array for array in table.arrays if id(array) not in sessions]
        arena = Arena(states, [*arrays, counters])
        blocks = [
            f"static int64_t {name}() {{\n{self._text(piece, number)}\nreturn 0;\n}}"
            for number, (name, piece) in enumerate(pieces.items(), 1)
        ]
        names = ["unicon_open, which has not succeeded", *(p.name for p in pieces.values())]
        bound = ", ".join(sessions.get(id(array)) or arena.at(array) for array in table.arrays)
        return "\n".join(
            [
                f"// The tick of {clean(self._workflow)}, written by `unicon export`.",
                '#include "controller.h"',
                PRELUDE,
                "#define DATA",
                f"static struct {{ alignas({ALIGNMENT}) unsigned char memory[{arena.nbytes}];",
                "  unicon_tick_output sent; double share; int64_t any, fault; } arena;",
                "static int64_t failed(int64_t block) { arena.fault = block; return -1; }",
                arena.image(),
                *(f"static int64_t {name}[3];" for name in sessions.values()),
                f"static int64_t* const v = (int64_t*)({arena.at(counters)});",
                *table.declarations,
                *blocks,
                *(
                    f"static int64_t {name}() {{ {arena.effect(reset, name)} return 0; }}"
                    for name, reset in self._resets.items()
                ),
                *self.functions,
                "static void bind() {",
                f"void* const t[] = {{{bound}}};",
                *indent(table.bindings),
                "}",
                f"static const char* const NAMES[] = {{{', '.join(map(json.dumps, names))}}};",
                f"static const int BLOCKS = {len(names)};",
                *facts,
                *self._opened(arena),
                "",
            ]
        )

    def _text(self, piece: Piece, number: int) -> str:
        text = (piece.text or "").replace("WARN;", "")
        return text.replace("BAIL", f"return failed({number + 1})")

    def _opened(self, arena: Arena) -> Iterator[str]:
        """Yield what opens the networks."""
        yield f"enum {{ {', '.join(f'{n} = {i}' for n, i in network.PLACES.items())} }};"
        yield f"enum {{ VERSION = {network.VERSION}, SEVERE = {network.SEVERE} }};"
        rows = ", ".join(f"{{{name}, {value}}}" for name, value in network.OPTIONS.items())
        yield f"static const int OPTIONS[][2] = {{{rows}}};"
        yield f'static const char SPINNING[] = "{network.SPINNING}";'
        yield '#include "runtime.h"'
        yield "static void open_networks(const char* library, const std::string& folder) {"
        if self.networks:
            yield "load(library);"
        for number, piece in enumerate(self.networks):
            yield f'network(session{number}, folder + "network{number}/model.onnx", {{'
            for bind, arrays in zip(("BindInput", "BindOutput"), piece.arrays):
                for name, array in arrays.items():
                    shape = ", ".join(map(str, array.shape))
                    kind = network.TYPES[array.dtype.name]
                    place = arena.at(array)
                    yield (
                        f"{{{bind}, {json.dumps(name)}, {place}, {array.nbytes}, {kind}, "
                        f"{{{shape}}}}},"
                    )
            yield "});"
        yield "}"
