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
_TORSO, _FOOT, _SOLID = (0.20, 0.45, 0.85, 1.0), (0.95, 0.55, 0.10, 1.0), (0.62, 0.66, 0.70, 1.0)
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
  model.geom_rgba[of_robot] = _SOLID
  model.geom_rgba[model.geom_bodyid == model.body(f"robot/{torso}").id] = _TORSO
  for name in (name for foot in feet for name in foot.geoms):
    model.geom(f"robot/{name}").rgba[:] = _FOOT
  right = _render(home, (True, False, False, False, False, False))
  image = Image.fromarray(np.hstack((left, right)))
  draw, font = ImageDraw.Draw(image), ImageFont.load_default(18)
  draw.text((12, 10), "home pose", fill="black", font=font, stroke_width=2, stroke_fill="white")
  labels = [("colliding geoms", _SOLID), (f"torso: {torso}", _TORSO), *((f"foot: {foot.body}", _FOOT) for foot in feet)]
  for row, (text, color) in enumerate(labels):
    fill = tuple(round(255 * part) for part in color[:3])
    place = (WIDTH + 12, 10 + 24 * row)
    draw.text(place, text[:50], fill=fill, font=font, stroke_width=2, stroke_fill="white")
  file = io.BytesIO()
  image.save(file, format="PNG", optimize=True)
  return file.getvalue()


def _render(home: Home, geom_groups: tuple[bool, ...]) -> np.ndarray:
  camera = CameraCfg(distance=2.0 * home.model.stat.extent, azimuth=130.0, elevation=-18.0)
  cfg = PictureCfg(width=WIDTH, height=HEIGHT, camera=camera, geom_groups=geom_groups)
  with OffscreenRenderer(home.model, cfg) as renderer:
    return renderer.render(SnapshotTaker(Replay(home.model, {"qpos": home.qpos[None, None]}, 1.0)).take([0]))
