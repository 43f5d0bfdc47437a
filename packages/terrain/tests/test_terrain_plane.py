"""The infinite plane, in models from elsewhere."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mjlab_terrain import PlaneCfg, grid_origins

BALL = """
<mujoco model="mine">
  <worldbody>
    <body name="ball" pos="3 -40 0.3"><freejoint/><geom name="ball" size="0.1" mass="1"/></body>
  </worldbody>
</mujoco>"""


def test_a_ball_comes_to_rest_on_it_far_from_the_origin() -> None:
  spec = mujoco.MjSpec.from_string(BALL)
  PlaneCfg().add_to(spec)
  model = spec.compile()
  data = mujoco.MjData(model)
  mujoco.mj_step(model, data, nstep=1500)
  assert abs(data.qpos[2] - 0.1) < 1e-3
  assert np.abs(data.qvel).max() < 1e-3


def test_body_geom_and_look_carry_its_name() -> None:
  spec = mujoco.MjSpec.from_string(BALL)
  terrain = PlaneCfg(name="floor", friction=(0.4, 0.01, 0.001)).add_to(spec)
  model = spec.compile()
  geom = model.geom("floor")
  assert (terrain.name, terrain.geom_names) == ("floor", ("floor",))
  assert geom.type == mujoco.mjtGeom.mjGEOM_PLANE
  assert model.body(geom.bodyid[0]).name == "floor"
  assert model.body_weldid[geom.bodyid[0]] == 0
  np.testing.assert_array_equal(geom.friction, (0.4, 0.01, 0.001))
  assert model.mat(geom.matid[0]).name == "floor"
  assert model.mat_texid[geom.matid[0], mujoco.mjtTextureRole.mjTEXROLE_RGB] == model.tex("floor").id
  assert model.light("floor").type == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL


def test_the_rest_of_the_model_does_not_change() -> None:
  alone = mujoco.MjSpec.from_string(BALL).compile()
  spec = mujoco.MjSpec.from_string(BALL)
  PlaneCfg(light=False).add_to(spec)
  model = spec.compile()
  assert model.nlight == 0
  assert (model.nq, model.nv) == (alone.nq, alone.nv)
  np.testing.assert_array_equal(model.body("ball").inertia, alone.body("ball").inertia)
  assert mujoco.MjSpec.from_string(spec.to_xml()).compile().ngeom == 2


@pytest.mark.parametrize(
  ("cfg", "message"),
  [
    (PlaneCfg(friction=(-0.1, 0.0, 0.0)), r"friction \(-0.1, 0.0, 0.0\) must be at least 0"),
    (PlaneCfg(square=0.0), "square 0.0 must be at least 0.001"),
  ],
)
def test_a_bad_setting_is_refused_and_leaves_the_model_alone(cfg: PlaneCfg, message: str) -> None:
  spec = mujoco.MjSpec.from_string(BALL)
  with pytest.raises(ValueError, match=message):
    cfg.add_to(spec)
  assert len(spec.bodies) == 2
  assert not spec.textures


@pytest.mark.parametrize("num", [1, 2, 3, 4, 7, 10, 64, 1000])
def test_origins_are_distinct_centred_and_a_spacing_apart(num: int) -> None:
  origins = grid_origins(num, 2.5)
  assert origins.shape == (num, 3)
  assert origins.dtype == np.float64
  assert (origins[:, 2] == 0.0).all()
  distance = np.linalg.norm(origins[:, None] - origins[None], axis=-1) + 1e9 * np.eye(num)
  assert num == 1 or distance.min() == pytest.approx(2.5)
  assert np.abs(origins).max() <= 2.5 * (np.sqrt(num) + 1)


def test_a_full_grid_is_symmetric_about_zero() -> None:
  np.testing.assert_array_equal(grid_origins(1, 2.0), np.zeros((1, 3)))
  np.testing.assert_array_equal(grid_origins(4, 2.0)[:, :2], [(1.0, -1.0), (1.0, 1.0), (-1.0, -1.0), (-1.0, 1.0)])


def test_a_terrain_gives_origins_on_its_surface() -> None:
  terrain = PlaneCfg().add_to(mujoco.MjSpec())
  np.testing.assert_array_equal(terrain.env_origins(9, 1.5), grid_origins(9, 1.5))


def test_the_example_of_the_readme_runs() -> None:
  readme = Path(__file__).parents[1] / "README.md"
  for block in re.findall(r"```python\n(.*?)```", readme.read_text(), re.DOTALL):
    exec(compile(block, str(readme), "exec"), {})


def test_it_needs_no_torch() -> None:
  source = Path(__file__).parents[1] / "src"
  assert not any(re.search(r"^\s*(import|from) torch", p.read_text(), re.MULTILINE) for p in source.rglob("*.py"))
