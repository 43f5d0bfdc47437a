import sys
from pathlib import Path

import torch

# Tests share a robot and its motions.
sys.path.insert(0, str(Path(__file__).parent))

# A second thread does not help with tiny tensors.
torch.set_num_threads(1)
