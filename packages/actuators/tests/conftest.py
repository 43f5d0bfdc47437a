import sys
from pathlib import Path

import torch

# The tests share a module.
sys.path.insert(0, str(Path(__file__).parent))

# Tiny tensors: a second thread would only wait for the first.
torch.set_num_threads(1)
