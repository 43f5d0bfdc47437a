"""Distillation: learning from teachers, their record in the manifest, and refused teachers."""

import copy
import hashlib
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from mjlab_core import seed_everything
from mjlab_core.errors import ConfigError, FileError, MjlabError
from mjlab_rl import (
  CheckpointPolicy,
  MjlabDistillationRunner,
  MjlabOnPolicyRunner,
  RslRlDistillationRunnerCfg,
  RslRlModelCfg,
  RslRlOnPolicyRunnerCfg,
  RslRlVecEnvWrapper,
  TaskCfg,
  load_run,
  read_trained_policy,
  train,
)
from rl_learners import QUIET, assert_no_waits, assert_same, assert_same_checkpoints, exported, learner, refuse_setting
from rl_point_env import PointEnv, PointEnvCfg, PointSceneCfg


@dataclass(kw_only=True)
class TermCfg:
  scale: float = 1.0
  noise: float | None = None
  delay_max_lag: int = 0


@dataclass(kw_only=True)
class GroupCfg:
  terms: dict[str, TermCfg | None] = field(default_factory=lambda: {"position": TermCfg(), "speed": TermCfg()})
  corrupt: bool = False


@dataclass(kw_only=True)
class PushCfg:
  scale: float = 0.1
  limits: tuple[float, float] = (-1.0, 1.0)


@dataclass(kw_only=True)
class DescribedEnvCfg(PointEnvCfg):
  """The point with observations and actions in its configuration, as environments of mjlab have."""

  observations: dict[str, GroupCfg | None] = field(default_factory=lambda: {"actor": GroupCfg(), "whole": GroupCfg()})
  actions: dict[str, PushCfg] = field(default_factory=lambda: {"push": PushCfg()})
  decimation: int = 4


class DescribedEnv(PointEnv):
  """`actor` and `whole` are position and speed, `position` is the position alone, `side` is 1 right of the origin."""

  def get_observations(self) -> dict[str, torch.Tensor]:
    position = self.state[:, :1].clone()
    more = {"whole": self.state.clone(), "position": position, "side": (position > 0.0).float()}
    return super().get_observations() | more


def teacher_agent() -> RslRlOnPolicyRunnerCfg:
  cfg = RslRlOnPolicyRunnerCfg(max_iterations=3, num_steps_per_env=6, logger="none", experiment_name="teacher")
  cfg.actor = replace(cfg.actor, hidden_dims=(8,), activation="identity", obs_normalization=True)
  return cfg


WIDER = replace(teacher_agent().actor, hidden_dims=(9,))


def student_agent(sees: str = "whole", **changes: Any) -> RslRlDistillationRunnerCfg:
  cfg = RslRlDistillationRunnerCfg(
    max_iterations=4, num_steps_per_env=6, logger="none", obs_groups={"student": (sees,), "teacher": ("whole",)}
  )
  cfg.student = replace(cfg.student, hidden_dims=(16,), obs_normalization=True)
  cfg.algorithm.gradient_length, cfg.algorithm.learning_rate = 3, 1e-2
  for name, value in changes.items():
    setattr(cfg, name, value)
  return cfg


def recurrent(cfg: RslRlModelCfg, kind: Any) -> RslRlModelCfg:
  return replace(cfg, class_name="RNNModel", rnn_type=kind, rnn_hidden_dim=8)


def run(agent: Any, log_root: Path | None, env: Any = None, **options: Any) -> Any:
  """Return the result of a training."""
  task = TaskCfg(env=env or DescribedEnvCfg(scene=PointSceneCfg(num_envs=16), seed=3), agent=agent)
  options = {"make_env": DescribedEnv, "console": QUIET} | options
  return train(task, name="Point", log_root=log_root, **options)


def refused(message: str, agent: Any, log_root: Path | None = None, env: Any = None, **options: Any) -> None:
  """Check that a training is refused with a message and leaves no files."""
  files = [*log_root.rglob("*")] if log_root else []
  with pytest.raises(MjlabError, match=message):
    run(agent, log_root, env, **options)
  assert files == ([*log_root.rglob("*")] if log_root else [])


@pytest.fixture(scope="module")
def teacher(tmp_path_factory: pytest.TempPathFactory) -> Path:
  """Return a checkpoint whose policy is a damped spring, which needs position and speed."""
  return spring(tmp_path_factory.mktemp("logs"), -1.0)


@pytest.fixture(scope="module")
def contrary(tmp_path_factory: pytest.TempPathFactory) -> Path:
  """Return a checkpoint whose policy pushes the other way."""
  return spring(tmp_path_factory.mktemp("logs"), 1.0)


def spring(logs: Path, gain: float) -> Path:
  checkpoint = run(teacher_agent(), logs).checkpoint
  state = learner(checkpoint)
  weights = state["actor_state_dict"]
  for name, value in weights.items():
    if name.startswith("mlp"):
      value.zero_()
  weights["mlp.0.weight"][:2] = torch.eye(2)
  weights["mlp.2.weight"][0, :2] = torch.tensor([gain, gain])
  torch.save(state, checkpoint)
  return checkpoint


def losses(result: Any) -> list[float]:
  head, *rows = (result.directory / "progress.csv").read_text().splitlines()
  return [float(row.split(",")[head.split(",").index("Loss/behavior")]) for row in rows]


def test_a_student_learns_the_actions_of_its_teacher(tmp_path: Path, teacher: Path) -> None:
  result = run(student_agent(max_iterations=80), tmp_path, teacher=teacher)
  fallen = losses(result)
  assert sum(fallen[-10:]) / 10 < 0.01 * fallen[0]
  env = DescribedEnv(DescribedEnvCfg(scene=PointSceneCfg(num_envs=200), seed=8))
  ours, theirs = (CheckpointPolicy(env, load_run(path).agent) for path in (result.checkpoint, teacher))
  ours.load(result.checkpoint)
  theirs.load(teacher)
  seen = env.get_observations()
  assert (ours(seen) - theirs(seen)).square().mean() < 0.01 * theirs(seen).square().mean()


def test_a_recurrent_student_learns_more_from_positions_alone(tmp_path: Path, teacher: Path) -> None:
  """Two steps of the position give the speed."""

  def final(student: Callable[[RslRlModelCfg], RslRlModelCfg]) -> float:
    agent = student_agent(sees="position", max_iterations=80)
    agent.student = student(agent.student)
    return sum(losses(run(agent, tmp_path, teacher=teacher))[-10:])

  assert final(lambda cfg: recurrent(cfg, "gru")) < 0.4 * final(lambda cfg: cfg)


def test_the_manifest_records_the_teacher(tmp_path: Path, teacher: Path) -> None:
  result = run(student_agent(), tmp_path, teacher=teacher)
  manifest = load_run(result.directory)
  assert manifest.teacher is not None
  assert manifest.teacher.checkpoint == str(teacher)
  assert manifest.teacher.sha256 == hashlib.sha256(teacher.read_bytes()).hexdigest()
  assert (manifest.teacher.task, manifest.teacher.iterations) == ("Point", 3)
  # The network is written down, so that the run can continue without the run of the teacher.
  assert isinstance(manifest.agent, RslRlDistillationRunnerCfg)
  assert manifest.agent.teacher == teacher_agent().actor
  # The teacher acts with the weights of the checkpoint, and is not trained further.
  assert_same(learner(result.checkpoint)["teacher_state_dict"], learner(teacher)["actor_state_dict"])
  resumed = run(replace(manifest.agent, max_iterations=5), tmp_path, resume=result.checkpoint)
  assert load_run(resumed.directory).teacher == manifest.teacher


@pytest.mark.parametrize(("kind", "count"), [(None, 1), ("gru", 1), ("lstm", 1), ("lstm", 2)])
def test_two_iterations_and_two_more_are_four_bit_for_bit(tmp_path: Path, kind: Any, count: int) -> None:
  def configured(iterations: int) -> RslRlDistillationRunnerCfg:
    agent = student_agent(sees="position", max_iterations=iterations)
    if kind is not None:
      agent.student = recurrent(agent.student, kind)
    return agent

  own = teacher_agent() if kind is None else replace(teacher_agent(), actor=recurrent(teacher_agent().actor, kind))
  teacher = [run(own, tmp_path / "teacher").checkpoint for _ in range(count)]
  whole = run(configured(4), tmp_path / "whole", teacher=teacher).checkpoint
  half = run(configured(2), tmp_path / "half", teacher=teacher).checkpoint
  agent = replace(load_run(half).agent, max_iterations=4)
  resumed = run(agent, tmp_path / "resumed", resume=half).checkpoint
  assert_same_checkpoints(whole, resumed)


def runner(agent: RslRlDistillationRunnerCfg, *teachers: Path, **env_options: Any) -> MjlabDistillationRunner:
  seed_everything(agent.seed)
  found = [read_trained_policy(teacher) for teacher in teachers]
  agent.teacher, agent.num_teachers = found[0].network(agent), len(found)
  env = DescribedEnv(DescribedEnvCfg(seed=3, **env_options))
  made = MjlabDistillationRunner(RslRlVecEnvWrapper(env), agent, None, "cpu", console=QUIET)
  made.load_teacher(*found)
  return made


SIDES = {"student": ("whole", "side"), "teacher": ("whole",), "teacher_index": ("side",)}


@pytest.mark.parametrize("groups", [None, SIDES])
def test_the_label_of_each_world_is_the_action_of_its_teacher(
  teacher: Path, contrary: Path, groups: dict[str, tuple[str, ...]] | None
) -> None:
  made = runner(student_agent() if groups is None else student_agent(obs_groups=groups), teacher, contrary)
  made._collect(made.env.get_observations())
  stored: Any = made._distillation.storage
  seen, labels = stored.observations, stored.privileged_actions
  networks: Any = made.networks["teacher"]
  for network, path in zip(networks, (teacher, contrary), strict=True):
    assert_same(dict(network.state_dict()), learner(path)["actor_state_dict"])
  index = torch.tensor([0, 1, 0, 1]).view(1, 4, 1).expand_as(labels) if groups is None else seen["side"]
  assert 0 < index.sum() < index.numel()
  with torch.no_grad():
    first, second = (torch.stack([network(step) for step in seen.unbind(0)]) for network in networks)
  assert (first - second).abs().amin() > 0.0
  assert torch.equal(labels, torch.where(index == 1, second, first))


def test_a_student_learns_from_several_teachers_and_resumes_without_their_files(
  tmp_path: Path, teacher: Path, contrary: Path
) -> None:
  teachers = [tmp_path / path.parent.name / path.name for path in (teacher, contrary)]
  for path, copied in zip((teacher, contrary), teachers, strict=True):
    shutil.copytree(path.parent, copied.parent)
  agent = student_agent(obs_groups=SIDES, max_iterations=80)
  result = run(agent, tmp_path, teacher=teachers)
  fallen = losses(result)
  assert sum(fallen[-10:]) / 10 < 0.05 * fallen[0]
  env = DescribedEnv(DescribedEnvCfg(scene=PointSceneCfg(num_envs=200), seed=8))
  env.state.uniform_(-0.5, 0.5, generator=env.rng)
  seen = env.get_observations()
  ours, *theirs = (CheckpointPolicy(env, load_run(path).agent) for path in (result.checkpoint, *teachers))
  for policy, path in zip((ours, *theirs), (result.checkpoint, *teachers), strict=True):
    policy.load(path)
  for side, policy in enumerate(theirs):
    of_side = seen["side"][:, 0] == side
    wanted, done = policy(seen)[of_side], ours(seen)[of_side]
    assert (done - wanted).square().mean() < 0.05 * wanted.square().mean()

  manifest = load_run(result.checkpoint)
  assert manifest.teacher is not None
  records = [manifest.teacher, *manifest.more_teachers]
  assert [record.checkpoint for record in records] == [str(path) for path in teachers]
  for path in teachers:
    shutil.rmtree(path.parent)
  resumed = run(replace(agent, max_iterations=82), tmp_path, resume=result.checkpoint)
  again = load_run(resumed.checkpoint)
  assert isinstance(again.agent, RslRlDistillationRunnerCfg)
  assert (again.more_teachers, again.agent.num_teachers) == (manifest.more_teachers, 2)
  assert_same(*(learner(path)["teacher_state_dict"] for path in (result.checkpoint, resumed.checkpoint)))


def test_a_teacher_keeps_its_hidden_state_after_an_update(tmp_path: Path) -> None:
  """rsl-rl clears it in every update."""
  own = replace(teacher_agent(), actor=recurrent(teacher_agent().actor, "gru"))
  checkpoint = run(own, tmp_path).checkpoint
  made = runner(student_agent(), checkpoint, episode_steps=10**6, noise=0.0)
  network: Any = made.networks["teacher"]
  before: list[Any] = []
  after: list[torch.Tensor] = []
  network.register_forward_pre_hook(lambda *_: before.append(network.get_hidden_state()))
  network.register_forward_hook(lambda *_: after.append(network.get_hidden_state().clone()))
  made.learn(2)
  # The last step of the first iteration, and the first of the second.
  goes_on = (before[6] == after[5]).all(-1)[0]
  assert after[5].abs().amax() > 0.0
  assert goes_on.any()


@pytest.mark.parametrize(("kind", "groups"), [(None, None), ("gru", None), ("lstm", SIDES)])
def test_a_rollout_of_a_distillation_never_waits_for_the_device(teacher: Path, kind: Any, groups: Any) -> None:
  agent = student_agent(sees="position")
  if kind is not None:
    agent.student = recurrent(agent.student, kind)
  agent.obs_groups = groups or agent.obs_groups
  assert_no_waits(runner(agent, *([teacher] if groups is None else [teacher, teacher])))


def test_a_distilled_student_is_played_and_exported_like_any_policy(tmp_path: Path, teacher: Path) -> None:
  agent = student_agent()
  agent.student = recurrent(agent.student, "lstm")
  result = run(agent, tmp_path, teacher=teacher)
  agent = load_run(result.checkpoint).agent
  env = DescribedEnv(DescribedEnvCfg(scene=PointSceneCfg(num_envs=1), seed=8))
  policy = CheckpointPolicy(env, agent)
  policy.load(result.checkpoint)
  read = exported(policy, agent, env, tmp_path)
  with torch.no_grad():
    for step in range(4):
      seen = env.get_observations()
      actions = policy(seen)
      torch.testing.assert_close(read(seen), actions)
      _, _, terminated, truncated, _ = env.step(actions)
      for acting in (policy, read):
        acting.reset(terminated | truncated | torch.tensor([step == 1]))


class StudentsPointEnv(PointEnv):
  """Only `actor`, position and speed."""

  def get_observations(self) -> dict[str, torch.Tensor]:
    return {"actor": self.state.clone()}


def test_a_student_acts_without_observations_of_its_teacher(tmp_path: Path, teacher: Path) -> None:
  agent = student_agent(sees="actor")
  checkpoint = run(agent, tmp_path, teacher=teacher).checkpoint
  alone, together = (
    kind(PointEnvCfg(scene=PointSceneCfg(num_envs=5), seed=8)) for kind in (StudentsPointEnv, DescribedEnv)
  )
  reinforced = by_itself(agent)
  acting = [
    CheckpointPolicy(env, cfg)
    for env, cfg in ((alone, load_run(checkpoint).agent), (together, agent), (alone, reinforced))
  ]
  for policy in acting:
    policy.load(checkpoint)
  seen = together.get_observations()
  with torch.no_grad():
    actions = [policy({"actor": seen["actor"]}) for policy in acting]
  assert actions[0].abs().amax() > 0.0
  assert torch.equal(actions[0], actions[1])
  assert torch.equal(actions[0], actions[2])


def by_itself(agent: RslRlDistillationRunnerCfg, **changes: Any) -> RslRlOnPolicyRunnerCfg:
  """Return the configuration of reinforcement learning with the network of a student."""
  cfg = teacher_agent()
  cfg.actor, cfg.obs_groups["actor"] = replace(agent.student), agent.obs_groups["student"]
  for name, value in changes.items():
    setattr(cfg, name, value)
  return cfg


def test_reinforcement_starts_from_the_policy_of_a_student_alone(
  tmp_path: Path, teacher: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
  agent = student_agent()
  student = run(agent, tmp_path, teacher=teacher).checkpoint
  begun: list[Any] = []

  def look(made: Any, *args: Any, of: Any = MjlabOnPolicyRunner.learn, **options: Any) -> None:
    begun.append((copy.deepcopy(made.networks["actor"].state_dict()), made.current_learning_iteration))
    of(made, *args, **options)

  monkeypatch.setattr(MjlabOnPolicyRunner, "learn", look)
  result = run(by_itself(agent), tmp_path, init_from=student)
  ((weights, iteration),) = begun
  assert_same(dict(weights), learner(student)["student_state_dict"])
  assert (iteration, result.iterations) == (0, 3)
  learned = learner(result.checkpoint)["actor_state_dict"]
  assert not torch.equal(learned["mlp.0.weight"], weights["mlp.0.weight"])
  record = load_run(result.checkpoint).init_from
  assert record is not None
  assert (record.checkpoint, record.task, record.iterations) == (str(student), "Point", 4)
  # A checkpoint alone is enough.
  alone = tmp_path / "model_4.pt"
  alone.write_bytes(student.read_bytes())
  assert run(by_itself(agent), tmp_path, init_from=alone).iterations == 3


def test_a_policy_that_does_not_fit_as_a_beginning_is_refused(tmp_path: Path, teacher: Path) -> None:
  agent, none = student_agent(), tmp_path / "none"
  student = run(agent, tmp_path / "logs", teacher=teacher).checkpoint
  log = {"class_name": "GaussianDistribution", "init_std": 0.1, "std_type": "log"}
  for message, changes in (
    (r"agent\.actor\.activation was elu in its training and is relu", {"activation": "relu"}),
    (r"agent\.actor\.hidden_dims was 16 in its training and is 9", {"hidden_dims": (9,)}),
    (r"log_std_param is missing in the file", {"distribution_cfg": log}),
  ):
    refused(message, by_itself(agent, actor=replace(agent.student, **changes)), none, init_from=student)
  message = r"agent\.clip_actions was not there in its training and is 0\.5 here"
  refused(message, by_itself(agent, clip_actions=0.5), none, init_from=student)
  other = env_with(lambda cfg: whole(cfg, speed=TermCfg(), position=TermCfg()))
  message = "order of terms was position, speed in its training and is speed, position"
  refused(message, by_itself(agent), none, other, init_from=student)
  refused("a resumed run keeps its policy", by_itself(agent), none, init_from=student, resume=student)


def test_a_student_can_teach_another(tmp_path: Path, teacher: Path) -> None:
  first = run(student_agent(), tmp_path, teacher=teacher).checkpoint
  second = run(student_agent(), tmp_path, teacher=first)
  taught, own = learner(second.checkpoint)["teacher_state_dict"], learner(first)["student_state_dict"]
  assert_same(taught, own)


def env_with(change: Callable[[DescribedEnvCfg], object]) -> DescribedEnvCfg:
  cfg = DescribedEnvCfg(scene=PointSceneCfg(num_envs=16), seed=3)
  change(cfg)
  return cfg


ORDER = "observations.whole.order of terms was position, speed in its training"


def whole(cfg: DescribedEnvCfg, **terms: TermCfg | None) -> None:
  cfg.observations["whole"] = GroupCfg(terms=dict(terms))


@pytest.mark.parametrize(
  ("change", "message"),
  [
    (lambda cfg: whole(cfg, speed=TermCfg(), position=TermCfg()), f"{ORDER} and is speed, position here"),
    (lambda cfg: whole(cfg, position=TermCfg(), speed=None), f"{ORDER} and is position here"),
    (
      lambda cfg: whole(cfg, position=TermCfg(scale=0.5), speed=TermCfg()),
      "observations.whole.position.scale was 1.0 in its training and is 0.5 here",
    ),
    (lambda cfg: cfg.observations.pop("whole"), "observation group 'whole' does not exist. All 1: actor"),
    (lambda cfg: cfg.actions.update(push=PushCfg(scale=0.2)), "push.scale was 0.1 in its training and is 0.2 here"),
    (
      lambda cfg: cfg.actions.update(push=PushCfg(limits=(-2.0, 1.0))),
      "actions.push.limits was -1.0, 1.0 in its training and is -2.0, 1.0 here",
    ),
    (
      lambda cfg: setattr(cfg, "actions", {"pull": PushCfg(), "push": PushCfg()}),
      "order of actions was push in its training and is pull, push here",
    ),
    (lambda cfg: setattr(cfg, "decimation", 2), "decimation was 4 in its training and is 2 here"),
  ],
)
def test_a_teacher_with_other_observations_actions_or_timing_is_refused(
  tmp_path: Path, teacher: Path, change: Callable[[DescribedEnvCfg], object], message: str
) -> None:
  refused(f"of Point does not fit: .*{message}", student_agent(), tmp_path, env_with(change), teacher=teacher)


def test_a_resumed_distillation_needs_the_actions_of_its_teacher(tmp_path: Path, teacher: Path) -> None:
  half = run(student_agent(), tmp_path, teacher=teacher).checkpoint
  other = env_with(lambda cfg: cfg.actions.update(push=PushCfg(scale=0.2)))
  longer = student_agent(max_iterations=9)
  refused(r"actions\.push\.scale was 0\.1 in its training and is 0\.2 here", longer, tmp_path, other, resume=half)
  # Without its manifest the configuration must describe the network.
  alone = tmp_path / "model_4.pt"
  alone.write_bytes(half.read_bytes())
  refused("has no manifest", student_agent(max_iterations=9), tmp_path, resume=alone)
  assert run(student_agent(max_iterations=9, teacher=teacher_agent().actor), tmp_path, resume=alone).iterations == 9


def test_a_teacher_may_see_without_the_noise_and_the_delay_of_its_training(tmp_path: Path) -> None:
  def noisy(cfg: DescribedEnvCfg) -> None:
    terms: dict[str, TermCfg | None] = {"position": TermCfg(noise=0.1), "speed": TermCfg(delay_max_lag=2)}
    cfg.observations["actor"] = GroupCfg(terms=terms, corrupt=True)

  teacher = run(teacher_agent(), tmp_path, env_with(noisy)).checkpoint
  assert run(student_agent(), tmp_path, teacher=teacher).iterations == 4


def test_other_networks_groups_and_limits_than_the_teachers_are_refused(tmp_path: Path, teacher: Path) -> None:
  message = r"agent\.teacher\.hidden_dims was 8 in its training and is 9 here"
  refused(message, student_agent(teacher=WIDER), tmp_path, teacher=teacher)
  groups = {"student": ("whole",), "teacher": ("whole", "position")}
  message = "number of observation groups was 1 in its training and is 2 here"
  refused(message, student_agent(obs_groups=groups), tmp_path, teacher=teacher)
  message = r"agent\.clip_actions was not there in its training and is 0\.5 here"
  refused(message, student_agent(clip_actions=0.5), tmp_path, teacher=teacher)


def test_several_teachers_that_do_not_fit_are_refused(tmp_path: Path, teacher: Path, contrary: Path) -> None:
  other = run(replace(teacher_agent(), actor=WIDER), tmp_path).checkpoint
  message = r"hidden_dims was 9 in its training and is 8 here\. Several teachers must"
  refused(message, student_agent(), teacher=[teacher, other])
  for group, message in (
    ("whole", r"'whole' of agent\.obs_groups\['teacher_index'\] has shape \(16, 2\); it must be one number for each"),
    ("position", r"'position' of .* has -?[\d.e-]+; the 2 teachers are 0 to 1"),
    ("sides", r"observation group 'sides' does not exist"),
  ):
    groups = SIDES | {"teacher_index": (group,)}
    refused(message, student_agent(obs_groups=groups), teacher=[teacher, contrary])


def test_a_checkpoint_alone_needs_a_description_and_is_checked_by_its_shapes(tmp_path: Path, teacher: Path) -> None:
  alone = tmp_path / "model_9.pt"
  alone.write_bytes(teacher.read_bytes())
  refused(r"has no manifest; agent\.teacher must describe its network", student_agent(), teacher=alone)
  message = r"teacher: mlp\.0\.weight is \(8, 2\) in the file and \(9, 2\) here"
  refused(message, student_agent(teacher=WIDER), teacher=alone)
  assert run(student_agent(teacher=teacher_agent().actor), None, teacher=alone).iterations == 4


def test_a_teacher_that_contains_code_is_refused(tmp_path: Path) -> None:
  path = tmp_path / "model_1.pt"
  torch.save({"actor_state_dict": os.system}, path)
  with pytest.raises(FileError, match="not loaded"):
    read_trained_policy(path)


def test_a_teacher_is_refused_where_it_is_not_needed(tmp_path: Path, teacher: Path) -> None:
  refused("a distillation needs a teacher", student_agent(), tmp_path)
  refused("only a RslRlDistillationRunnerCfg has a teacher", teacher_agent(), tmp_path, teacher=teacher)
  refused("a resumed run keeps its teacher", student_agent(), tmp_path, teacher=teacher, resume=teacher)
  refused("has no teacher, so it is not a distillation to resume", student_agent(), tmp_path, resume=teacher)


def test_a_runner_of_another_learner_is_refused(teacher: Path) -> None:
  task = TaskCfg(env=DescribedEnvCfg(), agent=student_agent(), runner=MjlabOnPolicyRunner)
  message = "runner is MjlabOnPolicyRunner; a distillation needs a MjlabDistillationRunner"
  with pytest.raises(ConfigError, match=message):
    train(task, name="Point", make_env=DescribedEnv, log_root=None, console=QUIET, teacher=teacher)


def test_a_new_step_size_on_resuming_applies(tmp_path: Path, teacher: Path) -> None:
  checkpoint = run(student_agent(), tmp_path, teacher=teacher).checkpoint
  agent = student_agent()
  agent.algorithm.learning_rate = 0.5
  made = runner(agent, teacher)
  made.load(str(checkpoint))
  assert [group["lr"] for group in made.alg.optimizer.param_groups] == [0.5]


@pytest.mark.parametrize(
  ("path", "value", "message"),
  [
    ("algorithm.gradient_length", 4, "gradient_length is 4; it must divide .*, 6, or the"),
    ("algorithm.gradient_length", 0, "gradient_length must be at least 1, got 0"),
    ("algorithm.max_grad_norm", 0.0, "max_grad_norm must be positive, got 0.0"),
    ("student.activation", "ellu", "agent.student.activation 'ellu' does not exist"),
    ("student.distribution_cfg", None, r"agent\.student\.distribution_cfg is None"),
    ("teacher", RslRlModelCfg(hidden_dims=(0,)), "agent.teacher.hidden_dims must be at least 1"),
  ],
)
def test_impossible_settings_of_a_distillation_are_refused(path: str, value: object, message: str) -> None:
  refuse_setting(student_agent(), path, value, message)


def test_a_distillation_trains_without_a_gradient_limit(teacher: Path) -> None:
  agent = student_agent()
  agent.algorithm.max_grad_norm = None
  runner(agent, teacher).learn(1)
