"""Buffers that overflow: the demand of the whole run, one line of advice, and room once the advice is followed."""

import re

import mujoco
import pytest
from mjlab_core import MjlabError
from mjlab_sim import Simulation, SimulationCfg
from sim_world import WORLD, MakeSim

# Nothing touches the floor to begin with: contacts that a model starts with must fit, or it is refused.
AIRBORNE = WORLD.replace(".0995", ".9").replace(".0495", ".9")
HEIGHTS = {2: 0.0995, 9: 0.0495, 16: 0.0995}


def place(sim: Simulation, *grounded: int) -> None:
  """Put these bodies on the floor and the others into the air, all at rest, and step once."""
  for start, height in HEIGHTS.items():
    sim.data.qpos[:, start] = height if start in grounded else 5.0
  sim.data.qvel.zero_()
  sim.step()


def advice(line: str) -> dict[str, int]:
  return {name.replace("-", "_"): int(value) for name, value in re.findall(r"--env\.sim\.([\w-]+) (\d+)", line)}


@pytest.mark.warp
@pytest.mark.parametrize(
  "small", [{"nconmax": 4}, {"njmax": 8}, {"nconmax": 4, "njmax": 8}], ids=["nconmax", "njmax", "both"]
)
def test_the_settings_of_the_one_line_make_room(make_sim: MakeSim, small: dict[str, int]) -> None:
  sim = make_sim("warp", spec=AIRBORNE, **small)
  for _ in range(3):
    place(sim, *HEIGHTS)
  (line,) = sim.overflow_report()
  assert "4 of 4 worlds needed at least" in line
  assert set(small) <= set(advice(line))
  for name, value in small.items():
    assert f"({name} is {value})" in line
  roomy = make_sim("warp", spec=AIRBORNE, **small | advice(line))
  for _ in range(3):
    place(roomy, *HEIGHTS)
  assert roomy.overflow_report() == []


@pytest.mark.warp
def test_too_few_rows_are_reported_with_the_contacts_that_were_advised(make_sim: MakeSim) -> None:
  sim = make_sim("warp", spec=AIRBORNE, nconmax=4, njmax=8)
  place(sim, *HEIGHTS)
  (line,) = sim.overflow_report()
  sim = make_sim("warp", spec=AIRBORNE, nconmax=advice(line)["nconmax"], njmax=8)
  place(sim, *HEIGHTS)
  (line,) = sim.overflow_report()
  assert list(advice(line)) == ["njmax"]


@pytest.mark.warp
def test_a_line_returns_only_when_the_demand_outgrows_its_advice(make_sim: MakeSim) -> None:
  sim = make_sim("warp", spec=AIRBORNE, njmax=4)
  lines = []
  # Demand comes and goes, and grows once; reports come more often than it does.
  for round_ in range(6):
    place(sim, 2)
    place(sim, 2)
    place(sim)
    place(sim)
    lines += sim.overflow_report()
    assert len(lines) == 1, (round_, lines)
  for _ in range(6):
    place(sim, *HEIGHTS)
    place(sim, *HEIGHTS)
    lines += sim.overflow_report()
  assert len(lines) == 2
  first, second = (advice(line)["njmax"] for line in lines)
  assert first < second
  assert sim.overflow_report() == []


@pytest.mark.warp
def test_the_demand_is_the_most_of_all_physics_steps_not_that_of_the_last(make_sim: MakeSim) -> None:
  sim = make_sim("warp", spec=AIRBORNE, njmax=8)
  place(sim, *HEIGHTS)
  place(sim, *HEIGHTS)
  peak = int(sim.data.nefc.max())
  assert peak > 8
  for _ in range(3):
    place(sim)
  sim.reset()
  assert f"4 of 4 worlds needed at least {peak} constraint rows (njmax is 8)" in sim.overflow_report()[0]


PILE = """<mujoco><size memory="20K"/><worldbody><geom type="plane" size="1 1 1"/>{}</worldbody></mujoco>""".format(
  "".join(f'<body pos="{0.01 * i} 0 .05"><freejoint/><geom size=".1"/></body>' for i in range(8))
)


def test_memory_that_ran_out_is_reported_once_in_spite_of_resets() -> None:
  sim = Simulation(2, mujoco.MjSpec.from_string(PILE), SimulationCfg(num_threads=1))
  for _ in range(3):
    sim.step()
  sim.reset()
  (line,) = sim.overflow_report()
  assert "2 of 2 worlds ran out of MuJoCo's memory" in line
  sim.step()
  assert sim.overflow_report() == []
  sim.close()
  found = re.search(r'<size memory="\d+"/>', line)
  assert found
  roomy = Simulation(2, mujoco.MjSpec.from_string(PILE.replace('<size memory="20K"/>', found[0])), SimulationCfg())
  for _ in range(3):
    roomy.step()
  assert roomy.overflow_report() == []
  roomy.close()


@pytest.mark.warp
def test_too_little_for_the_initial_state_is_refused_with_the_setting(make_sim: MakeSim) -> None:
  with pytest.raises(MjlabError, match="nconmax must be >= 7"):
    make_sim("warp", nconmax=4, njmax=8)
