"""Rollouts of a fit on MuJoCo Warp agree with those of MuJoCo's own batch."""

import numpy as np
import pytest
from mjlab_core import MjlabError
from mjlab_sysid import IdentifyCfg, identify, parse_term
from mjlab_sysid.data.windows import cut
from mjlab_sysid.engines import EngineName
from mjlab_sysid.problem import Problem
from sysid_robots import arm, changed, record, sines

pytest.importorskip("mjlab_sim", reason="the extra 'warp' is not installed")

TERMS = [parse_term(text) for text in ("armature:hip", "delay:.*,shared")]


def test_warp_gives_the_residuals_and_derivatives_of_the_native_engine() -> None:
  robot = arm(imu="tip")
  made = record(
    robot, changed(robot, {"dof_armature:hip": 1.6}), sines(robot, 0, 0.5), signals=("position", "velocity", "imu")
  )
  engines: tuple[EngineName, ...] = ("native", "warp")
  native, warp = (Problem(robot, cut(robot, [made], 0.2), TERMS, {}, IdentifyCfg(engine=engine)) for engine in engines)
  x = np.zeros(2)
  one, other = (problem.predict(x[:, None]) for problem in (native, warp))
  for name, atol in (("position", 1e-5), ("velocity", 1e-3), ("angular_velocity", 1e-3), ("linear_acceleration", 0.05)):
    np.testing.assert_allclose(other[name], one[name], atol=atol, err_msg=name)
  slopes, others = (problem.jacobian(x)[0] for problem in (native, warp))
  # Relative to the length of each column; single precision needs wider differences.
  assert (np.linalg.norm(others - slopes, axis=0) < 0.03 * np.linalg.norm(slopes, axis=0)).all()


def test_the_native_engine_is_refused_on_a_gpu() -> None:
  robot = arm()
  made = record(robot, robot.model, sines(robot, 0, 1.0))
  with pytest.raises(MjlabError, match="engine 'native' runs on a CPU, the device is 'cuda:0'"):
    identify(robot, [made], TERMS, IdentifyCfg(engine="native", device="cuda:0"))
