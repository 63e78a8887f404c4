"""The command line: one file per command, for users and scripts."""
