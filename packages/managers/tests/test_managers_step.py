"""All managers in one environment step: it waits for nothing, can be recorded, and no world sees another."""

from typing import Any

import pytest
import torch
from managers_terms import ActCfg, GoalCfg
from mjlab_core.indexing import where_
from mjlab_managers import (
  ActionManager,
  ActionTerm,
  CameraNoiseCfg,
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


class Velocity(ActionTerm):
  @property
  def action_dim(self) -> int:
    return 5

  def process_actions(self, actions: torch.Tensor) -> None: ...

  def apply_actions(self) -> None:
    self.env.values.add_(self.raw_action, alpha=self.env.physics_dt)


class Goal(CommandTerm):
  def __init__(self, cfg: CommandTermCfg, env: Any) -> None:
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


class Steps(ManagerTermBase):
  """Calls since the reset, (N, 1)."""

  def __init__(self, env: Any) -> None:
    super().__init__(env)
    self.calls = self.state((1,))

  def __call__(self) -> torch.Tensor:
    return self.calls.add_(1.0).clone()


HIPS = SceneEntityCfg("robot", joint_names=".*_hip")


def distance(env: Any) -> torch.Tensor:
  return (env.values - env.command_manager.get_command("goal")).norm(dim=1)


def hip_distance(env: Any, *, asset: SceneEntityCfg = HIPS) -> torch.Tensor:
  return (env.values - env.command_manager.get_command("goal"))[:, asset.joint_ids].norm(dim=1)


def values(env: Any) -> torch.Tensor:
  return env.values


def image(env: Any) -> torch.Tensor:
  """Three colours, depth and validity, (N, 5, 6, 4)."""
  return torch.sigmoid(env.values[:, :, None, None]).expand(-1, -1, 6, 4)


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
    self.commands = env.command_manager = CommandManager(
      {"goal": GoalCfg(term=Goal, resampling_time_range=(0.1, 0.3))}, env
    )
    self.actions = ActionManager({"velocity": ActCfg(term=Velocity)}, env)
    bias = NoiseModelWithAdditiveBiasCfg(bias_noise_cfg=GaussianNoiseCfg(std=0.1), noise_cfg=UniformNoiseCfg())
    camera: dict[str, Any] = {"color": (0, 1, 2), "depth": 3, "lost": (4,), "hole_share": (0.0, 0.1)}
    camera |= {"gain": (0.7, 1.3), "gamma": (0.8, 1.2), "bias": (-0.1, 0.1)}
    camera |= dict.fromkeys(("color_std", "depth_std", "disparity_step"), (0.0, 0.02))
    delay: dict[str, Any] = {"delay_min_lag": 1, "delay_max_lag": 3}
    self.observations = ObservationManager(
      {
        "actor": ObservationGroupCfg(
          corrupt=True,
          terms={
            "values": ObservationTermCfg(
              values, noise=bias, clip=(-5.0, 5.0), scale=0.5, history_length=3, delay_hold_prob=0.5, **delay
            ),
            "goal": ObservationTermCfg(goal, params={"command": "goal"}),
            "steps": ObservationTermCfg(Steps, delay_update_period=3, history_length=2, **delay),
          },
        ),
        "camera": ObservationGroupCfg(
          corrupt=True, terms={"image": ObservationTermCfg(image, noise=CameraNoiseCfg(**camera))}
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
    # `others` stands for worlds that end for other reasons.
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
      **{name: value.clone() for name, value in self.observations.buffers.items()},  # type: ignore
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
  assert len(dispatched(step)) <= 300


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


def test_a_reset_leaves_what_is_remembered_and_shown_of_other_worlds_bit_identical(env):
  def leaves(state: Any, path: str = "") -> dict[str, torch.Tensor]:
    if isinstance(state, dict):
      return {name: leaf for key, part in state.items() for name, leaf in leaves(part, f"{path}.{key}").items()}
    return {path: state}

  step = Step(env)
  for _ in range(5):
    step()
  # The first half of one more step, which resets nothing.
  step.actions.process_action(torch.ones(4, 5))
  step.metrics.compute_substep()
  step.rewards.compute()
  step.metrics.compute()
  before, shown = leaves(step.snapshot()["managers"]), step.outcome()
  mask = env.mask(2)
  env.values.add_(1.0)
  for manager in step.managers.values():
    manager.reset(mask)
  step.observations.compute(mask, mask)
  after = leaves(step.snapshot()["managers"])
  rows = [name for name, value in before.items() if value.shape[:1] == (4,)]
  assert {name.split(".")[1] for name in rows} == set(step.managers) - {"curricula", "recorders"}
  assert len(rows) >= 20
  assert [name for name in rows if not torch.equal(after[name][~mask], before[name][~mask])] == []
  # It acts in its own world.
  assert sum(not torch.equal(after[name][mask], before[name][mask]) for name in rows) >= 10
  now = step.outcome()
  for name in ("actor", "camera", "critic"):
    assert torch.equal(now[name][~mask], shown[name][~mask])
    assert not torch.equal(now[name][mask], shown[name][mask])


@pytest.mark.usefixtures("nothing_skipped")
def test_managers_without_terms_do_nothing(env, dispatched, logged):
  mask = env.mask(1)
  rewards, commands, events = RewardManager({}, env), CommandManager({}, env), EventManager({}, env)
  metrics, recorders = MetricsManager({}, env), RecorderManager({}, env)

  def step() -> None:
    rewards.compute()
    metrics.compute_substep()
    metrics.compute()
    recorders.pre_reset(mask)
    for mode in ("reset", "interval", "step"):
      events.apply(mode, mask)
    for manager in (rewards, commands, events, metrics, recorders):
      manager.reset(mask)
    commands.compute(0.02, mask)
    recorders.post_reset(mask)
    recorders.post_step()

  assert dispatched(step) == []
  assert env.eager == []
  assert logged(rewards) == {}
  assert not TerminationManager({}, env).compute().any()


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
