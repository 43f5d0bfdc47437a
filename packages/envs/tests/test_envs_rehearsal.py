"""The class of mistakes that showed in the middle of a run: terms that no manager called at build."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from envs_hopper import Make, SpeedCommand, SpeedCommandCfg, actions, hopper_cfg
from mjlab_core import DebugDraw
from mjlab_core.errors import ConfigError, MjlabError
from mjlab_dr import body_mass
from mjlab_envs import ManagerBasedRlEnv, mdp
from mjlab_managers import (
  ActionTerm,
  ActionTermCfg,
  CurriculumTermCfg,
  EventTermCfg,
  ManagerTermBase,
  RecorderTerm,
  RecorderTermCfg,
)
from mjlab_sensors import BuiltinSensorCfg
from mjlab_sensors.native.builtin import BuiltinSensor

FAILS_FROM = {"step": 0}
"""Steps after which the terms below fail; a test that wants them to fail later sets it."""


def trip(env: Any) -> None:
  if int(env.common_step_counter) >= FAILS_FROM["step"]:
    raise AttributeError("no such quantity")


@pytest.fixture(autouse=True)
def fail_at_once() -> None:
  FAILS_FROM["step"] = 0


def broken_event(env: Any, mask: torch.Tensor) -> None:
  trip(env)


def broken_event_of_ids(env: Any, env_ids: torch.Tensor) -> None:
  trip(env)


def broken(base: type[Any], hook: str) -> type[Any]:
  """Return a subclass whose method `hook` fails."""

  def call(self: Any, *args: Any) -> Any:
    trip(self.env)
    return getattr(base, hook)(self, *args)

  return type(f"Broken{base.__name__}", (base,), {hook: call})


@dataclass(kw_only=True)
class BrokenCommandCfg(SpeedCommandCfg):
  hook: str

  def build(self, env: Any) -> SpeedCommand:
    return broken(SpeedCommand, self.hook)(self, env)


@dataclass(kw_only=True)
class BrokenActionCfg(ActionTermCfg):
  entity: str = "robot"
  hook: str

  def build(self, env: Any) -> ActionTerm:
    return broken(Idle, self.hook)(self, env)


class Idle(ActionTerm):
  @property
  def action_dim(self) -> int:
    return 1

  def process_actions(self, actions: torch.Tensor) -> None:
    pass


@dataclass(kw_only=True)
class BrokenDrawingCfg(BuiltinSensorCfg):
  pass


class BrokenDrawing(BuiltinSensor, cfg=BrokenDrawingCfg):
  def debug_draw(self, draw: DebugDraw) -> None:
    wrong: Any = {"colour": (1.0, 0.0, 0.0, 1.0)}
    draw.spheres(torch.zeros(1, 3), radius=0.1, **wrong)


def with_event(mode: Any, func: Any = broken_event, **options: Any) -> Any:
  cfg = hopper_cfg()
  cfg.events["broken"] = EventTermCfg(func, mode=mode, **options)
  return cfg


def with_command(hook: str) -> Any:
  return hopper_cfg(commands={"speed": BrokenCommandCfg(resampling_time_range=(0.01, 0.01), hook=hook)})


def with_action(hook: str) -> Any:
  return hopper_cfg(actions={"broken": BrokenActionCfg(hook=hook)})


def with_recorder(hook: str) -> Any:
  return hopper_cfg(recorders={"broken": RecorderTermCfg(broken(RecorderTerm, hook))})


AT = r"AttributeError in .*\(test_envs_rehearsal\.py, line \d+\): no such quantity"
BROKEN: dict[str, tuple[str, Callable[[], Any]]] = {
  "startup": ("EventManager: term 'broken'", partial(with_event, "startup")),
  "reset": ("EventManager: term 'broken'", partial(with_event, "reset")),
  "step": ("EventManager: term 'broken'", partial(with_event, "step")),
  "reset by ids": ("EventManager: term 'broken'", partial(with_event, "reset", broken_event_of_ids)),
  "curriculum by ids": (
    "CurriculumManager: term 'broken'",
    partial(hopper_cfg, curriculum={"broken": CurriculumTermCfg(broken_event_of_ids)}),
  ),
}
for manager, name, build, hooks in (
  ("CommandManager", "speed", with_command, ("resample", "update", "update_metrics", "reset", "log_values")),
  ("ActionManager", "broken", with_action, ("process_actions", "apply_actions", "reset")),
  ("RecorderManager", "broken", with_recorder, ("pre_reset", "post_reset", "post_step")),
):
  BROKEN |= {f"{manager}.{hook}": (f"{manager}: term '{name}'", partial(build, hook)) for hook in hooks}
AT_BUILD = BROKEN | {
  # Its first firing would be after an hour.
  "interval": ("EventManager: term 'broken'", partial(with_event, "interval", interval_range_s=(3600.0, 3600.0))),
  "drawing of a command": ("command speed", partial(with_command, "debug_draw")),
}


@pytest.mark.parametrize("kind", AT_BUILD)
def test_a_term_that_fails_is_named_at_build(make: Make, kind: str) -> None:
  name, build = AT_BUILD[kind]
  with pytest.raises(ConfigError, match=f"{name}: {AT}"):
    make(build())


def test_a_drawing_of_a_sensor_that_fails_is_named_at_build(make: Make) -> None:
  cfg = hopper_cfg()
  cfg.scene.sensors["robot/gyro"] = BrokenDrawingCfg(element="robot/gyro")
  with pytest.raises(ConfigError, match=r"sensor robot/gyro: TypeError in debug_draw \(test_.*unexpected.*'colour'"):
    make(cfg)


def test_terms_of_several_managers_that_fail_are_named_together(make: Make) -> None:
  cfg = with_event("step")
  cfg.recorders, cfg.commands = with_recorder("post_step").recorders, with_command("update").commands
  with pytest.raises(ConfigError) as caught:
    make(cfg)
  assert [line.split(":")[0] for line in caught.value.problems] == ["EventManager", "CommandManager", "RecorderManager"]


@pytest.mark.parametrize("kind", BROKEN)
def test_a_term_that_fails_later_is_named_with_its_manager(make: Make, kind: str) -> None:
  FAILS_FROM["step"] = 2
  name, build = BROKEN[kind]
  env = make(build())
  env.step(torch.zeros(4, env.action_manager.total_action_dim))
  if kind == "startup":
    return

  def go_on() -> None:
    for _ in range(3):
      env.step(torch.zeros(4, env.action_manager.total_action_dim))
      env.reset(env_ids=[1])
      env.drain_log()

  with pytest.raises(MjlabError, match=f"{name}: AttributeError: no such quantity"):
    go_on()


# Nothing of a rehearsal remains.


def disturb(env: Any, mask: torch.Tensor, *, size: float) -> None:
  """Writes everything that an event can reach: state, targets, shared and own model fields, what the managers keep."""
  del mask
  env.sim.data.qpos.add_(torch.rand(env.sim.data.qpos.shape, generator=env.rng) * size)
  env.sim.data.qvel.add_(size)
  env.sim.expand_model_fields(["geom_friction"])
  env.sim.model.geom_friction.mul_(1.0 + size)
  env.sim.model.dof_damping.add_(size)
  env.sim.recompute_constants()
  env.scene["robot"].data.encoder_bias.add_(size)
  env.scene["robot"].data.joint_pos_target.add_(size)
  env.scene.env_origins.add_(size)
  env.episode_length_buf.add_(1)
  env.common_step_counter.add_(1)
  if hasattr(env, "observation_manager"):
    env.observation_manager.buffers["actor"].add_(size)
    env.command_manager.get_command("speed").add_(size)
    env.reward_manager.get_term_cfg("alive").weight += size
    env.reward_manager.weight("speed").add_(size)
    env.observation_manager.get_term_cfg("actor", "gravity").scale = 1.0 + size
    env.termination_manager.set_params("fell", limit_angle=size)
    env.event_manager.set_params("push", velocity_range={"x": (size, size)})


class Writer(RecorderTerm):
  """Recorder that keeps a list and a file."""

  def __init__(self, env: Any, *, path: str) -> None:
    super().__init__(env)
    self.rows: list[torch.Tensor] = []
    self.total = self.state()
    self.path = Path(path)

  def post_step(self) -> None:
    self.rows.append(self.env.reward_manager.reward.clone())
    self.total.add_(1.0)
    if not self.is_trial:
      self.path.write_text(f"{len(self.rows)}")


def leaves(state: Any, where: str = "") -> dict[str, Any]:
  if isinstance(state, dict):
    return {name: leaf for key, value in state.items() for name, leaf in leaves(value, f"{where}.{key}").items()}
  return {where: state}


class Ratchet(ManagerTermBase):
  """Curriculum that changes a parameter by a factor at each call."""

  def __call__(self, mask: torch.Tensor) -> torch.Tensor:
    cfg = self.env.termination_manager.get_term_cfg("fell")
    self.env.termination_manager.set_params("fell", limit_angle=float(cfg.params["limit_angle"]) * 1.5)
    return mask.sum()


def test_a_build_leaves_what_it_tried_as_it_was(
  make: Make, engine: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
  def build(name: str) -> Any:
    cfg = hopper_cfg(engine=engine)
    mass = {"randomizer": body_mass("trunk", (0.5, 2.0))}
    cfg.events["mass"] = EventTermCfg(mdp.randomize, mode="startup", params=mass)
    cfg.events["disturb"] = EventTermCfg(
      disturb, mode="interval", interval_range_s=(3600.0, 3600.0), params={"size": 0.25}
    )
    cfg.curriculum["ratchet"] = CurriculumTermCfg(Ratchet)
    cfg.recorders["writer"] = RecorderTermCfg(Writer, params={"path": str(tmp_path / name)})
    return make(cfg, begun=False)

  tried = build("tried")
  assert not (tmp_path / "tried").exists()
  assert tried.recorder_manager.get_term("writer").rows == []
  assert tried.reward_manager.get_term_cfg("alive").weight == 0.5
  assert tried.observation_manager.get_term_cfg("actor", "gravity").scale is None
  assert float(tried.termination_manager.get_term_cfg("fell").params["limit_angle"]) == 1.0
  assert set(tried.event_manager.get_term_cfg("push").params["velocity_range"]) == {"x", "yaw"}
  monkeypatch.setattr(ManagerBasedRlEnv, "_rehearse", lambda self, problems: None)
  plain = build("plain")
  # What the trial made per-world stays so, with the values that all worlds shared.
  plain.sim.expand_model_fields(["geom_friction"])
  for step in range(12):
    before, after = leaves(plain.state_dict()), leaves(tried.state_dict())
    assert before.keys() == after.keys()
    for name, value in before.items():
      assert torch.equal(value, after[name]), (step, name)
    for a, b in zip(plain.step(actions(plain, step))[1:4], tried.step(actions(tried, step))[1:4], strict=True):
      assert torch.equal(a, b)
  assert (tmp_path / "tried").read_text() == "12"
