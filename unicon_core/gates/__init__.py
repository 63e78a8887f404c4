"""Gates: what must hold before a robot moves, asked while nothing is sent yet; and where it begins.

Each is asked in every tick of the wait, behind recv and estimate, until all hold. In a simulator
they pass by themselves. What each looks at is one sentence in docs/howto/preflight.md.
"""
