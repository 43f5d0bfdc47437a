import sys
from pathlib import Path

import pytest
import torch

# The environment that several tests share lies beside them.
sys.path.insert(0, str(Path(__file__).parent))

# Tiny tensors: a second thread would only wait for the first.
torch.set_num_threads(1)


@pytest.fixture(scope="session")
def opengl() -> None:
  """Skips where pictures cannot be made."""
  from mjlab_core import RenderingError
  from mjlab_viewer.pictures.opengl import make_context

  try:
    make_context(8, 8).free()
  except RenderingError as error:
    pytest.skip(str(error))
