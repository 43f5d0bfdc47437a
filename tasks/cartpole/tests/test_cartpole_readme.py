from collections.abc import Callable


def test_the_examples_of_the_readme_print_the_shown_output(run_readme: Callable[..., object]) -> None:
  run_readme(prints=True)
