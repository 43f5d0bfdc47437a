"""One entity that is another object in another world."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab_core.errors import MjlabError
from mjlab_scene import EntityCfg, InitialStateCfg, Scene, SceneCfg, VariantEntity, VariantEntityCfg
from mjlab_scene.models.variants import assign
from mjlab_sim import Simulation
from mjlab_terrain import PlaneCfg
from scene_models import MakeWorlds

BALL = '<geom name="shell" size=".06" mass=".4" friction=".9 .02 .001" condim="6"/>'
CRATE = """<geom name="side" type="box" size=".05 .08 .1" mass="1.2" pos=".02 0 .01"/>
  <geom name="lid" type="cylinder" size=".03 .02" pos=".02 0 .13" quat=".9 .1 0 0" mass=".3"/>"""
WEDGE = '<geom name="hull" type="mesh" mesh="wedge" mass=".7"/>'
ASSET = '<asset><mesh name="wedge" vertex="0 0 0 .2 0 0 0 .15 0 .2 .15 0 0 0 .1 0 .15 .1"/></asset>'
NAMES = ("ball", "crate", "wedge", "nothing")


def spec_of(geoms: str, joint: str = "<freejoint/>", asset: str = ASSET) -> Callable[[], mujoco.MjSpec]:
  xml = f'<mujoco>{asset}<worldbody><body name="thing">{joint}{geoms}</body></worldbody></mujoco>'
  return lambda: mujoco.MjSpec.from_string(xml)


SOLID: dict[str, Callable[[], mujoco.MjSpec]] = {
  "ball": spec_of(BALL),
  "crate": spec_of(CRATE),
  "wedge": spec_of(WEDGE),
}
OBJECTS: dict[str, Callable[[], mujoco.MjSpec] | None] = {**SOLID, "nothing": None}
START = InitialStateCfg(pos=(0.0, 0.0, 0.3), rot=(0.96, 0.2, 0.1, 0.14), lin_vel=(0.2, 0.0, 0.0))


@pytest.fixture
def make(make_worlds: MakeWorlds) -> MakeWorlds:
  def build(entity: EntityCfg, engine: str = "native", num_envs: int = 4) -> tuple[Scene, Simulation]:
    cfg = SceneCfg(num_envs=num_envs, terrain=PlaneCfg(), entities={"thing": entity}, env_spacing=0.0)
    return make_worlds(engine=engine, cfg=cfg, sizes={"nconmax": 16, "njmax": 64})

  return build


def all_of_them(assignment: Any = NAMES) -> VariantEntityCfg:
  return VariantEntityCfg(variants=OBJECTS, init_state=START, assignment=assignment)


def test_an_overlay_changes_geoms_and_is_refused_for_fields_of_single_variants(make, tmp_path: Path) -> None:
  def overlaid(model: dict[str, Any]) -> VariantEntityCfg:
    path = tmp_path / "identified.json"
    path.write_text(json.dumps({"format": "mjlab overlay 1", "model": model}))
    return VariantEntityCfg(variants=OBJECTS, init_state=START, overlay=str(path))

  _, sim = make(overlaid({"geom_friction": {"crate/side": [0.3, 0.004, 0.0002]}}))
  assert sim.mj_model.geom("thing/crate/side").friction.tolist() == [0.3, 0.004, 0.0002]
  with pytest.raises(MjlabError, match=r"identified\.json.*every variant has a separate body_mass"):
    make(overlaid({"body_mass": {"object": [2.0]}}))


def test_every_world_has_the_mass_and_inertia_of_its_object(make) -> None:
  scene, sim = make(all_of_them())
  body = sim.mj_model.body("thing/object").id
  assert scene["thing"].variant.tolist() == [0, 1, 2, 3]
  for world, name in enumerate(NAMES[:3]):
    alone = SOLID[name]().compile()
    model = sim._engine._batch.get_model(world)
    assert model.body_mass[body] == pytest.approx(alone.body_mass[1])
    np.testing.assert_allclose(model.body_ipos[body], alone.body_ipos[1], atol=1e-12)
    tensors = []
    for mj, i in ((model, body), (alone, 1)):
      axes = np.zeros(9)
      mujoco.mju_quat2Mat(axes, mj.body_iquat[i])
      axes = axes.reshape(3, 3)
      tensors.append(axes @ np.diag(mj.body_inertia[i]) @ axes.T)
    np.testing.assert_allclose(*tensors, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(model.dof_invweight0, alone.dof_invweight0, rtol=1e-9)
    assert model.body_subtreemass[0] == pytest.approx(alone.body_subtreemass[0])


def test_each_falls_rolls_and_rests_as_it_would_alone_and_nothing_stays_where_it_is(make) -> None:
  _, sim = make(all_of_them())
  for _ in range(250):
    sim.step()
  for world, name in enumerate(NAMES[:3]):
    _, alone = make(EntityCfg(spec_fn=SOLID[name], init_state=START), num_envs=1)
    for _ in range(250):
      alone.step()
    # Down to the rounding of another order of operations, and what rolling makes of it.
    torch.testing.assert_close(sim.data.qpos[world], alone.data.qpos[0], rtol=0.0, atol=1e-6)
    assert sim.data.qpos[world, 2] < 0.2
  torch.testing.assert_close(sim.data.qpos[3, 2], torch.tensor(0.3, dtype=sim.dtype), rtol=0.0, atol=1e-12)


@pytest.mark.warp
def test_engines_agree_on_worlds_with_different_objects(make) -> None:
  worlds = [make(all_of_them(), engine)[1] for engine in ("native", "warp")]
  for sim in worlds:
    for _ in range(150):
      sim.step()
  native, warp = (sim.data.qpos.double() for sim in worlds)
  assert (native[:3, 2] < 0.2).all()
  torch.testing.assert_close(warp, native, rtol=0.0, atol=5e-3)


@pytest.mark.parametrize("engine", ["native", pytest.param("warp", marks=pytest.mark.warp)])
def test_rays_meet_only_objects_that_are_there(make, engine) -> None:
  _, sim = make(all_of_them(), engine)
  down = torch.tensor([0.0, 0.0, -1.0]).expand(4, 1, 3)
  hits = sim.make_ray_caster(1).cast(torch.tensor([0.02, 0.02, 1.0]).expand(4, 1, 3), down)
  names = [sim.mj_model.geom(int(geom)).name for geom in hits.geomid[:, 0]]
  assert [name.removeprefix("thing/").split("/")[0] for name in names[:3]] == ["ball", "crate", "wedge"]
  assert "thing" not in names[3]
  torch.testing.assert_close(hits.distance[3, 0].float(), torch.tensor(1.0))


def test_randomisation_starts_from_the_object_of_each_world(make) -> None:
  _, sim = make(all_of_them())
  body = sim.mj_model.body("thing/object").id
  masses = sim.default_field("body_mass")[:, body]
  torch.testing.assert_close(masses[:3], torch.tensor([0.4, 1.5, 0.7], dtype=sim.dtype))
  sim.model.body_mass.mul_(2.0)
  torch.testing.assert_close(sim.default_field("body_mass")[:, body], masses)


def save(scene: Scene, sim: Simulation) -> dict[str, Any]:
  return {"scene": scene.state_dict(), "sim": sim.state_dict()}


def load(scene: Scene, sim: Simulation, state: dict[str, Any]) -> None:
  scene.load_state_dict(state["scene"])
  sim.load_state_dict(state["sim"])
  scene.load_state_dict(state["scene"])


@pytest.mark.parametrize("engine", ["native", pytest.param("warp", marks=pytest.mark.warp)])
def test_worlds_that_are_loaded_have_the_objects_that_were_saved(make, engine) -> None:
  saved, sim = make(all_of_them(), engine)
  scene, other = make(all_of_them(("wedge", "nothing", "ball", "crate")), engine)
  there = scene["thing"].geom_is_there
  load(scene, other, save(saved, sim))
  assert scene["thing"].variant.tolist() == [0, 1, 2, 3]
  # In place, for code that keeps a reference.
  assert torch.equal(there, saved["thing"].geom_is_there)
  for name in sim.expanded_fields:
    assert torch.equal(other.model[name], sim.model[name]), name
    assert torch.equal(other.default_field(name), sim.default_field(name)), name
  for _ in range(150):
    sim.step()
    other.step()
  assert torch.equal(other.data.qpos, sim.data.qpos)


@pytest.mark.parametrize(
  "names", [("crate", "ball", "wedge", "nothing"), ("ball", "crate", "wedge", "hole"), ("ball", "crate", "nothing")]
)
def test_objects_of_other_names_or_in_another_order_are_refused_by_name(make, names: tuple[str, ...]) -> None:
  saved, sim = make(all_of_them())
  variants = {name: OBJECTS.get(name) for name in names}
  scene, other = make(VariantEntityCfg(variants=variants, init_state=START))
  before = scene["thing"].variant.clone()
  message = f"thing: saved with the variants ball, crate, wedge, nothing; here there are {', '.join(names)}"
  with pytest.raises(MjlabError, match=message):
    load(scene, other, save(saved, sim))
  assert torch.equal(scene["thing"].variant, before)


@pytest.mark.parametrize(
  ("name", "other", "message"),
  [
    ("ball", spec_of(BALL.replace('size=".06"', 'size=".05"')), "variant 'ball' was saved with another geom_size than"),
    ("ball", spec_of(BALL.replace('mass=".4"', 'mass=".5"')), "variant 'ball' was saved with another body_mass than"),
    ("ball", spec_of(BALL.replace('friction=".9', 'friction=".8')), "saved with another geom_friction"),
    ("crate", spec_of(CRATE.replace("cylinder", "capsule")), "variant 'crate' was saved with another"),
    (
      "wedge",
      spec_of(WEDGE, asset=ASSET.replace("0 .15 .1", "0 .14 .1")),
      "variant 'wedge' was saved with another mesh",
    ),
    ("nothing", spec_of(BALL), "variant 'nothing' was saved as nothing; here it is an object"),
  ],
)
def test_an_object_that_kept_only_its_name_is_refused_by_name(make, name: str, other: Any, message: str) -> None:
  saved, sim = make(all_of_them())
  changed = VariantEntityCfg(variants={**OBJECTS, name: other}, init_state=START, assignment=NAMES)
  scene, another = make(changed)
  before = another.data.qpos.clone()
  with pytest.raises(MjlabError, match=message):
    load(scene, another, save(saved, sim))
  assert torch.equal(another.data.qpos, before)


def test_shares_are_dealt_in_whole_worlds_and_shuffled() -> None:
  chosen = assign(["a", "b", "c"], {"a": 2.0}, 101, 0, "entity 'x'")
  assert [chosen.count(i) for i in range(3)] == [51, 25, 25]
  assert chosen != sorted(chosen)
  assert chosen == assign(["a", "b", "c"], {"a": 2.0}, 101, 0, "entity 'x'")
  assert assign(["a", "b"], ["b", "a", "b"], 3, 0, "") == [1, 0, 1]
  assert sorted(assign(["a", "b"], None, 5, 3, "")) == [0, 0, 0, 1, 1]


def test_equal_configurations_compare_equal() -> None:
  assert all_of_them() == all_of_them()
  assert all_of_them() != all_of_them(None)


def test_names_of_every_variant_are_addressable(make) -> None:
  scene, _ = make(all_of_them(assignment=None), num_envs=8)
  entity = scene["thing"]
  assert isinstance(entity, VariantEntity)
  assert set(entity.indexing.names["geom"]) == {"ball/shell", "crate/side", "crate/lid", "wedge/hull"}
  assert entity.is_floating
  of_variant = dict(zip(entity.indexing.names["geom"], entity.geom_is_there.T, strict=True))
  for name, is_there in of_variant.items():
    assert torch.equal(is_there, entity.variant == NAMES.index(name.split("/")[0]))
  assert entity.variant.bincount(minlength=4).tolist() == [2, 2, 2, 2]


def test_objects_with_a_fixed_base_can_differ_too(make) -> None:
  fixed = {"ball": spec_of(BALL, ""), "crate": spec_of(CRATE, "")}
  scene, sim = make(VariantEntityCfg(variants=fixed, assignment=("ball", "crate", "ball", "crate")))
  assert not scene["thing"].is_floating
  margin = sim.model.geom_margin
  ball, lid = (sim.mj_model.geom(f"thing/{name}").id for name in ("ball/shell", "crate/lid"))
  assert (margin[:, ball] < 0.0).tolist() == [False, True, False, True]
  assert (margin[:, lid] < 0.0).tolist() == [True, False, True, False]


@pytest.mark.parametrize(
  ("options", "message"),
  [
    ({"assignment": {"bal": 1.0}}, r"entity 'thing': variant 'bal' does not exist\. Nearest: ball"),
    ({"assignment": ("ball", "crate")}, "assignment names 2 variants for 4 worlds"),
    ({"assignment": {"ball": -1.0}}, "shares must be numbers from 0"),
    ({"variants": {"nothing": None}}, "variants need at least one object"),
    ({"variants": {"a": spec_of(BALL), "b": spec_of(BALL, "")}}, "variant 'b' has no free joint, but others have"),
  ],
)
def test_impossible_variants_are_refused_by_name(make, options: dict[str, Any], message: str) -> None:
  settings: dict[str, Any] = {"variants": OBJECTS, **options}
  with pytest.raises(ValueError, match=message):
    make(VariantEntityCfg(**settings))
