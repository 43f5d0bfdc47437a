"""The search for pairs of geoms may be chosen, and finds the same contacts."""

from typing import Any

import mujoco
import numpy as np
import pytest
from mjlab_core import ConfigError
from mjlab_sim import Simulation, SimulationCfg
from sim_world import SIZES, WORLD


def contacts(**options: Any) -> np.ndarray:
  spec = mujoco.MjSpec.from_string(WORLD)
  sim = Simulation(2, spec, SimulationCfg(engine="warp", **SIZES, **options), "cpu")
  for _ in range(60):
    sim.step()
  qpos = sim.data.qpos.numpy().copy()
  sim.close()
  return qpos


@pytest.mark.warp
def test_every_search_finds_the_same_contacts() -> None:
  default = contacts()
  for broadphase in ("nxn", "sap_tile"):
    np.testing.assert_allclose(contacts(broadphase=broadphase), default, atol=1e-5)
  np.testing.assert_allclose(contacts(broadphase_filter=("plane", "aabb")), default, atol=1e-5)


def test_a_search_that_does_not_exist_is_refused() -> None:
  with pytest.raises(ConfigError, match="broadphase 'sap' does not exist"):
    SimulationCfg(broadphase="sap").validate()  # type: ignore
  with pytest.raises(ConfigError, match="broadphase_filter 'obbb' does not exist"):
    SimulationCfg(broadphase_filter=("obbb",)).validate()  # type: ignore
