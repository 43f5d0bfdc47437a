"""Robots and records of `tools/identify_known.py`."""

import dataclasses

import identify_known
import numpy as np
import pytest
from mjlab_sysid import IdentifyCfg


@pytest.mark.parametrize("name", ["leg", "yam"])
def test_records_hold_the_joints_that_move_within_their_ranges(name: str) -> None:
  known = identify_known.ROBOTS[name]
  assert len(known.factors) + 1 == 12
  made = identify_known.sine_record(known, 0, 2.0)
  assert (made.joints, made.period, made.num_rows) == (known.joints, 0.01, 200)
  ranges = known.robot().ranges()
  for column, joint in enumerate(made.joints):
    low, high = ranges[joint]
    values = made.signals["position"][:, column]
    assert low < values.min() < values.max() < high
    assert np.ptp(values) > 0.05


def test_a_short_record_of_the_yam_determines_a_stiffness_and_a_mass() -> None:
  yam = identify_known.ROBOTS["yam"]
  short = dataclasses.replace(yam, factors={"stiffness:joint2": 0.8, "body_mass:link_4": 1.5})
  found = identify_known.found_in(short, [identify_known.sine_record(short, 0, 1.5)], IdentifyCfg(window=0.12))
  assert all(estimate.identifiable for estimate in found.estimates)
  wanted = [*short.factors.values(), identify_known.DELAY * identify_known.TIMESTEP]
  np.testing.assert_allclose(found.numbers, wanted, rtol=0.05)
