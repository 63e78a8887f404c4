"""Show: graph and states of a workflow as text, Mermaid, SVG and one page, for `unicon show`."""

from unicon_core.show.mermaid import show_mermaid
from unicon_core.show.page import show_page
from unicon_core.show.state_table import parts_table, state_rows
from unicon_core.show.svg import show_svg
from unicon_core.show.text import show_text

__all__ = ["parts_table", "show_mermaid", "show_page", "show_svg", "show_text", "state_rows"]
