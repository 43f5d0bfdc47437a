"""Worlds on the page: scene, shapes, appearances and groups."""
