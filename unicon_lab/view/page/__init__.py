"""The live page: robot, plots, timing and controls in the browser, by viser."""
