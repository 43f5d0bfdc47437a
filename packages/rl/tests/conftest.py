import sys
from pathlib import Path

import torch
from mjlab_rl import trust_package

# Manifests name the toy environment by module, so it must be importable.
sys.path.insert(0, str(Path(__file__).parent))
for module in ("rl_point_env", __name__):
  trust_package(module.partition(".")[0])

# Tiny tensors: a second thread would only wait for the first.
torch.set_num_threads(1)
