"""What does not fit is counted, said with the setting to raise, and that setting is enough."""

import re
from collections.abc import Callable

import mujoco
import pytest
from mjlab_sim import Simulation, SimulationCfg, SimulationError
from sim_world import WORLD

MakeSim = Callable[..., Simulation]

pytestmark = pytest.mark.warp

# Nothing touches the floor to begin with: contacts that a model starts with must fit, or it is refused.
AIRBORNE = WORLD.replace(".0995", ".9").replace(".0495", ".9")


def land(sim: Simulation) -> list[str]:
  """Puts all bodies on the floor and says what did not fit."""
  for start, height in ((2, 0.0995), (9, 0.0495), (16, 0.0995)):
    sim.data.qpos[:, start] = height
  for _ in range(3):
    sim.step()
    sim.count_overflow()
  return sim.overflow_report()


def suggestion(report: list[str], setting: str) -> int:
  for line in report:
    if found := re.search(rf"Set --env\.sim\.{setting} (\d+)\.", line):
      return int(found.group(1))
  raise AssertionError(report)


@pytest.mark.parametrize(("setting", "too_few"), [("nconmax", 4), ("njmax", 8)])
def test_the_setting_in_the_report_makes_room(make_sim: MakeSim, setting: str, too_few: int) -> None:
  sim = make_sim("warp", spec=AIRBORNE, **{setting: too_few})
  report = land(sim)
  assert "4 of 4 worlds wanted up to" in report[0]
  assert f"{too_few} fit; the rest were dropped" in report[0]
  assert sim.overflow_report() == []
  sim.step()
  sim.count_overflow()
  sim.reset()
  assert sim.overflow_report() != []
  roomy = make_sim("warp", spec=AIRBORNE, **{setting: suggestion(report, setting)})
  assert land(roomy) == []


def test_what_fits_again_is_not_reported_again(make_sim: MakeSim) -> None:
  sim = make_sim("warp", spec=AIRBORNE, nconmax=4)
  assert land(sim) != []
  for start in (2, 9, 16):
    sim.data.qpos[:, start] = 5.0
  # The last step on the floor was counted with the one that leaves it.
  for _ in range(2):
    sim.step()
    sim.count_overflow()
  sim.overflow_report()
  sim.step()
  sim.count_overflow()
  assert sim.overflow_report() == []


PILE = """<mujoco><size memory="20K"/><worldbody><geom type="plane" size="1 1 1"/>{}</worldbody></mujoco>""".format(
  "".join(f'<body pos="{0.01 * i} 0 .05"><freejoint/><geom size=".1"/></body>' for i in range(8))
)


def test_memory_that_ran_out_is_reported_whatever_was_reset_since() -> None:
  sim = Simulation(2, mujoco.MjSpec.from_string(PILE), SimulationCfg(num_threads=1))
  for _ in range(3):
    sim.step()
  sim.count_overflow()
  sim.reset()
  assert "2 of 2 worlds ran out of MuJoCo's memory" in sim.overflow_report()[0]
  assert sim.overflow_report() == []
  sim.step()
  sim.count_overflow()
  assert "2 of 2 worlds" in sim.overflow_report()[0]
  sim.close()


def test_nothing_is_reported_where_all_fits(make_sim: MakeSim, engine: str) -> None:
  assert land(make_sim(engine, spec=AIRBORNE)) == []


def test_too_little_for_the_model_at_rest_is_refused_by_name(make_sim: MakeSim) -> None:
  with pytest.raises(SimulationError, match="nconmax must be >= 7"):
    make_sim("warp", nconmax=4)
