"""Simulators as platforms, one folder each; MuJoCo is one of the core."""
