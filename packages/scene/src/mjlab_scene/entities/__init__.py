"""Entity: spec, state, indexing and actuation."""
