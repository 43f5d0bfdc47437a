"""Changes of models: edits, overlays and variants."""
