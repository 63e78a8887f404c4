"""Safety blocks: limits that amend commands, and stops that raise a fault; each usable anywhere.

docs/explanation/safety.md has a sentence on each. They stand in stage `safety`, the last before
`send`, and change nothing of a healthy run.
"""
