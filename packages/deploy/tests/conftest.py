import sys
from collections.abc import Generator
from pathlib import Path

import pytest
from mjlab_deploy import Bundle, open_bundle

sys.path.append(str(Path(__file__).parent))


@pytest.fixture
def bundle(tmp_path: Path) -> Generator[Bundle]:
  """The bundle of the pole, without a record."""
  from deploy_bundles import write_bundle

  with open_bundle(write_bundle(tmp_path / "bundle")) as opened:
    yield opened
