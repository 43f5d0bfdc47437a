"""Packages that `mjlab new` writes: robots from model files, and tasks."""

__all__: list[str] = []
