"""Reading of clips in the formats of the field."""
