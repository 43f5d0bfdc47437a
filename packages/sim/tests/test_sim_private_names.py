"""Private names of MuJoCo Warp and Warp: listed in one module each, and replaceable by public functions."""

import importlib
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab_core import MjlabError
from mjlab_sim import Simulation, SimulationCfg
from mjlab_sim.warp import internals
from mjlab_sim.warp.solver import tile_solvers

HOMES = {"mujoco_warp": internals, "warp": tile_solvers}


@pytest.mark.parametrize("library", HOMES)
def test_every_private_name_is_listed_with_a_reason_and_exists(library: str) -> None:
  for name, reason in HOMES[library].PRIVATE.items():
    assert len(reason.split()) > 4, name
    found: Any = None
    parts, rest = name.split("."), []
    while parts:
      try:
        found = importlib.import_module(".".join(parts))
        break
      except ModuleNotFoundError:
        rest.insert(0, parts.pop())
    for part in rest:
      found = getattr(found, part)


GROUND = """
<mujoco>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <geom type="plane" size="3 3 .1"/><geom type="box" size=".3 .3 .2" pos=".5 0 .2"/>
    <body name="robot" pos="0 0 1"><freejoint/><geom type="sphere" size=".1" mass="1"/>
      <body name="arm" pos=".3 0 0"><joint axis="0 1 0"/><geom type="capsule" size=".05 .1" mass=".5"/></body></body>
  </worldbody>
</mujoco>
"""


def results() -> list[torch.Tensor]:
  """Distances, geoms and normals of rays, and derived constants."""
  sim = Simulation(2, mujoco.MjSpec.from_string(GROUND), SimulationCfg(engine="warp", nconmax=8, njmax=32))
  sim.expand_model_fields(["body_mass"])
  sim.model.body_mass[1] *= 2.0
  sim.recompute_constants()
  caster = sim.make_ray_caster(16, bodyexclude=1, max_distance=1.5)
  directions = np.random.default_rng(0).normal(0.0, 0.5, (2, 16, 3)) - np.array([0.0, 0.0, 1.0])
  directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
  hits = caster.cast(sim.data.xpos[:, 1:2].expand(2, 16, 3), torch.as_tensor(directions, dtype=torch.float32))
  assert hits.geomid is not None
  found = [hits.distance, hits.geomid, hits.normal, sim.model.dof_invweight0, sim.model.body_invweight0]
  found = [tensor.clone() for tensor in found]
  sim.close()
  return found


@pytest.mark.warp
def test_another_minor_of_mujoco_warp_takes_public_functions(monkeypatch: pytest.MonkeyPatch) -> None:
  expected = results()
  assert len(expected[1].unique()) > 2
  monkeypatch.setattr(internals, "IS_TESTED", False)
  for name in ("ray_geom", "tendon_armature"):
    monkeypatch.setattr(internals, name, None)
  for ours, public in zip(expected, results(), strict=True):
    torch.testing.assert_close(ours, public, rtol=1e-4, atol=1e-5)
  sim = Simulation(1, mujoco.MjSpec.from_string(GROUND), SimulationCfg(engine="warp", nconmax=8, njmax=32))
  with pytest.raises(MjlabError, match=r"exclude_trees needs mujoco-warp 4\.0"):
    sim.make_ray_caster(1, bodyexclude=2, exclude_trees=True)
  sim.close()
