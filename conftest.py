"""Settings that must hold before any package is imported by a test."""

import os
from pathlib import Path

# Kernels are compiled once and kept between runs. Warp reads this when it is first imported.
os.environ.setdefault("WARP_CACHE_PATH", str(Path(__file__).parent / ".cache" / "warp"))
