"""Importers: one file for each format that other people's training writes, all into `Facts`."""
