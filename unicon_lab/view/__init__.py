"""Viewers: what a run shows in a process of its own, and what comes back from there.

`feed.py` copies each tick's states into a ring in shared memory, `driver.py` hears who looks;
`process.py` gives the ring to a sink: a page in the browser or Foxglove.
"""

SINKS = {"page": "unicon_lab.view.page.sink:Page", "foxglove": "unicon_lab.view.foxglove:Foxglove"}
"""Word of `--view` to what shows it."""

PORT = 8700
"""Where a viewer is served, unless it is taken: then the next free one."""

LOCAL = "127.0.0.1"
"""Where it is served unless another host is given."""
