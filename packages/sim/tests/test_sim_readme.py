from collections.abc import Callable

import pytest
from mjlab_core import MjlabError


def test_the_examples_of_the_readme_run(run_readme: Callable[[], object]) -> None:
  run_readme()


def test_changing_a_simple_body_is_refused_with_the_way_out(make_sim) -> None:
  spec = "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
  sim = make_sim(spec=spec)
  sim.expand_model_fields(["body_ipos"])
  sim.model.body_ipos[:, 1, 0] += 0.1
  with pytest.raises(MjlabError, match=r"recompute_constants:.*simple='false'"):
    sim.recompute_constants()
