"""The loopback robot draws the images of its cameras and sends them with its states."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from deploy_bundles import DESCRIPTION, SCENE, write_bundle
from mjlab_deploy import DeployError, Input, Origin, open_bundle
from mjlab_deploy.simulation.loopback import LoopbackRobot

# A camera above the pole looks down on a red box; what its sensor sees is twice as wide as high.
EYE = """
    <camera name="robot/eye" pos="1 0 2" sensorsize=".02 .01" focal=".01 .01" resolution="8 8"/>
    <geom type="box" size=".2 .2 .5" pos="1 0 .5" rgba="1 0 0 1"/>
    <geom type="sphere" size=".1" pos="1 0 1.5" group="3"/>"""
KINDS: dict[Any, tuple[int, ...]] = {"camera_rgb": (3, 8, 8), "camera_depth": (1, 8, 8)}


def make(folder: Path, camera: str = "robot/eye") -> Path:
  origins = {kind: Origin(quantity=kind, object_type="camera", name=camera, geom_groups=(0,)) for kind in KINDS}
  images = tuple(Input(name=kind, shape=shape, origin=origins[kind]) for kind, shape in KINDS.items())
  description = replace(DESCRIPTION, inputs=(*DESCRIPTION.inputs, *images))
  return write_bundle(folder, description, scene=SCENE.replace("<worldbody>", "<worldbody>" + EYE))


def robot(folder: Path, **options: int) -> LoopbackRobot:
  with open_bundle(folder) as bundle:
    try:
      return LoopbackRobot(bundle, **options)
    except DeployError as error:
      if "OpenGL" in str(error):
        pytest.skip(str(error))
      raise


def test_images_come_with_the_state(tmp_path: Path) -> None:
  found = robot(make(tmp_path))
  assert set(found.info().readings) == set(KINDS)
  found.advance()
  state = found.read()
  assert state is not None
  depth, colours = (state.readings[name] for name in ("camera_depth", "camera_rgb"))
  # The box's top is 1 m below, 0.4 m wide, and the 1 m x 1 m that are seen there are 8 pixels.
  assert depth[0, 3:5, 3:5] == pytest.approx(1.0, abs=1e-5)
  assert set(np.unique(depth[0, [0, -1]])) == {-1.0}
  red, green, _ = colours[:, 3, 3]
  assert red > 0.3 > green
  assert colours[:, 0, 0] == pytest.approx(0.0)


def test_images_are_late_like_states(tmp_path: Path) -> None:
  late = robot(make(tmp_path), delay=3)
  for _ in range(3):
    late.advance()
    assert late.read() is None
  late.advance()
  state = late.read()
  assert state is not None
  assert late.read() is state
  assert set(state.readings) == set(KINDS)


def test_a_camera_that_the_scene_lacks_is_named(tmp_path: Path) -> None:
  message = r"input 'camera_rgb': scene\.xml has no camera 'robot/ear'"
  with open_bundle(make(tmp_path, "robot/ear")) as bundle, pytest.raises(DeployError, match=message):
    LoopbackRobot(bundle)
