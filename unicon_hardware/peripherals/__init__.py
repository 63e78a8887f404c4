"""Peripherals: cameras, headsets and scanners, each in a process of its own beside the tick.

A device's process says what it has through shared memory: small values (poses, axes) in a group,
large ones (images, clouds) in `FrameRing`s, of which states hold the handles. The tick reads one
word, and copies what is new.
"""
