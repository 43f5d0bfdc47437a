"""Entity: spec, state, indexing, quantities and actuation."""
