import sys
from collections.abc import Generator
from pathlib import Path

import pytest
import torch

# Manifests name the pendulum by module, so it must be importable.
sys.path.insert(0, str(Path(__file__).parent))

# Tiny tensors: a second thread would only wait for the first.
torch.set_num_threads(1)


@pytest.fixture
def pendulum() -> Generator[None]:
  """The task of the pendulum."""
  import mjlab_pendulum

  with mjlab_pendulum.registered():
    yield


@pytest.fixture
def pendulum_here(pendulum: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
  """The task of the pendulum, and an empty folder as the present one."""
  monkeypatch.chdir(tmp_path)


@pytest.fixture
def opengl() -> None:
  """Skip the test where there are no pictures."""
  from mjlab_core import RenderingError
  from mjlab_viewer.pictures.opengl import make_context

  try:
    make_context(8, 8).free()
  except RenderingError as error:
    pytest.skip(str(error))
