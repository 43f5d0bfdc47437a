import sys
from pathlib import Path

# Manifests name the toy environment by module, so it must be importable.
sys.path.insert(0, str(Path(__file__).parent))
