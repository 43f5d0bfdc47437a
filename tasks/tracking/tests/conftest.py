import sys
from pathlib import Path

import pytest
import torch

# Tests share an oracle and an environment.
sys.path.insert(0, str(Path(__file__).parent))

from tracking_env import clips

# A second thread does not help with tiny tensors.
torch.set_num_threads(1)


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
  """A folder of two short clips."""
  return clips(tmp_path_factory.mktemp("clips"))
