"""Documentation site of mjlab: `uv run docs` builds and serves it."""

__all__: list[str] = []
