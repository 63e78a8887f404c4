"""Layouts: message definitions, paths into them, and where each number lies in the bytes."""
