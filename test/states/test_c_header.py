"""A header for C and C++: every state in its place, whatever it is called and made of."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import c_peers
import pytest

from unicon_base.errors import StateError, UniconError
from unicon_core.states import Layout, StateSpec, standard_states
from unicon_core.states.c_header import _TAKEN, c_header, field_names, write_header
from unicon_core.states.groups import Groups, groups_json, groups_of

ALL_KINDS = {
    "scalar": StateSpec(),
    "flag": StateSpec((3,), "bool"),
    "half": StateSpec((5,), "float16"),
    "grid": StateSpec((2, 3, 4), "float64"),
    **{f"a_{kind}": StateSpec((3,), kind) for kind in ("int8", "int16", "int32", "int64")},
    **{f"a_{kind}": StateSpec((3,), kind) for kind in ("uint8", "uint16", "uint32", "uint64")},
    "joint_pos_target": StateSpec((7,)),
}


def compiles(groups: Groups, folder: Path, standard: str = "c99") -> str:
    """Compile a header by itself; return what the compiler says against it."""
    write_header(folder / "states.h", groups, "a test")
    source = folder / "empty.c"
    source.write_text('#include "states.h"\nint main(void) { return 0; }\n')
    return c_peers.compile_c(source, folder, standard, "-fsyntax-only")


@pytest.mark.parametrize("standard", c_peers.LANGUAGES)
@pytest.mark.parametrize("num_robots", [None, 1, 3])
def test_each_kind_of_state_stands_where_the_layout_has_it(tmp_path, standard, num_robots):
    assert compiles(groups_of(Layout(ALL_KINDS, num_robots)), tmp_path, standard) == ""


def test_it_compiles_for_aarch64_where_a_cross_compiler_is(tmp_path):
    compiler = shutil.which("aarch64-linux-gnu-gcc")
    if compiler is None:
        pytest.skip(
            "no cross compiler here: apt install gcc-aarch64-linux-gnu libc6-dev-arm64-cross"
        )
    write_header(tmp_path / "states.h", groups_of(Layout(standard_states(["a"]))), "a test")
    command = [compiler, *c_peers.STRICT, "-std=c99", f"-I{tmp_path}", "-S", "-o", "-"]
    done = subprocess.run(
        [*command, c_peers.IDENTITY], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    for instruction in (
        "stlr",
        "ldar",
        "dmb\tish\n",
        "dmb\tishld",
    ):  # as docs/reference/states.md says
        assert instruction in done.stdout


def test_the_proofs_are_of_the_layout():
    header = c_header(groups_of(Layout(ALL_KINDS, 3)), "a test")
    for group in groups_of(Layout(ALL_KINDS, 3)).items():
        for name, slot in group[1].slots.items():
            proof = f"UNICON_PLACE(struct unicon_{group[0]}, {name}, {slot.offset}, {slot.nbytes});"
            assert header.count(proof) == 1
    assert "double grid[3][2][3][4];" in header


def test_a_state_in_the_wrong_place_does_not_compile(tmp_path):
    write_header(tmp_path / "right.h", groups_of(Layout(ALL_KINDS)), "a test")
    right = (tmp_path / "right.h").read_text()
    (tmp_path / "states.h").write_text(right.replace("float scalar;", "double scalar;"))
    source = tmp_path / "empty.c"
    source.write_text('#include "states.h"\nint main(void) { return 0; }\n')
    for standard in c_peers.LANGUAGES:
        assert c_peers.compile_c(source, tmp_path, standard, "-fsyntax-only") != ""


@pytest.mark.parametrize("standard", c_peers.LANGUAGES)
def test_states_named_as_keywords_and_macros_get_an_underscore(tmp_path, standard):
    names = [*sorted(_TAKEN), "NULL", "EOF", "I", "class_", "EINTR", "EINTR_", "EINTR__"]
    fields = field_names(names)
    assert len(set(fields.values())) == len(names)
    assert fields["class_"] == "class_"
    assert fields["class"] == "class__"
    assert field_names(["joint_pos", "Kp"]) == {"joint_pos": "joint_pos", "Kp": "Kp"}
    assert compiles(groups_of(Layout({name: StateSpec() for name in names})), tmp_path) == ""


@pytest.mark.parametrize("standard", c_peers.LANGUAGES)
def test_no_macro_of_what_the_header_includes_is_in_the_way(tmp_path, standard):
    compiler = shutil.which(c_peers.LANGUAGES[standard])
    if compiler is None:
        pytest.skip(f"no compiler {c_peers.LANGUAGES[standard]!r} here")
    write_header(tmp_path / "states.h", groups_of(Layout(ALL_KINDS)), "a test")
    language = "c++" if standard.startswith("c++") else "c"
    gnu = standard.replace("c", "gnu", 1)  # has more of them, such as linux and unix
    command = [compiler, "-dM", "-E", f"-std={gnu}", "-x", language, tmp_path / "states.h"]
    told = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout
    macros = re.findall(r"^#define ([A-Za-z]\w*)", told, re.MULTILINE)
    assert len(macros) > 500
    states = Layout({name: StateSpec() for name in macros})
    write_header(tmp_path / "states.h", groups_of(states), "a test")
    command = [compiler, "-fsyntax-only", f"-std={gnu}", "-x", language, tmp_path / "states.h"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr[:2000]


NASTY = 'a */ int x; /* b "quoted" \\ back\\n ??/ ??) é · \u202e\n#error no\n\x00\x7f % {} \ud800'


@pytest.mark.parametrize("standard", c_peers.LANGUAGES)
def test_what_people_write_into_descriptions_stays_a_comment(tmp_path, standard):
    specs = standard_states([f"joint {i} {NASTY}" for i in range(29)])
    specs["nasty"] = StateSpec((2,), "float32", NASTY, NASTY, ("*/", "/*"), NASTY, float("nan"))
    groups = groups_of(Layout(specs, 2))
    assert compiles(groups, tmp_path, standard) == ""
    # What a program would put into a segment is the very text that Python puts there.
    source = tmp_path / "tell.c"
    source.write_text(
        '#include "states.h"\nint main(void)\n{\n    const struct unicon_form *all = UNICON_ALL;\n'
        "    fwrite(all->json, 1, all->json_length, stdout);\n"
        "    return all->json[all->json_length];\n}\n"
    )
    program = tmp_path / "tell"
    assert c_peers.compile_c(source, tmp_path, standard, "-o", str(program)) == ""
    told = subprocess.run([program], capture_output=True, timeout=20, check=True).stdout
    assert told.decode() == groups_json(groups)


def test_what_c_cannot_say_is_refused_by_name(tmp_path):
    long = Layout({"wide": StateSpec((2,), "longdouble")})
    with pytest.raises(StateError, match=r"state 'wide' is float128, which C has no type"):
        c_header(groups_of(long), "a test")
    with pytest.raises(StateError, match=r"workflow x has no states that a header could tell"):
        c_header({}, "workflow x")
    with pytest.raises(StateError, match=r"state name 'a b' is not an identifier"):
        c_header({"a b": Layout(ALL_KINDS)}, "a test")
    with pytest.raises(UniconError, match=r"cannot write .*nowhere.*; give a path in a writable"):
        write_header(tmp_path / "nowhere" / "x.h", groups_of(Layout(ALL_KINDS)), "a test")


def test_the_command_writes_the_header_of_a_workflow(tmp_path, capsys):
    from unicon_core.workflow import load_workflow
    from unicon_ros.cli.main import main

    workflow = tmp_path / "w.yaml"
    workflow.write_text(
        "robot: go2\nplatform: fake\nrate: 50\nflow: {loop: {do: {pose: {to: stand}}, "
        "until: {elapsed: 1}}}\n"
    )
    out = tmp_path / "w.h"
    assert main(["states", "--header", str(out), str(workflow)]) == 0
    assert capsys.readouterr().out == f"{out}\n"
    groups = groups_of(load_workflow(str(workflow)).states.layout)
    assert out.read_text() == c_header(groups, str(workflow))
    for wrong in (
        ["--header", str(out)],
        ["--set", "rate=5"],
        ["--header", str(out), str(workflow), "--clean"],
    ):
        assert main(["states", *wrong]) == 1
        assert "unicon states --header FILE.h WORKFLOW" in capsys.readouterr().err
    for wrong in (["absent"], [str(workflow), "--part", "legs"]):
        assert main(["states", "--header", str(out), *wrong]) == 1
        assert capsys.readouterr().err.count("\n") == 1


def test_each_part_of_a_workflow_has_its_own_header(tmp_path, capsys):
    from unicon_ros.cli.main import main

    workflow, out = tmp_path / "w.yaml", tmp_path / "w.h"
    workflow.write_text(
        "robot: go2\nplatform: fake\nrate: 50\nstore: shm\n"
        "parts: {robot: {publishes: [joint_pos]}, desk: {publishes: [velocity_command]}}\n"
        "commands: [{velocity_command: {constant: [0, 0, 0]}, on: desk}]\n"
        "flow: {loop: {do: {pose: {to: stand}}, until: {elapsed: 1}}}\n"
    )
    command = ["states", "--header", str(out), str(workflow)]
    assert main([*command, "--part", "desk"]) == 0
    assert re.findall(r"UNICON_PLACE\(struct unicon_(\w+), (\w+)", out.read_text()) == [
        ("measured", "velocity_command")
    ]
    capsys.readouterr()
    for wrong in ([], ["--part", "absent"]):
        assert main([*command, *wrong]) == 1
        assert capsys.readouterr().err.endswith("give --part robot or --part desk\n")


def test_the_program_of_the_document_compiles(tmp_path):
    text = (c_peers.ROOT / "docs" / "reference" / "states.md").read_text(encoding="utf-8")
    [program] = re.findall(r"```c\n(.*?)```", text, re.DOTALL)
    source = tmp_path / "document.c"
    source.write_text(program)
    write_header(tmp_path / "states.h", groups_of(Layout(standard_states(["a", "b"]))), "a test")
    assert c_peers.compile_c(source, tmp_path, "c99", "-fsyntax-only") == ""
    named = set(re.findall(r"`(unicon_\w+)\(", text)) | set(re.findall(r"UNICON_\w+", text))
    header = (tmp_path / "states.h").read_text()
    for name in named:
        assert re.search(rf"\b{name.replace('GROUP', 'measured')}\b", header), name
