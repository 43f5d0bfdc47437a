from collections.abc import Callable
from pathlib import Path

from deploy_bundles import write_bundle


def test_the_examples_of_the_readme_run(tmp_path: Path, run_readme: Callable[[], object]) -> None:
  write_bundle(tmp_path / "bundle")
  run_readme()
