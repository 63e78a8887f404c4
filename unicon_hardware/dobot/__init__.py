"""Dobot's Atom over DDS."""
