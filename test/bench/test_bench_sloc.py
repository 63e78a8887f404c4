"""The counts of `unicon bench sloc`."""

from __future__ import annotations

from unicon_ros.bench import sloc


def test_docstrings_comments_and_blank_lines_are_no_code() -> None:
    head = '"""Doc\n\nlong."""\n\n# comment\n'
    text = head + 'x = """a\nb"""  # two lines\n\n\ndef f():\n    "doc"\n    return 1\n'
    assert sloc.lines_of_python(text) == 4


def test_yaml_counts_lines_with_content() -> None:
    assert sloc.lines_of_yaml("a: 1\n\n# no\n  - b  # yes\n") == 2


def test_no_move_changes_a_line_of_the_workflow() -> None:
    facts = sloc.run().facts
    moves = [value for name, value in facts.items() if "→" in name]
    assert len(moves) == len(sloc.MOVES)
    assert all("workflow: 0 lines" in move for move in moves)
