"""Mapping files: YAML into specs, every mistake named with its line; for `load_map`."""
