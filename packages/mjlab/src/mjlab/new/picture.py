"""Picture of a robot in its home pose, as drawn and as its collision set with the guesses in colours."""

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
  left = _render(home)
  soles = {name for foot in feet for name in foot.geoms}
  solid = set(colliding(model))
  for i in range(model.ngeom):
    if not model.geom(i).name.startswith("robot/"):
      continue
    body = model.body(model.geom_bodyid[i]).name
    is_sole = model.geom(i).name.removeprefix("robot/") in soles
    model.geom_group[i] = 0 if i in solid else _HIDDEN_GROUP
    model.geom_matid[i] = -1
    model.geom_rgba[i] = _FOOT if is_sole else _TORSO if body == f"robot/{torso}" else _SOLID
  right = _render(home)
  image = Image.fromarray(np.hstack((left, right)))
  draw, font = ImageDraw.Draw(image), ImageFont.load_default(18)
  draw.text((12, 10), "home pose", fill="black", font=font, stroke_width=2, stroke_fill="white")
  labels = [("colliding geoms", _SOLID), (f"torso: {torso}", _TORSO), *((f"foot: {foot.body}", _FOOT) for foot in feet)]
  for row, (text, colour) in enumerate(labels):
    top = 10 + 24 * row
    fill = tuple(round(255 * part) for part in colour[:3])
    draw.rectangle((WIDTH + 12, top + 3, WIDTH + 28, top + 19), fill=fill, outline="black")
    draw.text((WIDTH + 36, top), text[:50], fill="black", font=font, stroke_width=2, stroke_fill="white")
  file = io.BytesIO()
  image.save(file, format="PNG", optimize=True)
  return file.getvalue()


def _render(home: Home) -> np.ndarray:
  model, data = home.model, mujoco.MjData(home.model)
  data.qpos[:] = home.qpos
  mujoco.mj_forward(model, data)
  points = [data.geom_xpos[i] for i in range(model.ngeom) if model.geom(i).name.startswith("robot/")]
  low, high = np.min(points, axis=0), np.max(points, axis=0)
  x, y, z = 0.5 * (low + high)
  distance = max(0.3, 1.9 * float(np.linalg.norm(high - low)))
  cfg = PictureCfg(
    width=WIDTH,
    height=HEIGHT,
    camera=CameraCfg(lookat=(x, y, z), distance=distance, azimuth=130.0, elevation=-18.0),
    geom_groups=(True, True, True, not (model.geom_group == 2).any(), False, False),
  )
  with OffscreenRenderer(model, cfg) as renderer:
    return renderer.render(SnapshotTaker(Replay(model, {"qpos": home.qpos[None, None]}, 1.0)).take([0]))
