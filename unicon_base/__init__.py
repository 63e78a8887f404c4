"""Below everything: errors, located YAML, schemas, resources, generated code."""
