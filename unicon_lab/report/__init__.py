"""Report: what a run did as one page with drawings, for `unicon run --report FILE.html`."""
