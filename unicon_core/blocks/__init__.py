"""Blocks that come with unicon: postures, commands, safety, for workflow authors."""
