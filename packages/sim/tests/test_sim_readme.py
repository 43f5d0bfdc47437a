"""The example in the README runs."""

import re
from pathlib import Path

import pytest
from mjlab_core import MjlabError


def test_the_readme_example_of_the_simulation_runs() -> None:
  readme = (Path(__file__).parents[1] / "README.md").read_text()
  examples = re.findall(r"```python\n(.*?)```", readme, re.S)
  assert examples
  for example in examples:
    exec(compile(example, "README.md", "exec"), {})


def test_a_simple_body_that_is_changed_says_what_to_do(make_sim) -> None:
  spec = "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
  sim = make_sim(spec=spec)
  sim.expand_model_fields(["body_ipos"])
  sim.model.body_ipos[:, 1, 0] += 0.1
  with pytest.raises(MjlabError, match=r"recompute_constants:.*simple='false'"):
    sim.recompute_constants()
