"""The machine file: models, loading, JSON Schema."""
