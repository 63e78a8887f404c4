"""Flow: blocks composed by zip, chain and loop, checked and compiled, for workflow authors."""
