"""Simulators, one folder each, for workflows that name one as their platform."""
