"""Work on runs: recording, replay, comparison, sweeps, data sets, reports, the live view."""
