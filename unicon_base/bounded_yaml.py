"""YAML as plain values of YAML 1.2, bounded in size, depth and number, for every reader of a file.

A file may come from anybody, so nothing in it costs more than its length: what is too large, too
deep or repeats itself through aliases is refused with its line, numbers are those that 64 bits
hold, and no tag ever builds an object. PyYAML only splits the text into events here: its own
resolver reads YAML 1.1, where `1:30` is 90, `0100` is 64 and `no` is false.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

import yaml

from unicon_base import AnyDict

MAX_SIZE = 4 * 1024 * 1024
"""Characters of one document; the largest that we know of, a dumped Isaac Lab environment, has
0.1 million."""
MAX_NODES = 100_000
"""Values of one document, each as often as aliases repeat it."""
MAX_DEPTH = 64
"""Lists and mappings inside each other."""

# libyaml where PyYAML was built with it: ten times as fast.
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

_CORE = "tag:yaml.org,2002:"
_INT = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?")
_INFINITE = re.compile(r"[-+]?\.(?:inf|Inf|INF)")
_WORDS: AnyDict = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), math.nan),
}
_LONGEST_NUMBER = 400
_REREAD = 64 * 1024
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]")


class YamlError(Exception):
    """A text is not YAML, or more of it than is read.

    Attributes:
        line: from 1.
        problem: what is wrong, without the line.
    """

    def __init__(self, line: int, problem: str) -> None:
        super().__init__(f"line {line}: {problem}")
        self.line = line
        self.problem = problem


@dataclass(eq=False)
class Node:
    """A value and where it stands.

    Attributes:
        line: from 1.
        value: a scalar of YAML 1.2's core schema, a list of nodes, or a list of pairs of them.
        kind: `scalar`, `list` or `mapping`.
        tag: a tag that is not of the core schema, such as `tag:yaml.org,2002:python/tuple`; else
            empty.
        size: number of values in it, itself included.
    """

    line: int
    value: Any
    kind: str
    tag: str = ""
    size: int = 1


def compose(text: str) -> Node | None:
    """Read a text as one YAML document; None where it holds nothing.

    Raises:
        YamlError: it is not YAML, holds several documents, or is beyond the bounds.
    """
    if len(text) > MAX_SIZE:
        raise YamlError(
            1, f"the text has {len(text)} characters; at most {MAX_SIZE} are read: make it smaller"
        )
    try:
        return _Composer(_Loader(text)).document()
    except yaml.MarkedYAMLError as error:
        raise _clearer(text, error) from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, max(error.position, 0)) + 1
        what = " ".join(str(error.reason).split())
        raise YamlError(line, f"{what} (character {_code(error.character)})") from None
    except (yaml.YAMLError, UnicodeError, ValueError) as error:
        raise YamlError(1, " ".join(str(error).split())) from None


def _clearer(text: str, error: yaml.MarkedYAMLError) -> YamlError:
    """Return the error in the words of PyYAML's own scanner, which says more than libyaml's."""
    if len(text) <= _REREAD:
        try:
            _Composer(yaml.SafeLoader(text)).document()
        except yaml.MarkedYAMLError as clearer:
            error = clearer
        except (YamlError, yaml.YAMLError):
            pass
    mark = error.problem_mark or error.context_mark
    return YamlError(mark.line + 1 if mark else 1, _problem(error))


def printable(text: str) -> str | None:
    """Return what is wrong with a text that goes into messages and names; None for nothing."""
    found = _CONTROL.search(text)
    return f"the control character {_code(found[0])}" if found else None


def _code(character: Any) -> str:
    number = ord(character) if isinstance(character, str) else int(character)
    return f"U+{number:04X}"


def _problem(error: yaml.MarkedYAMLError) -> str:
    """Return what is wrong, with the line of the bracket or quote that was left open."""
    begun = error.context_mark
    if begun is None or error.problem_mark is None or begun.line == error.problem_mark.line:
        return str(error.problem)
    return f"{error.problem} ({error.context}, which begins in line {begun.line + 1})"


class _Composer:
    """Builds nodes of events; PyYAML's own recurses without a bound and follows every alias."""

    def __init__(self, loader: Any) -> None:
        self.loader = loader
        self.anchors: dict[str, Node | None] = {}
        self.count = 0

    def document(self) -> Node | None:
        next_event = self.loader.get_event
        next_event()  # of the stream
        if isinstance(self.loader.peek_event(), yaml.StreamEndEvent):
            return None
        next_event()  # of the document
        root = self.node(next_event(), 0)
        next_event()
        after = next_event()
        if not isinstance(after, yaml.StreamEndEvent):
            raise YamlError(
                after.start_mark.line + 1, "a second document begins; write one document per file"
            )
        return root

    def node(self, event: Any, depth: int) -> Node:
        line = event.start_mark.line + 1
        if depth > MAX_DEPTH:
            raise YamlError(
                line, f"lists and mappings are nested more than {MAX_DEPTH} deep; make it flatter"
            )
        if isinstance(event, yaml.AliasEvent):
            return self.alias(event, line)
        self.grow(line, 1)
        anchor = event.anchor
        if anchor is not None:
            if anchor in self.anchors:
                raise YamlError(line, f"anchor &{anchor} stands twice; name each once")
            self.anchors[anchor] = None
        if isinstance(event, yaml.ScalarEvent):
            node = self.scalar(event, line)
        elif isinstance(event, yaml.SequenceStartEvent):
            node = Node(line, [], "list", _foreign(event.tag, "seq"))
            while not isinstance(following := self.loader.get_event(), yaml.SequenceEndEvent):
                item = self.node(following, depth + 1)
                node.value.append(item)
                node.size += item.size
        else:
            node = Node(line, [], "mapping", _foreign(event.tag, "map"))
            while not isinstance(following := self.loader.get_event(), yaml.MappingEndEvent):
                key = self.node(following, depth + 1)
                value = self.node(self.loader.get_event(), depth + 1)
                node.value.append((key, value))
                node.size += key.size + value.size
        if anchor is not None:
            self.anchors[anchor] = node
        return node

    def grow(self, line: int, size: int) -> None:
        self.count += size
        if self.count > MAX_NODES:
            raise YamlError(
                line,
                f"the document holds more than {MAX_NODES} values, repeated ones counted; "
                "make it smaller",
            )

    def alias(self, event: Any, line: int) -> Node:
        name = event.anchor
        if name not in self.anchors:
            raise YamlError(line, f"found undefined alias {name!r}")
        node = self.anchors[name]
        if node is None:
            raise YamlError(line, f"alias *{name} stands inside its own anchor; write the value")
        self.grow(line, node.size)
        return node

    def scalar(self, event: Any, line: int) -> Node:
        text, tag = event.value, event.tag
        wrong = printable(text)
        if wrong:
            raise YamlError(line, f"a text holds {wrong}; remove it")
        if tag is None or tag == "!":
            unquoted = tag is None and event.implicit[0]
            return Node(line, plain(text, line) if unquoted else text, "scalar")
        if tag == f"{_CORE}str":
            return Node(line, text, "scalar")
        if tag in _SCALAR_TAGS:
            value = plain(text, line)
            if tag == f"{_CORE}float" and type(value) is int:
                value = float(value)
            if type(value) is not _SCALAR_TAGS[tag]:
                raise YamlError(line, f"{text!r} is not a {tag.removeprefix(_CORE)}")
            return Node(line, value, "scalar")
        return Node(line, text, "scalar", tag)


_SCALAR_TAGS: dict[str, type] = {
    f"{_CORE}int": int,
    f"{_CORE}float": float,
    f"{_CORE}bool": bool,
    f"{_CORE}null": type(None),
}


def _foreign(tag: str | None, own: str) -> str:
    return "" if tag in (None, "!", _CORE + own) else str(tag)


def plain(text: str, line: int) -> Any:
    """Return what a plain word means in YAML 1.2's core schema.

    Raises:
        YamlError: a number that 64 bits do not hold.
    """
    if text in _WORDS:
        return _WORDS[text]
    first = text[0]
    if first not in "+-.0123456789":
        return text
    if _INT.fullmatch(text):
        return _integer(text, line)
    if _FLOAT.fullmatch(text):
        if len(text) > _LONGEST_NUMBER:
            raise YamlError(line, f"a number has {len(text)} characters; shorten it")
        number = float(text)
        if math.isinf(number):
            raise YamlError(line, f"{text} is more than a number holds; write .inf for infinity")
        return number
    if _INFINITE.fullmatch(text):
        return -math.inf if first == "-" else math.inf
    return text


def _integer(text: str, line: int) -> int:
    if len(text) <= _LONGEST_NUMBER:
        base = {"0o": 8, "0x": 16}.get(text[:2], 10)
        number = int(text[2:] if base != 10 else text, base)
        if -(2**63) <= number < 2**64:
            return number
    shown = text if len(text) <= 40 else f"{text[:30]}… ({len(text)} digits)"
    raise YamlError(line, f"{shown} is more than 64 bits hold; write it with a point, or quote it")
