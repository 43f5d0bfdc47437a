import sys
from pathlib import Path

import pytest
import torch

# The oracle is a module beside the tests.
sys.path.insert(0, str(Path(__file__).parent))

from tracking_env import clips

# Tiny tensors: a second thread would only wait for the first.
torch.set_num_threads(1)


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
  """A folder of two short clips."""
  return clips(tmp_path_factory.mktemp("clips"))
