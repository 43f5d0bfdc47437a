import sys
from pathlib import Path

import pytest
import torch

# Tests share an environment.
sys.path.insert(0, str(Path(__file__).parent))

# A second thread does not help with tiny tensors.
torch.set_num_threads(1)


@pytest.fixture(scope="session")
def opengl() -> None:
  """Skip the test where pictures cannot be made."""
  from mjlab_core import RenderingError
  from mjlab_viewer.pictures.opengl import make_context

  try:
    make_context(8, 8).free()
  except RenderingError as error:
    pytest.skip(str(error))
