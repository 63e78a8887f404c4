"""Platforms in a process of their own, for `platform: {child: NAME}`."""
