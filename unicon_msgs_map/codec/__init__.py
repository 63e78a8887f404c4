"""Codecs: arrays to bytes and bytes to arrays, fast where it is safe and careful elsewhere."""
