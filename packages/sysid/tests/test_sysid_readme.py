from collections.abc import Callable


def test_the_examples_of_the_readme_run(run_readme: Callable[..., object]) -> None:
  run_readme()
