"""Schemas: documents as dataclasses, whose types, units and bounds are read and exported.

A document is a dataclass whose fields are its keys; `Annotated` gives units, bounds and rules
(`marks`), the docstring says what each is. `read` returns an object of it or raises every mistake
with its line (`types`, `records`); `json_schema` gives editors a JSON Schema.
"""
