"""Picture of a robot in its home pose, with its visual geoms and with its collision set, the guesses in colors."""

import io
from collections.abc import Sequence

import mujoco
import numpy as np
from mjlab_viewer import CameraCfg, OffscreenRenderer, PictureCfg, Replay, SnapshotTaker
from PIL import Image, ImageDraw, ImageFont

from mjlab.new.limbs import Foot, colliding
from mjlab.new.settling import Home

WIDTH, HEIGHT = 560, 480
_TORSO, _FOOT, _SOLID = (51, 115, 217, 255), (242, 140, 26, 255), (158, 168, 178, 255)
_HIDDEN_GROUP = 5


def robot_picture(home: Home, torso: str, feet: Sequence[Foot]) -> bytes:
  """Return a PNG file.

  Raises:
    RenderingError: OpenGL does not work.
  """
  model = home.model
  has_visuals = bool((model.geom_group == 2).any())
  left = _render(home, (True, True, True, not has_visuals, False, False))
  of_robot = model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE
  model.geom_group[of_robot] = _HIDDEN_GROUP
  model.geom_group[colliding(model)] = 0
  model.geom_matid[of_robot] = -1
  model.geom_rgba[of_robot] = np.divide(_SOLID, 255)
  model.geom_rgba[model.geom_bodyid == model.body(f"robot/{torso}").id] = np.divide(_TORSO, 255)
  for name in (name for foot in feet for name in foot.geoms):
    model.geom(f"robot/{name}").rgba[:] = np.divide(_FOOT, 255)
  right = _render(home, (True, False, False, False, False, False))
  image = Image.fromarray(np.hstack((left, right)))
  draw, font = ImageDraw.Draw(image), ImageFont.load_default(18)
  draw.text((12, 10), "home pose", fill="black", font=font, stroke_width=2, stroke_fill="white")
  labels = [("colliding geoms", _SOLID), (f"torso: {torso}", _TORSO), *((f"foot: {foot.body}", _FOOT) for foot in feet)]
  for row, (text, color) in enumerate(labels):
    place = (WIDTH + 12, 10 + 24 * row)
    draw.text(place, text[:50], fill=color, font=font, stroke_width=2, stroke_fill="white")
  file = io.BytesIO()
  image.save(file, format="PNG", optimize=True)
  return file.getvalue()


def _render(home: Home, geom_groups: tuple[bool, ...]) -> np.ndarray:
  camera = CameraCfg(distance=2.0 * home.model.stat.extent, azimuth=130.0, elevation=-18.0)
  cfg = PictureCfg(width=WIDTH, height=HEIGHT, camera=camera, geom_groups=geom_groups)
  with OffscreenRenderer(home.model, cfg) as renderer:
    return renderer.render(SnapshotTaker(Replay(home.model, {"qpos": home.qpos[None, None]}, 1.0)).take([0]))
