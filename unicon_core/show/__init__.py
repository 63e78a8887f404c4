"""Show: graph and states of a workflow as text, Mermaid and SVG, for `unicon show`."""

from unicon_core.show.mermaid import show_mermaid
from unicon_core.show.parts import parts_table
from unicon_core.show.state_table import StateRow, state_rows, state_table
from unicon_core.show.svg import show_svg
from unicon_core.show.text import show_text

__all__ = [
    "StateRow",
    "parts_table",
    "show_mermaid",
    "show_svg",
    "show_text",
    "state_rows",
    "state_table",
]
