"""Mistakes in several parts of a config, which one build reports together."""

from dataclasses import replace
from typing import Any

import mujoco
import pytest
import torch
from envs_hopper import Make, SpeedCommandCfg, hopper, hopper_cfg
from mjlab_core import MjlabError, rows_of_worlds
from mjlab_core.errors import ConfigError
from mjlab_dr import body_mass
from mjlab_envs import mdp
from mjlab_managers import (
  CurriculumTermCfg,
  EventTermCfg,
  MetricsTermCfg,
  ObservationGroupCfg,
  ObservationTermCfg,
  RecorderTermCfg,
  RewardTermCfg,
  SceneEntityCfg,
  TerminationTermCfg,
)
from mjlab_scene import EntityCfg
from mjlab_sensors import BuiltinSensorCfg, ContactMatch, ContactSensorCfg


def unreadable() -> mujoco.MjSpec:
  raise ValueError("no such file")


def not_made(env: Any, mask: torch.Tensor) -> None:
  raise AttributeError("no such quantity")


def test_mistakes_in_twelve_parts_come_in_one_error(make: Make) -> None:
  cfg = hopper_cfg(episode_length_s=-1.0)
  cfg.scene.entities["box"] = EntityCfg(spec_fn=unreadable)
  cfg.scene.sensors["feet"] = ContactSensorCfg(primary=ContactMatch(mode="geom", pattern="foott", entity="robot"))
  cfg.actions["legs"] = mdp.JointPositionActionCfg(actuators=("hipp",))
  cfg.commands["speed"] = SpeedCommandCfg(resampling_time_range=(2.0, 1.0))
  cfg.observations["empty"] = ObservationGroupCfg(terms={"a": None, "b": None})
  cfg.rewards["posture"] = RewardTermCfg(mdp.posture, weight=1.0)
  cfg.terminations["fell"] = TerminationTermCfg(mdp.bad_orientation, params={"limit_angle": 1.0, "limit_angel": 1.0})
  cfg.events["mass"] = EventTermCfg(
    mdp.randomize, mode="startup", params={"randomizer": body_mass("trunc", (0.5, 2.0))}
  )
  cfg.events["late"] = EventTermCfg(not_made, mode="interval", interval_range_s=(3600.0, 3600.0))
  median: Any = "median"
  cfg.metrics["jerk"] = MetricsTermCfg(mdp.mean_action_acc, reduce=median)
  cfg.recorders["rec"] = RecorderTermCfg(print)
  # Consequences of these, which are left out.
  cfg.observations["critic"].terms["box"] = ObservationTermCfg(
    mdp.base_lin_vel, params={"asset": SceneEntityCfg("box")}
  )
  cfg.terminations["touch"] = TerminationTermCfg(mdp.illegal_contact, params={"sensor": "feet"})
  with pytest.raises(ConfigError) as caught:
    make(cfg)
  expected = (
    "env: episode_length_s must not be negative",
    "env: termination 'time_out' is a time-out",
    "entity 'box': its model cannot be made: no such file",
    "ContactSensorCfg 'feet': primary: pattern 'foott' matches no geom",
    "EventManager: term 'mass'",
    "CommandManager: term 'speed': resampling_time_range",
    "ActionManager: term 'legs'",
    "TerminationManager: term 'fell': parameter 'limit_angel' does not exist. Nearest: limit_angle",
    "MetricsManager: term 'jerk': reduce 'median' does not exist",
    "RewardManager: term 'posture': missing parameter std",
    "ObservationManager: group 'empty': has no terms",
    "RecorderManager: term 'rec': func must be a subclass of RecorderTerm",
    "EventManager: term 'late': AttributeError in a trial call (test_envs_problems.py, line",
  )
  for line in expected:
    assert any(line in problem for problem in caught.value.problems), (line, str(caught.value))
  assert len(caught.value.problems) == len(expected), str(caught.value)


def test_where_no_world_can_be_made_configs_of_terms_are_checked_by_themselves(make: Make) -> None:
  cfg = hopper_cfg(decimation=0)
  cfg.rewards["posture"] = RewardTermCfg(mdp.posture, weight=float("nan"))
  cfg.curriculum["c"] = CurriculumTermCfg(not_made, params={"speed": 1.0})
  with pytest.raises(ConfigError) as caught:
    make(cfg)
  owners = [line.split(":")[0] for line in caught.value.problems]
  assert owners == ["env", "RewardManager", "RewardManager", "CurriculumManager"]


def test_a_mistake_in_an_entity_is_reported_without_its_consequences(make: Make) -> None:
  cfg = hopper_cfg()
  cfg.scene.entities["robot"] = replace(hopper(), spec_fn=unreadable)
  cfg.scene.sensors["gyro"] = BuiltinSensorCfg(element="robot/gyro")
  with pytest.raises(ConfigError) as caught:
    make(cfg)
  assert caught.value.problems == ("entity 'robot': its model cannot be made: no such file",)


@pytest.mark.parametrize("part", ["sensors", "entities", "rewards", "observations", "events"])
def test_parts_of_a_scene_and_terms_without_names_are_refused(make: Make, part: str) -> None:
  cfg = hopper_cfg()
  owner, name = (cfg.scene, "scene") if hasattr(cfg.scene, part) else (cfg, "env")
  setattr(owner, part, tuple(getattr(owner, part).values()))
  with pytest.raises(ConfigError, match=f"{name}: {part} must be a mapping"):
    make(cfg)


def test_contacts_without_a_history_are_named_at_build(make: Make) -> None:
  cfg = hopper_cfg()
  cfg.scene.sensors["feet"] = ContactSensorCfg(primary=ContactMatch(mode="geom", pattern="foot", entity="robot"))
  cfg.terminations["ended"] = TerminationTermCfg(mdp.illegal_contact, params={"sensor": "feet"})
  cfg.metrics["count"] = MetricsTermCfg(mdp.contact_count, params={"sensor": "feet"})
  with pytest.raises(ConfigError) as caught:
    make(cfg)
  without = "contact sensor 'feet' has no history; set history_length=1 or more in its config, or threshold=None"
  assert [problem.count(without) for problem in caught.value.problems] == [1, 1]
  assert all(f"term '{name}'" in str(caught.value) for name in ("ended", "count"))


def place(env: Any, env_ids: torch.Tensor) -> None:
  """Write one row for each of `env_ids`, as terms of other projects do."""
  entity = env.scene["robot"]
  state = entity.data.default_root_state.repeat(len(env_ids), 1)
  state[:, 0] += env_ids
  state[:, 7] = 0.5
  entity.write_root_state(*rows_of_worlds(state, env_ids, env.num_envs))
  entity.write_joint_position(*rows_of_worlds(torch.full((len(env_ids), 2), 0.1), env_ids, env.num_envs))


def test_an_event_with_ids_writes_one_row_for_each(make: Make, engine: str) -> None:
  env = make(engine=engine, events={"place": EventTermCfg(place, mode="reset")})
  before = env.sim.data.qpos.clone()
  env.reset(env_ids=[1, 3])
  after = env.sim.data.qpos
  assert torch.equal(after[[0, 2]], before[[0, 2]])
  assert after[[1, 3], 0].tolist() == [1.0, 3.0]
  assert after[[1, 3], 7:].flatten().tolist() == pytest.approx([0.1] * 4)


def test_rows_of_some_worlds_for_all_are_refused_with_the_way_out(make: Make) -> None:
  entity = make().scene["robot"]
  with pytest.raises(MjlabError, match=r"\(2, 13\) does not fit.*rows_of_worlds\(values, env_ids, num_envs\)"):
    entity.write_root_state(torch.zeros(2, 13))
