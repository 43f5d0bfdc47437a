import sys
from pathlib import Path

# Tests share small robots.
sys.path.append(str(Path(__file__).parent))
