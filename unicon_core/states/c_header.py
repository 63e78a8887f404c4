"""Groups of states as one C99 or C++11 header, for programs in other languages.

`unicon states --header go2_walk.h go2_walk` writes it: each group as a struct whose offsets the
compiler proves, what makes and finds a segment (hash, JSON, places), and the functions that publish
and take, which stand in the folder `c`. `docs/reference/states.md` tells how to use it.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Mapping
from pathlib import Path

from unicon_base.errors import StateError, cannot
from unicon_core.states.backends.shm import places
from unicon_core.states.groups import Groups, groups_hash, groups_json
from unicon_core.states.layout import Layout, StateSpec, check_name

TYPES = {
    "bool": "uint8_t",  # a byte that is neither 0 nor 1 is not defined as a bool of C
    "float16": "uint16_t",  # not every compiler has a type of that size
    "float32": "float",
    "float64": "double",
    **{f"{sign}int{bits}": f"{sign}int{bits}_t" for sign in ("", "u") for bits in (8, 16, 32, 64)},
}
"""Type of NumPy to the one of C."""
_NOTES = {"bool": "0 or 1", "float16": "the bits of a half"}

# Keywords of C23 and C++23, then what gcc and the C library define as macros in small letters.
_TAKEN = frozenset(
    Path(__file__).with_name("c").joinpath("reserved_words.txt").read_text("ascii").split()
)


def field_names(names: Iterable[str]) -> dict[str, str]:
    """Return each state's name in C: its own, or with `_` behind where C gives that a meaning.

    So are names that begin like a macro: capital letters alone, to the end or to the first `_`.
    """
    names = list(names)
    fields: dict[str, str] = {}
    for name in names:
        field = name
        if name in _TAKEN or name.partition("_")[0].isupper():
            field += "_"
            while field in names or field in fields.values():
                field += "_"
        fields[name] = field
    return fields


def c_header(groups: Groups, source: str) -> str:
    """Return the header.

    Args:
        groups: name of each group to its layout.
        source: where they are from, such as a workflow's name, for the comment on top.

    Raises:
        StateError: there are no states, or C has no type for one.
    """
    if not groups:
        raise StateError(f"{source} has no states that a header could tell of; declare one")
    here = Path(__file__).with_name("c")
    runtime = [(here / name).read_text(encoding="utf-8") for name in ("segment.h", "ring.h")]
    numbers = [f"    {_number(name)} = {i}," for i, name in enumerate(groups)]
    parts = [
        f"/* Written by `unicon states --header`; groups of states of {_comment(source)}.",
        " * Include it in C99 or C++11, once in a file: docs/reference/states.md of unicon. */",
        "#ifndef UNICON_STATES_H",
        "#define UNICON_STATES_H",
        "",
        f"#define UNICON_GROUPS {len(groups)}",
        "",
        *runtime,
        "/* The groups. */",
        "enum {",
        *numbers,
        "};",
        *(c_struct(name, layout) for name, layout in groups.items()),
        _forms(groups),
        *map(_functions, groups),
        "#endif",
        "",
    ]
    return "\n".join(parts)


def write_header(file: str | Path, groups: Groups, source: str) -> None:
    """Write the header to a file; see `c_header`.

    Raises:
        StateError: as of `c_header`.
        UniconError: it cannot be written.
    """
    text = c_header(groups, source)
    with cannot(f"write {file}", "give a path in a writable folder"):
        Path(file).write_text(text, encoding="utf-8")


def _number(group: str) -> str:
    return f"UNICON_{group.upper()}"


def c_struct(group: str, layout: Layout) -> str:
    """Return the type of one group's value, and the proofs that it is laid out as here.

    Raises:
        StateError: C has no type of a fixed size for a state.
    """
    check_name(group)
    fields, members, proofs = field_names(layout.specs), [], []
    at = pads = 0
    slots = sorted(layout.slots.items(), key=lambda item: item[1].offset)
    for name, slot in slots:
        if slot.dtype not in TYPES:
            raise StateError(
                f"state {name!r} is {slot.dtype}, which C has no type of a fixed size for; make it "
                f"one of {', '.join(TYPES)}"
            )
        if slot.offset != at:
            members.append(f"    unsigned char {_pad(pads, fields)}[{slot.offset - at}];")
            pads += 1
        members += _lines(_about(layout.specs[name], slot.dtype))
        axes = "".join(f"[{n}]" for n in slot.shape)
        members.append(f"    {TYPES[slot.dtype]} {fields[name]}{axes};")
        where = f"{fields[name]}, {slot.offset}, {slot.nbytes}"
        proofs.append(f"UNICON_PLACE(struct unicon_{group}, {where});")
        at = slot.offset + slot.nbytes
    if at != layout.nbytes:
        members.append(f"    unsigned char {_pad(pads, fields)}[{layout.nbytes - at}];")
    proofs.append(f"UNICON_ASSERT(sizeof(struct unicon_{group}) == {layout.nbytes});")
    batch = f", {layout.num_robots} robots: the first axis" if layout.num_robots else ""
    lines = [
        "",
        f"/* Group {group}: {len(slots)} states{batch}. */",
        f"struct unicon_{group} {{",
        *members,
        "};",
        *proofs,
    ]
    return "\n".join(lines)


def _pad(number: int, fields: Mapping[str, str]) -> str:
    name = f"unicon_pad{number}"
    while name in fields.values():
        name += "_"
    return name


def _about(spec: StateSpec, dtype: str) -> str:
    facts = [spec.description, spec.unit, spec.frame, _NOTES.get(dtype, "")]
    told = "; ".join(fact for fact in facts if fact)
    if spec.names:
        told += f"{': ' if told else ''}{', '.join(spec.names)}"
    return _comment(told)


def _comment(text: str) -> str:
    """Return text on one line that neither ends nor begins a comment, nor has a trigraph."""
    printable = "".join(letter if letter.isprintable() else " " for letter in text)
    tame = re.sub(r"\?\?+", "?", printable.replace("*/", "* /").replace("/*", "/ *"))
    return " ".join(tame.split())


def _lines(comment: str) -> list[str]:
    if not comment:
        return []
    wrapped = textwrap.wrap(f"/* {comment} */", 100, initial_indent=" " * 4, break_long_words=False)
    return [wrapped[0], *(f"     * {line}" for line in wrapped[1:])]


def _forms(groups: Groups) -> str:
    """Return the segments that there can be: one of all groups, and one of each alone."""
    lines = ["", "/* The groups as canonical JSON. */"]
    for name, layout in groups.items():
        pieces = (f'    "{piece}"' for piece in _pieces(layout.to_json()))
        lines.append(" \\\n".join([f"#define {_number(name)}_JSON", *pieces]))
    lines += ["", "/* What a segment can hold: all groups, or one alone. */"]
    forms = {"ALL": groups}
    if len(groups) > 1:
        forms |= {f"ONLY_{name.upper()}": {name: layout} for name, layout in groups.items()}
    entries = []
    for number, (form, held) in enumerate(forms.items()):
        length = len(groups_json(held))
        starts, size = places(held, length)
        where = ", ".join(str(starts.get(name, 0)) for name in groups)
        text = ' ",'.join(f'\\"{name}\\":" {_number(name)}_JSON' for name in held)
        lines.append(f"#define UNICON_{form} (&unicon_forms[{number}])")
        entries += [
            f'    {{__extension__ "{{{text} "}}",',
            f'     "{groups_hash(held)}",',
            f"     {length}, {size}, {{{where}}}}},",
        ]
    lines += [
        "/* __extension__: literals longer than the 4095 letters that C99 asks of a compiler. */",
    ]
    lines += ["static const struct unicon_form unicon_forms[] = {", *entries, "};"]
    lines.append(f"enum {{ UNICON_FORMS = {len(forms)} }};")
    return "\n".join(lines)


def _pieces(text: str, width: int = 90) -> Iterable[str]:
    """Yield ASCII text as pieces of a C literal; an escape is never parted."""
    for start in range(0, len(text), width):
        piece = text[start : start + width].replace("\\", "\\\\").replace('"', '\\"')
        yield piece.replace("?", "\\?")  # ??/ and its like would be other letters


def _functions(group: str) -> str:
    return f"""
static inline int unicon_attach_{group}(struct unicon_reader *reader, const char *name)
{{
    return unicon_attach(reader, name, {_number(group)}, sizeof(struct unicon_{group}),
                         unicon_forms, UNICON_FORMS);
}}

static inline int unicon_take_{group}(struct unicon_reader *reader, struct unicon_{group} *value)
{{
    return unicon_take(reader, {_number(group)}, value);
}}

static inline int unicon_publish_{group}(struct unicon_segment *segment,
                                         const struct unicon_{group} *value)
{{
    return unicon_publish(segment, {_number(group)}, value, sizeof *value);
}}"""
