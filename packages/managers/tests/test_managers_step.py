"""All managers in one environment step: it waits for nothing, can be recorded, and no world sees another."""

from dataclasses import dataclass
from typing import Any

import pytest
import torch
from mjlab_core.indexing import where_
from mjlab_managers import (
  ActionManager,
  ActionTerm,
  ActionTermCfg,
  CommandManager,
  CommandTerm,
  CommandTermCfg,
  CurriculumManager,
  CurriculumTermCfg,
  EventManager,
  EventTermCfg,
  GaussianNoiseCfg,
  ManagerTermBase,
  MetricsManager,
  MetricsTermCfg,
  NoiseModelWithAdditiveBiasCfg,
  ObservationGroupCfg,
  ObservationManager,
  ObservationTermCfg,
  RecorderManager,
  RewardManager,
  RewardTermCfg,
  SceneEntityCfg,
  TerminationManager,
  TerminationTermCfg,
  UniformNoiseCfg,
)


@dataclass(kw_only=True)
class VelocityCfg(ActionTermCfg):
  def build(self, env: Any) -> ActionTerm:
    return Velocity(self, env)


class Velocity(ActionTerm):
  @property
  def action_dim(self) -> int:
    return 5

  def process_actions(self, actions: torch.Tensor) -> None: ...

  def apply_actions(self) -> None:
    self.env.values.add_(self.raw_action, alpha=self.env.physics_dt)


@dataclass(kw_only=True)
class GoalCfg(CommandTermCfg):
  def build(self, env: Any) -> CommandTerm:
    return Goal(self, env)


class Goal(CommandTerm):
  def __init__(self, cfg: GoalCfg, env: Any) -> None:
    super().__init__(cfg, env)
    self.goal = self.state((5,))
    self.metrics["distance"] = torch.zeros(self.num_envs, device=self.device)

  @property
  def command(self) -> torch.Tensor:
    return self.goal

  def resample(self, mask: torch.Tensor) -> None:
    where_(self.goal, mask, torch.rand(self.num_envs, 5, generator=self.env.rng, device=self.device))

  def update_metrics(self) -> None:
    self.metrics["distance"] += distance(self.env)


class Longest(ManagerTermBase):
  """Largest distance in the episode, (N,)."""

  def __init__(self, env: Any) -> None:
    super().__init__(env)
    self.longest = self.state()

  def __call__(self) -> torch.Tensor:
    return torch.maximum(self.longest, distance(self.env), out=self.longest)


HIPS = SceneEntityCfg("robot", joint_names=".*_hip")


def distance(env: Any) -> torch.Tensor:
  return (env.values - env.command_manager.get_command("goal")).norm(dim=1)


def hip_distance(env: Any, *, asset: SceneEntityCfg = HIPS) -> torch.Tensor:
  return (env.values - env.command_manager.get_command("goal"))[:, asset.joint_ids].norm(dim=1)


def values(env: Any) -> torch.Tensor:
  return env.values


def goal(env: Any, *, command: str) -> torch.Tensor:
  return env.command_manager.get_command(command)


def spawn(env: Any, mask: torch.Tensor) -> None:
  where_(env.values, mask, torch.rand(env.num_envs, 5, generator=env.rng, device=env.device))


def push(env: Any, mask: torch.Tensor, *, size: float) -> None:
  env.values.add_(mask[:, None], alpha=size)


spawn.model_fields, spawn.needs_constants = ("body_mass",), True  # type: ignore


class Step:
  """Builds the managers over an environment in the order that an environment has to, and steps them."""

  def __init__(self, env: Any) -> None:
    self.env = env
    env.recompute_constants = lambda mask: None
    interval: dict[str, Any] = {"mode": "interval", "interval_range_s": (0.05, 0.2)}
    self.events = EventManager(
      {
        "spawn": EventTermCfg(spawn, mode="reset"),
        "rare": EventTermCfg(spawn, mode="reset", min_step_count_between_reset=9),
        "push": EventTermCfg(push, params={"size": 0.3}, **interval),
        "gust": EventTermCfg(push, params={"size": 0.1}, is_global_time=True, **interval),
      },
      env,
    )
    self.commands = env.command_manager = CommandManager({"goal": GoalCfg(resampling_time_range=(0.1, 0.3))}, env)
    self.actions = ActionManager({"velocity": VelocityCfg(entity="robot")}, env)
    bias = NoiseModelWithAdditiveBiasCfg(bias_noise_cfg=GaussianNoiseCfg(std=0.1), noise_cfg=UniformNoiseCfg())
    delay: dict[str, Any] = {"delay_min_lag": 1, "delay_max_lag": 3, "delay_hold_prob": 0.5}
    self.observations = ObservationManager(
      {
        "actor": ObservationGroupCfg(
          corrupt=True,
          terms={
            "values": ObservationTermCfg(values, noise=bias, clip=(-5.0, 5.0), scale=0.5, history_length=3, **delay),
            "goal": ObservationTermCfg(goal, params={"command": "goal"}),
          },
        ),
        "critic": ObservationGroupCfg(terms={"values": ObservationTermCfg(values, scale=0.5)}),
      },
      env,
    )
    self.terminations = TerminationManager(
      {
        "far": TerminationTermCfg(lambda env: distance(env) > 1.5),
        "time_out": TerminationTermCfg(lambda env: env.episode_length_buf >= 20, time_out=True),
      },
      env,
    )
    self.rewards = env.reward_manager = RewardManager(
      {"near": RewardTermCfg(hip_distance, weight=-1.0), "longest": RewardTermCfg(Longest, weight=-0.1)}, env
    )
    weight = self.rewards.weight("near")
    self.curricula = CurriculumManager(
      {"near": CurriculumTermCfg(lambda env, mask: weight.copy_(env.common_step_counter * -0.1))}, env
    )
    self.metrics = MetricsManager(
      {"far": MetricsTermCfg(distance, reduce="max"), "sub": MetricsTermCfg(distance, per_substep=True)}, env
    )
    self.recorders = RecorderManager({}, env)
    self.action = torch.zeros(env.num_envs, 5, device=env.device)
    self.others = torch.zeros(env.num_envs, dtype=torch.bool, device=env.device)
    self.managers = {name: manager for name, manager in vars(self).items() if name not in ("env", "action", "others")}
    self.events.apply("startup")

  def __call__(self) -> None:
    env = self.env
    self.actions.process_action(self.action)
    for _ in range(4):
      self.actions.apply_action()
      self.metrics.compute_substep()
    env.episode_length_buf.add_(1)
    env.common_step_counter.add_(1)
    # `others` stands for worlds that end for reasons of their own.
    ended = self.terminations.compute() | self.others
    self.rewards.compute()
    self.metrics.compute()
    self.recorders.pre_reset(ended)
    self.curricula.compute(ended)
    self.events.apply("reset", ended)
    for manager in self.managers.values():
      manager.reset(ended)
    env.episode_length_buf.masked_fill_(ended, 0)
    self.commands.compute(env.step_dt, ended)
    self.events.apply("step")
    self.events.apply("interval", ~ended)
    self.observations.compute(ended)
    self.recorders.post_step()

  def outcome(self) -> dict[str, torch.Tensor]:
    """What leaves the step, by name, world first."""
    return {
      "reward": self.rewards.reward.clone(),
      "dones": self.terminations.dones.clone(),
      "values": self.env.values.clone(),
      **{name: value.clone() for name, value in self.observations.get().items()},  # type: ignore
    }

  def snapshot(self) -> dict[str, Any]:
    tensors = {name: value.clone() for name, value in vars(self.env).items() if isinstance(value, torch.Tensor)}
    return {"env": tensors, "managers": {name: manager.state_dict() for name, manager in self.managers.items()}}

  def restore(self, snapshot: dict[str, Any]) -> None:
    for name, value in snapshot["env"].items():
      getattr(self.env, name).copy_(value)
    for name, manager in self.managers.items():
      manager.load_state_dict(snapshot["managers"][name])
      manager.clear_log()


def test_a_whole_step_asks_the_device_nothing(env, dispatched):
  step = Step(env)
  # Managers, terms (a quarter of it) and the bookkeeping of the step itself.
  assert len(dispatched(step)) <= 210


def test_nothing_a_world_is_given_depends_on_the_others(make_env):
  def rollout(others: list[int]) -> list[dict[str, torch.Tensor]]:
    env = make_env(seed=2)
    step = Step(env)
    outcomes = []
    for i in range(60):
      step.action.copy_(torch.rand(5, generator=torch.Generator().manual_seed(i)) * 3)
      step.others.copy_(env.mask(*(others if i % 5 == 2 else [])))
      step()
      outcomes.append({name: value[0] for name, value in step.outcome().items()})
    assert any(outcome["dones"] for outcome in outcomes)
    return outcomes

  for alone, accompanied in zip(rollout([]), rollout([1, 2]), strict=True):
    for name, value in alone.items():
      assert torch.equal(value, accompanied[name]), name


def test_a_restored_run_goes_on_as_the_first_would_have(make_env):
  first = Step(make_env(seed=2))
  for _ in range(15):
    first()
  snapshot, rng = first.snapshot(), first.env.rng.get_state()
  second = Step(make_env(seed=7))
  second.restore(snapshot)
  second.env.rng.set_state(rng)
  for _ in range(15):
    first()
    second()
  for name, value in first.outcome().items():
    assert torch.equal(value, second.outcome()[name]), name


@pytest.mark.filterwarnings("ignore:Synchronization debug mode")
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_recorded_step_is_bit_equal_to_an_eager_one_and_neither_waits_on_a_gpu(make_env):
  def rollout(recorded: bool) -> tuple[list[dict[str, torch.Tensor]], list[torch.Tensor]]:
    env = make_env(64, seed=2, device="cuda")
    step = Step(env)
    snapshot = step.snapshot()
    graph = torch.cuda.CUDAGraph()
    stream = torch.cuda.Stream()
    with torch.cuda.stream(stream):
      step()
    torch.cuda.synchronize()
    if recorded:
      graph.register_generator_state(env.rng)
      with torch.cuda.graph(graph, stream=stream):
        step()
    step.restore(snapshot)
    env.rng.manual_seed(11)
    actions = torch.rand(60, 64, 5, generator=torch.Generator().manual_seed(0)).cuda()
    torch.cuda.set_sync_debug_mode("error")
    outcomes = []
    try:
      for action in actions:
        step.action.copy_(action)
        if recorded:
          graph.replay()
        else:
          step()
        outcomes.append(step.outcome())
    finally:
      torch.cuda.set_sync_debug_mode("default")
    return outcomes, [manager.log_tensors()[1] for manager in step.managers.values()]

  (eager, eager_logs), (replayed, replayed_logs) = rollout(False), rollout(True)
  assert any(bool(outcome["dones"].any()) for outcome in eager)
  for a, b in zip(eager, replayed, strict=True):
    for name, value in a.items():
      assert torch.equal(value, b[name]), name
  for a, b in zip(eager_logs, replayed_logs, strict=True):
    torch.testing.assert_close(a, b, equal_nan=True)
