"""Shapes over a picture: debug drawings and contacts."""
