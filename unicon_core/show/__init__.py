"""Show: graph and states of a workflow as text, Mermaid, SVG and one page, for `unicon show`."""
