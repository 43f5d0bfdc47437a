"""The search for pairs of geoms may be chosen, and finds the same contacts."""

import pytest
import torch
from sim_world import MakeSim


@pytest.mark.warp
def test_every_search_finds_the_same_contacts(make_sim: MakeSim) -> None:
  ends = []
  for options in ({}, {"broadphase": "nxn"}, {"broadphase": "sap_tile"}, {"broadphase_filter": ("plane", "aabb")}):
    sim = make_sim("warp", num_envs=2, **options)
    for _ in range(60):
      sim.step()
    ends.append(sim.data.qpos)
  for end in ends[1:]:
    torch.testing.assert_close(end, ends[0], rtol=0.0, atol=1e-5)
