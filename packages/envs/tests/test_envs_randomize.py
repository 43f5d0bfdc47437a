"""Randomisation as events: when it fires, in which worlds, how a curriculum widens it, and its observation."""

from collections.abc import Callable
from typing import Any

import mujoco
import pytest
import torch
from envs_hopper import Make, actions, end, hopper_cfg
from mjlab_core.errors import ConfigError
from mjlab_dr import Categorical, body_mass, encoder_bias, geom_friction, pseudo_inertia, randomize_field
from mjlab_envs import ManagerBasedRlEnv, mdp
from mjlab_managers import CurriculumTermCfg, EventTermCfg, ObservationGroupCfg, ObservationTermCfg, SceneEntityCfg
from mjlab_scene import EntityCfg, InitialStateCfg, VariantEntityCfg


def event(mode: Any, randomizer: Any = None, **options: Any) -> EventTermCfg:
  params = {"randomizer": randomizer or geom_friction("foot", (0.3, 1.2))}
  return EventTermCfg(mdp.randomize, mode=mode, params=params, **options)


def quiet(**options: Any) -> Any:
  """The hopper, whose episodes end when a test ends them."""
  cfg = hopper_cfg(**options)
  cfg.terminations = {"ended": cfg.terminations["ended"]}
  return cfg


def friction(env: ManagerBasedRlEnv, geom: str = "foot") -> torch.Tensor:
  return env.sim.model.geom_friction[:, env.sim.mj_model.geom(f"robot/{geom}").id, 0].clone()


def history(
  env: ManagerBasedRlEnv,
  steps: int,
  ended: dict[int, tuple[int, ...]],
  look: Callable[[ManagerBasedRlEnv], torch.Tensor] = friction,
) -> torch.Tensor:
  """Return what `look` sees before the first and after each step; `ended` says whose episodes end in which step."""
  rows = [look(env)]
  for step in range(steps):
    end(env, *ended.get(step, ()))
    env.step(actions(env, step))
    rows.append(look(env))
  return torch.stack(rows)


def test_each_mode_draws_in_its_worlds_at_its_times(make: Make) -> None:
  every: dict[str, Any] = {"mode": "interval", "interval_range_s": (0.02, 0.05)}
  events = {
    "startup": event("startup", geom_friction("trunk", (0.3, 1.2))),
    "reset": event("reset", body_mass("thigh", (0.3, 1.2)), min_step_count_between_reset=4),
    "own": event(randomizer=body_mass("shank", (0.3, 1.2)), **every),
    "shared": event(**every, is_global_time=True),
    "step": event("step", body_mass("trunk", (0.3, 1.2))),
  }

  def look(env: ManagerBasedRlEnv) -> torch.Tensor:
    masses = [
      env.sim.model.body_mass[:, env.sim.mj_model.body(f"robot/{name}").id] for name in ("thigh", "shank", "trunk")
    ]
    return torch.stack([friction(env, "trunk"), friction(env), *masses])

  rows = history(make(quiet(events=events)), 30, {1: (0,), 4: (0, 2), 8: (0,)}, look)
  startup, shared, reset, own, step = (rows[1:] != rows[:-1]).unbind(1)
  assert rows[0, 0].unique().numel() == 4
  assert not startup.any()
  # World 0 ends in steps 1, 4 and 8: too early, allowed, allowed again.
  assert reset[:, 0].nonzero().flatten().tolist() == [4, 8]
  assert reset[:, 2].nonzero().flatten().tolist() == [4]
  assert not reset[:, [1, 3]].any()
  assert (own.any(1) & ~own.all(1)).any()
  assert own.sum(0).min() >= 3
  assert (shared.any(1) == shared.all(1)).all()
  assert shared.any(1).sum() >= 3
  assert step.all()


def test_inertia_drawn_at_resets_leaves_the_worlds_that_go_on_bit_identical(make: Make, engine: str) -> None:
  inertia = EventTermCfg(mdp.randomize, mode="reset", params={"randomizer": pseudo_inertia("thigh", scale=0.3)})
  states = []
  for ended in ({}, {3: (1,), 5: (1, 3)}):
    env = make(quiet(engine=engine, events={"inertia": inertia}))
    history(env, 8, ended)
    states.append((env.sim.data.qpos.clone(), env.sim.model.body_inertia.clone(), env.sim.model.dof_invweight0.clone()))
  for calm, busy in zip(*states, strict=True):
    assert torch.equal(calm[[0, 2]], busy[[0, 2]])
    assert not torch.equal(calm[[1, 3]], busy[[1, 3]])


def test_the_ground_and_its_looks_can_be_randomised_though_they_are_no_entity(make: Make) -> None:
  def textured(spec: mujoco.MjSpec) -> None:
    for name in ("wood", "steel"):
      spec.add_texture(
        name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT, width=8, height=8
      )

  cfg = quiet()
  cfg.scene.spec_fn = textured
  randomizers = {
    "slide": geom_friction(".*", (0.3, 1.2)),
    "texture": randomize_field("mat_texid", "terrain", {"rgb": Categorical(("wood", "steel"))}),
    "light": randomize_field("light_diffuse", "terrain", (0.2, 0.9), isotropic=True),
  }
  params = {name: {"randomizer": value, "asset": None} for name, value in randomizers.items()}
  cfg.events = {name: EventTermCfg(mdp.randomize, mode="reset", params=params[name]) for name in randomizers}
  env = make(cfg)
  model, compiled = env.sim.model, env.sim.mj_model
  ground = compiled.geom("terrain").id
  before = model.geom_friction[:, ground, 0].clone()
  assert before.unique().numel() == 4
  # Elements of the robot stay as they are.
  assert (model.geom_friction[:, compiled.geom("robot/foot").id, 0] == compiled.geom("robot/foot").friction[0]).all()
  textures = model.mat_texid[:, compiled.material("terrain").id, 1].tolist()
  assert set(textures) <= {compiled.texture("wood").id, compiled.texture("steel").id}
  assert model.light_diffuse[:, compiled.light("terrain").id, 0].unique().numel() == 4
  env.reset(env_ids=[2])
  assert (model.geom_friction[:, ground, 0] != before).tolist() == [False, False, True, False]
  bias = {"randomizer": encoder_bias(".*", (-0.1, 0.1)), "asset": None}
  with pytest.raises(ConfigError, match="belongs to an entity, which asset=None is not"):
    make(quiet(events={"bias": EventTermCfg(mdp.randomize, mode="startup", params=bias)}))


def test_a_curriculum_widens_a_range_while_training_runs(make: Make) -> None:
  scaled = geom_friction("foot", (0.5, 1.5), operation="scale")
  events = {"friction": EventTermCfg(mdp.randomize, mode="step", params={"randomizer": scaled})}
  widen = CurriculumTermCfg(mdp.widen_randomization, params={"event": "friction", "steps": (4, 24)})
  env = make(quiet(events=events, curriculum={"friction": widen}))
  default = env.sim.default_field("geom_friction")[0, env.sim.mj_model.geom("robot/foot").id, 0]
  assert torch.equal(friction(env), default.expand(4))
  spread = (history(env, 40, {})[1:] / default - 1.0).abs().max(1).values
  assert not spread[:4].any()
  for step in range(4, 40):
    assert spread[step] <= 0.5 * min(1.0, (step + 1 - 4) / 20) + 1e-9
  assert spread[24:].max() > 0.4
  names, values = env.curriculum_manager.log_tensors()
  assert dict(zip(names, values.tolist(), strict=True)) == {"Curriculum/friction": 1.0}


def test_a_critic_may_see_what_was_drawn(make: Make) -> None:
  seen: dict[str, ObservationTermCfg | None] = {
    "friction": ObservationTermCfg(mdp.randomized_values, params={"event": "friction"})
  }
  env = make(quiet(events={"friction": event("reset")}, observations={"critic": ObservationGroupCfg(terms=seen)}))
  obs, _ = env.reset()
  default = env.sim.default_field("geom_friction")[0, env.sim.mj_model.geom("robot/foot").id, 0]
  critic = obs["critic"]
  assert isinstance(critic, torch.Tensor)
  torch.testing.assert_close(critic[:, 0], (friction(env) - default).float())


def test_objects_that_differ_between_worlds_are_stepped_reset_and_randomised_from_their_own_masses(make: Make) -> None:
  def cube() -> mujoco.MjSpec:
    return mujoco.MjSpec.from_string(THING.format('type="box" size=".05 .05 .05" mass="2"'))

  def ball() -> mujoco.MjSpec:
    return mujoco.MjSpec.from_string(THING.format('size=".05" mass="1"'))

  cfg = quiet()
  variants = {"cube": cube, "ball": ball, "none": None}
  start = InitialStateCfg(pos=(1.0, 0.0, 0.2))
  chosen = ("cube", "ball", "none", "ball")
  cfg.scene.entities["thing"] = VariantEntityCfg(variants=variants, assignment=chosen, init_state=start)
  heavier = body_mass("object", (1.0, 1.5), operation="scale")
  params = {"randomizer": heavier, "asset": SceneEntityCfg("thing")}
  cfg.events = {
    "default": EventTermCfg(mdp.reset_scene_to_default, mode="reset"),
    "mass": EventTermCfg(mdp.randomize, mode="reset", params=params),
  }
  env = make(cfg)
  body = env.sim.mj_model.body("thing/object").id
  for _ in range(3):
    env.reset()
    ratio = env.sim.model.body_mass[:, body] / torch.tensor([2.0, 1.0, 2.0, 1.0])
    assert ((ratio >= 1.0) & (ratio <= 1.5)).all()
    assert ratio.unique().numel() == 4
  for step in range(60):
    env.step(actions(env, step))
  height = env.scene["thing"].data.root_link_pos_w[:, 2]
  torch.testing.assert_close(height[[0, 1, 3]], torch.full((3,), 0.05, dtype=height.dtype), rtol=0.0, atol=5e-3)
  torch.testing.assert_close(height[2], torch.tensor(0.2, dtype=height.dtype))


def test_a_free_object_can_be_given_another_centre_of_mass(make: Make) -> None:
  """Its compiler would otherwise count on one at the origin of its frame."""
  cfg = quiet()
  box = THING.format('type="box" size=".05 .05 .05" mass="2"')
  start = InitialStateCfg(pos=(1.0, 0.0, 2.0))
  cfg.scene.entities["thing"] = EntityCfg(spec_fn=lambda: mujoco.MjSpec.from_string(box), init_state=start)
  randomizer = pseudo_inertia("thing", alpha=(-0.2, 0.2), t=(0.01, 0.02))
  cfg.events["inertia"] = EventTermCfg(
    mdp.randomize, mode="reset", params={"randomizer": randomizer, "asset": SceneEntityCfg("thing")}
  )
  env = make(cfg)
  body = env.sim.mj_model.body("thing/thing")
  com, joint = env.sim.model.body_ipos[:, body.id], int(body.dofadr[0])
  assert ((com >= 0.01) & (com <= 0.02)).all()
  env.scene["thing"].write_default_state()
  env.sim.data.qvel[:] = 0.0
  env.sim.data.qvel[:, joint + 3 : joint + 6] = torch.tensor([0.0, 0.0, 100.0])
  env.sim.step()
  # Where it spins about its centre of mass, the origin of its frame is pulled inwards.
  pull = env.sim.data.qacc[:, joint : joint + 2]
  torch.testing.assert_close(pull, 1e4 * com[:, :2], rtol=1e-3, atol=0.0)


THING = '<mujoco><worldbody><body name="thing"><freejoint/><geom name="hull" {}/></body></worldbody></mujoco>'


@pytest.mark.parametrize(
  ("params", "message"),
  [
    ({"event": "frction", "steps": (0, 10)}, "Nearest: friction"),
    ({"event": "push", "steps": (0, 10)}, "event 'push' is not randomize"),
    ({"event": "friction", "steps": (10, 10)}, r"must rise, got \(10, 10\)"),
    ({"event": "light", "steps": (0, 10)}, "a choice, which cannot be widened"),
    ({"event": "once", "steps": (0, 10)}, "event 'once' fires once, at startup, before its strength grows"),
  ],
)
def test_a_curriculum_of_nothing_is_refused_at_build(make: Make, params: dict[str, Any], message: str) -> None:
  cfg = quiet()
  cfg.scene.entities["robot"].spec_fn = with_light(cfg.scene.entities["robot"].spec_fn)
  light = randomize_field("light_active", "lamp", Categorical((0, 1)))
  cfg.events |= {
    "friction": event("reset"),
    "once": EventTermCfg(mdp.randomize, mode="startup", params={"randomizer": body_mass("trunk", (1.0, 2.0))}),
    "light": EventTermCfg(mdp.randomize, mode="startup", params={"randomizer": light}),
  }
  cfg.curriculum = {"wider": CurriculumTermCfg(mdp.widen_randomization, params=params)}
  with pytest.raises(ConfigError, match=message):
    make(cfg)


def with_light(spec_fn: Callable[[], Any]) -> Callable[[], Any]:
  def build() -> Any:
    spec = spec_fn()
    spec.body("trunk").add_light(name="lamp")
    return spec

  return build
