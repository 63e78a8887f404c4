"""Models: files of robots found, read, mended and written, for simulators, check and viewers."""
