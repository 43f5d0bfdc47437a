"""The example in the README, and the imports of pictures."""

import subprocess
import sys
from collections.abc import Callable
from typing import Any


def test_the_readme_example_makes_a_picture(opengl: None, run_readme: Callable[..., dict[str, Any]]) -> None:
  assert run_readme()["picture"].shape == (160, 320, 3)


def test_pictures_import_no_browser_library() -> None:
  code = (
    "import mjlab_viewer, sys; mjlab_viewer.OffscreenRenderer, mjlab_viewer.SnapshotTaker\n"
    "assert not {'viser', 'mjviser', 'trimesh', 'av'} & set(sys.modules)"
  )
  subprocess.run([sys.executable, "-c", code], check=True)
