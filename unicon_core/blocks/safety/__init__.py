"""Safety blocks: limits that amend commands, and stops that raise a fault; each usable anywhere.

What each looks for is one sentence in docs/safety.md. They stand in stage `safety`, the last before
`send`, and change nothing of a healthy run.
"""
