"""Action terms."""
