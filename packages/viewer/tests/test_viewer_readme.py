"""The example in the README, and the imports of pictures."""

import re
import subprocess
import sys
from pathlib import Path


def test_the_readme_example_makes_a_picture(opengl: None) -> None:
  readme = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
  (example,) = re.findall(r"```python\n(.*?)```", readme, re.S)
  names: dict = {}
  exec(compile(example, "README.md", "exec"), names)
  assert names["picture"].shape == (160, 320, 3)


def test_pictures_import_no_browser_library() -> None:
  code = (
    "import mjlab_viewer, sys; mjlab_viewer.OffscreenRenderer, mjlab_viewer.SnapshotTaker\n"
    "assert not {'viser', 'mjviser', 'trimesh', 'av'} & set(sys.modules)"
  )
  subprocess.run([sys.executable, "-c", code], check=True)
