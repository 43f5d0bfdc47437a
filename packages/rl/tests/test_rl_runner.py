import csv
import itertools
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest
import torch
from mjlab_core.errors import ConfigError, DivergedError, FileError
from mjlab_rl import Console, MjlabOnPolicyRunner, RslRlVecEnvWrapper, TaskCfg, checkpoints, load_run, train
from mjlab_rl.processes.stop_signals import StopSignals
from mjlab_rl.reports.episode_statistics import WINDOW, EpisodeStatistics
from mjlab_rl.reports.scalar_log import IterationReport
from mjlab_rl.runs.run_directory import create_run_directory
from rl_learners import (
  QUIET,
  Terminal,
  agent,
  assert_no_waits,
  assert_resumes_exactly,
  assert_same,
  learner,
  refuse_setting,
  runner,
)
from rl_point_env import PointEnv, PointEnvCfg
from rsl_rl.utils.logger import Logger
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

NAMES = ("experiment_name", "run_name")


@pytest.mark.parametrize("rnn_type", [None, "lstm"])
def test_three_iterations_and_three_more_equal_six_bit_for_bit(tmp_path: Path, rnn_type: Any) -> None:
  cfg = agent()
  for model in (cfg.actor, cfg.critic):
    model.rnn_type, model.rnn_hidden_dim = rnn_type, 4
  assert_resumes_exactly(lambda folder: runner(folder, cfg), tmp_path, half=3)


def test_a_rollout_never_waits_for_the_device() -> None:
  assert_no_waits(runner(None, agent()))


def test_statistics_equal_those_of_rsl_rl() -> None:
  logger = Logger(None, {"algorithm": {}}, {}, 60, False, 1, 0, "cpu")
  logger.writer = MagicMock()
  statistics = EpisodeStatistics(60, "cpu")
  assert statistics.means() == ()
  for step in range(40):
    rewards = torch.randn(60)
    dones = (torch.rand(60) < (1.0 if step == 20 else 0.1)).long()
    logger.process_env_step(rewards, dones, {})
    statistics.add(rewards, dones)
    means = statistics.means()
    assert means[0] == pytest.approx(sum(logger.rewbuffer) / len(logger.rewbuffer), rel=1e-5, abs=1e-5)
    assert means[1] == pytest.approx(sum(logger.lenbuffer) / len(logger.lenbuffer))


def test_more_than_a_window_of_episodes_in_one_step_keeps_the_last() -> None:
  statistics = EpisodeStatistics(2 * WINDOW + 7, "cpu")
  rewards = torch.arange(2 * WINDOW + 7.0)
  statistics.add(rewards, torch.ones_like(rewards))
  assert statistics.means()[0] == pytest.approx(float(rewards[-WINDOW:].mean()))


@pytest.fixture
def wrapped() -> RslRlVecEnvWrapper:
  return RslRlVecEnvWrapper(PointEnv(PointEnvCfg()))


def test_termination_takes_precedence_over_a_time_out(wrapped: RslRlVecEnvWrapper) -> None:
  env: Any = wrapped.unwrapped
  env.state.zero_()
  env.state[0, 0] = 5.0
  env.episode_length_buf.fill_(env.max_episode_length - 1)
  _, _, dones, extras = wrapped.step(torch.zeros(4, 1))
  assert dones.dtype == torch.int64
  assert dones.tolist() == [1, 1, 1, 1]
  assert extras["time_outs"].tolist() == [False, True, True, True]


def test_finite_horizon_has_no_time_outs() -> None:
  wrapped = RslRlVecEnvWrapper(PointEnv(PointEnvCfg(is_finite_horizon=True)))
  assert "time_outs" not in wrapped.step(torch.zeros(4, 1))[3]


def test_a_reset_begins_episodes_and_returns_their_observations(wrapped: RslRlVecEnvWrapper) -> None:
  wrapped.step(torch.ones(4, 1))
  observations, _ = wrapped.reset()
  assert torch.equal(observations["actor"], wrapped.get_observations()["actor"])
  assert wrapped.episode_length_buf.tolist() == [0, 0, 0, 0]
  wrapped.close()


def test_assigning_episode_lengths_keeps_their_memory(wrapped: RslRlVecEnvWrapper) -> None:
  lengths = wrapped.unwrapped.episode_length_buf
  wrapped.episode_length_buf = torch.arange(4)
  assert wrapped.unwrapped.episode_length_buf is lengths
  assert lengths.tolist() == [0, 1, 2, 3]


def test_actions_are_clipped_before_the_environment_sees_them() -> None:
  env = PointEnv(PointEnvCfg())
  actions = torch.tensor([[-9.0], [-0.5], [0.5], [9.0]])
  RslRlVecEnvWrapper(env, clip_actions=2.0).step(actions)
  assert env.last_action.flatten().tolist() == [-2.0, -0.5, 0.5, 2.0]
  assert actions[0, 0] == -9.0


def test_observations_of_consecutive_steps_do_not_alias(wrapped: RslRlVecEnvWrapper) -> None:
  first = wrapped.step(torch.ones(4, 1))[0]
  before = first["actor"].clone()
  wrapped.step(torch.ones(4, 1))
  assert torch.equal(first["actor"], before)


def test_a_learner_continues_in_another_number_of_worlds_with_a_message(
  tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
  small = runner(tmp_path, agent())
  small.learn(2)
  large = runner(None, agent(), worlds=6, console=Console())
  large.load(str(tmp_path / "model_2.pt"))
  assert "world state was not restored: it was saved with 4 worlds, there are 6 now" in capsys.readouterr().out
  assert not large.is_world_state_restored
  assert large.current_learning_iteration == 2
  assert int(large.env.unwrapped.state_dict()["steps"]) == 12
  assert_same(large.alg.actor.state_dict(), small.alg.actor.state_dict())
  large.learn(1)


def test_a_checkpoint_of_other_network_sizes_names_the_difference_and_changes_nothing(tmp_path: Path) -> None:
  runner(tmp_path, agent()).learn(1)
  other = runner(None, agent(hidden=(16,)))
  before = {name: value.clone() for name, value in other.alg.actor.state_dict().items()}
  with pytest.raises(FileError, match=r"actor: mlp.0.weight is \(8, 2\) in the file and \(16, 2\) here"):
    other.load(str(tmp_path / "model_1.pt"))
  assert_same(dict(other.alg.actor.state_dict()), before)


def test_a_compiled_network_keeps_the_names_of_its_weights() -> None:
  plain, compiled = runner(None, agent()), runner(None, agent(torch_compile_mode="default"))
  assert compiled.alg.actor is not compiled.networks["actor"]
  assert_same(dict(plain.networks["actor"].state_dict()), dict(compiled.networks["actor"].state_dict()))
  assert compiled.alg.get_policy() is compiled.networks["actor"]


@pytest.mark.parametrize("infos", [None, {"env_state": {"common_step_counter": 42}}])
def test_a_checkpoint_of_rsl_rl_restores_the_learner_and_the_step_counter_of_mjlab(
  tmp_path: Path, capsys: pytest.CaptureFixture[str], infos: Any
) -> None:
  trained = runner(tmp_path, agent())
  trained.learn(2)
  path = tmp_path / "theirs.pt"
  torch.save(trained.alg.save() | {"iter": 7, "infos": infos}, path)
  fresh = runner(None, agent(), console=Console())
  env: Any = fresh.env.unwrapped
  env.common_step_counter = torch.zeros((), dtype=torch.int64)
  assert fresh.load(str(path)) == (infos or {})
  assert fresh.current_learning_iteration == 8
  assert_same(fresh.alg.critic.state_dict(), trained.alg.critic.state_dict())
  said = capsys.readouterr().out
  assert "only the learner was restored" in said
  assert ("The environment's step counter continues at 42." in said) == (infos is not None)
  assert int(env.common_step_counter) == (42 if infos else 0)


def test_a_damaged_checkpoint_is_a_clear_error_wherever_it_was_cut(tmp_path: Path) -> None:
  trained, path = runner(tmp_path, agent()), tmp_path / "model_0.pt"
  trained.save(str(path))
  whole = path.read_bytes()
  for content in (*(whole[: len(whole) * tenths // 10] for tenths in range(10)), b"no checkpoint", b"root:x:0:0:root"):
    path.write_bytes(content)
    with pytest.raises(FileError, match=r"model_0\.pt: damaged or not a checkpoint$"):
      trained.load(str(path))


@pytest.mark.parametrize("optimizer", ["adamw", "sgd", "rmsprop"])
def test_a_resumed_training_must_keep_its_optimizer(tmp_path: Path, optimizer: Any) -> None:
  runner(tmp_path, agent()).learn(1)
  cfg = agent()
  cfg.algorithm.optimizer = optimizer
  with pytest.raises(FileError, match=r"agent\.algorithm\.optimizer was another one in its training"):
    runner(None, cfg).load(str(tmp_path / "model_1.pt"))


@pytest.mark.parametrize(("schedule", "rate"), [("fixed", 0.5), ("adaptive", 0.25)])
def test_a_new_step_size_on_resuming_applies_to_a_fixed_schedule(tmp_path: Path, schedule: Any, rate: float) -> None:
  trained = runner(tmp_path, agent())
  trained.alg.optimizer.param_groups[0]["lr"] = 0.25
  trained.save(str(tmp_path / "model_1.pt"))
  cfg = agent()
  cfg.algorithm.schedule, cfg.algorithm.learning_rate = schedule, 0.5
  fresh = runner(None, cfg)
  fresh.load(str(tmp_path / "model_1.pt"))
  assert (fresh.alg.learning_rate, fresh.alg.optimizer.param_groups[0]["lr"]) == (rate, rate)


@pytest.mark.parametrize(
  ("change", "message"),
  [
    (
      lambda state: [state.pop(f"{part}_state_dict") for part in ("critic", "optimizer")],
      r"no critic and no optimizer in it; .* \(--init-from\)",
    ),
    (lambda state: state["mjlab"].update(format=2), "written by another version"),
    (
      lambda state: next(iter(state["critic_state_dict"].values())).fill_(float("nan")),
      r"model_0\.pt: the file has NaN or infinite weights in critic: ",
    ),
    (lambda state: state.update(actor_state_dict=os.system), "not loaded"),
  ],
)
def test_a_checkpoint_that_lacks_something_or_contains_too_much_is_refused(
  tmp_path: Path, change: Callable[[dict[str, Any]], object], message: str
) -> None:
  trained = runner(tmp_path, agent())
  path = trained.checkpoint_path()
  trained.save(str(path))
  state = learner(path)
  change(state)
  torch.save(state, path)
  with pytest.raises(FileError, match=message):
    trained.load(str(path))


def test_a_policy_that_is_not_finite_is_not_trained_on_and_not_saved(tmp_path: Path) -> None:
  diverging = runner(tmp_path, agent(save_interval=1))
  diverging.learn(1)
  diverging.alg.value_loss_coef = float("nan")
  with pytest.raises(DivergedError, match=r"iteration 2: .*not finite.* checkpoint is .*model_1\.pt\. Cause: "):
    diverging.learn(5)
  assert all(value.isfinite().all() for value in learner(checkpoints(tmp_path)[-1])["actor_state_dict"].values())


@pytest.mark.parametrize(
  ("scalars", "cause"),
  [
    ({"Nonfinite/reward/energy": 3.0}, "Cause: not finite before the update: reward/energy (3 values)."),
    ({"Episode_Reward/alive": 1.0, "Episode_Reward/energy": -2e9}, "the largest reward term is energy (2e+09), "),
    (
      {"Episode_Reward/alive": float("nan"), "Loss/learning_rate": 0.5},
      "term is alive (nan), the learning rate is 0.5",
    ),
    ({}, "learning rate is nan"),
  ],
)
def test_a_divergence_names_its_cause(scalars: dict[str, float], cause: str) -> None:
  report = IterationReport(iteration=0, end=1, total_steps=0, elapsed=1.0, eta=1.0, scalars=scalars)
  assert cause in report.cause_of_divergence()


@pytest.mark.parametrize("name", ["actor", "critic"])
def test_weights_broken_by_the_last_step_of_an_update_are_not_saved(tmp_path: Path, name: str) -> None:
  broken = runner(tmp_path, agent(save_interval=1))
  *_, bias = broken.networks[name].parameters()

  def update(obs: Any, of: Any = broken._update) -> dict[str, float]:
    losses = of(obs)
    bias.detach()[0] = float("nan")
    return losses

  broken._update = update
  with pytest.raises(DivergedError, match=f"iteration 1: {name} not finite, so the state is not saved"):
    broken.learn(2)
  assert checkpoints(tmp_path) == []


def test_an_environment_without_actions_is_refused(wrapped: RslRlVecEnvWrapper) -> None:
  wrapped.num_actions = 0
  with pytest.raises(ConfigError, match="the environment has no actions"):
    MjlabOnPolicyRunner(wrapped, agent(), console=QUIET)


@pytest.mark.parametrize("error", [OSError("disk full"), RuntimeError("unexpected pos 64 vs 0")])
def test_a_failed_write_leaves_the_old_checkpoint_and_raises(
  tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
  trained = runner(tmp_path, agent())
  path = tmp_path / "model_0.pt"
  trained.save(str(path))
  before = path.read_bytes()

  def half(state: object, file: Path) -> None:
    Path(file).write_bytes(b"half")
    raise error

  monkeypatch.setattr(torch, "save", half)
  with pytest.raises(FileError, match=rf"model_0\.pt could not be written: {error}; is there room"):
    trained.save(str(path))
  assert path.read_bytes() == before
  assert [file.name for file in tmp_path.iterdir()] == ["model_0.pt"]


def at_step(number: int, trained: MjlabOnPolicyRunner, call: Callable[[], object]) -> None:
  """Let a function be called at a step of the environment, counted from 1."""
  step, count = trained.env.step, itertools.count(1)

  def stepping(actions: torch.Tensor) -> Any:
    if next(count) == number:
      call()
    return step(actions)

  trained.env.step = stepping


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_iteration_and_saves(
  tmp_path: Path, number: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
  # Both signals come at the same time, however busy the machine is.
  monkeypatch.setattr("mjlab_rl.processes.stop_signals.time", SimpleNamespace(monotonic=lambda: 1.0))
  interrupted = runner(tmp_path, agent())

  def stop() -> None:
    os.kill(os.getpid(), number)
    os.kill(os.getpid(), number)  # As a launcher passes it on.

  at_step(8, interrupted, stop)
  # An ignored signal stays ignored: tests may have been started with `nohup`.
  hangup = signal.signal(signal.SIGHUP, signal.SIG_DFL)
  handlers = [signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)]
  try:
    interrupted.learn(50)
  finally:
    signal.signal(signal.SIGHUP, hangup)
  assert interrupted.stopped_by == number.name
  assert [path.name for path in checkpoints(tmp_path)] == ["model_2.pt"]
  assert [signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)] == handlers


def test_a_signal_at_the_end_of_an_iteration_waits_for_the_next_which_saves(
  tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
  reads = itertools.count()
  # The signal arrives after the first read of an iteration.
  received = property(lambda _: "SIGINT" if next(reads) else None, lambda *_: None)
  monkeypatch.setattr(StopSignals, "received", received, raising=False)
  interrupted = runner(tmp_path, agent())
  interrupted.learn(50)
  assert interrupted.stopped_by == "SIGINT"
  assert interrupted.checkpoint_path().is_file()


def test_a_second_signal_ends_the_process_at_once() -> None:
  code = """
import os, signal
from types import SimpleNamespace
from mjlab_rl.processes import stop_signals
now = [1.0]
stop_signals.time = SimpleNamespace(monotonic=lambda: now[0])
with stop_signals.StopSignals():
  os.kill(os.getpid(), signal.SIGINT)
  now[0] += 0.6
  os.kill(os.getpid(), signal.SIGINT)
print("continues")
"""
  done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
  assert done.returncode == -signal.SIGINT
  assert "once more to quit" in done.stderr
  assert "Stopped at once" in done.stderr


def test_nohup_stays_in_effect() -> None:
  code = """
import os, signal
from mjlab_rl.processes.stop_signals import StopSignals
with StopSignals() as stop:
  os.kill(os.getpid(), signal.SIGHUP)
assert stop.received is None
"""
  done = subprocess.run(["nohup", sys.executable, "-c", code], capture_output=True, text=True, check=False)
  assert done.returncode == 0, done.stderr


def test_every_iteration_is_a_row_and_checkpoints_come_at_the_interval(tmp_path: Path) -> None:
  runner(tmp_path, agent(save_interval=2)).learn(5)
  with (tmp_path / "progress.csv").open() as file:
    rows = list(csv.DictReader(file))
  assert [row["iteration"] for row in rows] == ["0", "1", "2", "3", "4"]
  assert rows[0]["Train/mean_reward"] == ""
  assert float(rows[-1]["Train/mean_reward"]) < 12
  assert float(rows[-1]["Train/mean_episode_length"]) <= 12
  wanted = {"Loss/value", "Loss/surrogate", "Loss/entropy", "Loss/learning_rate", "Policy/mean_std", "Perf/total_fps"}
  assert (
    wanted | {"Perf/collection_time", "Perf/learning_time", "Episode_Reward/point", "Episode/bare"} <= rows[0].keys()
  )
  assert [path.name for path in checkpoints(tmp_path)] == ["model_2.pt", "model_4.pt", "model_5.pt"]


def test_tensorboard_gets_the_same_values_without_wandb(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
  monkeypatch.setitem(sys.modules, "wandb", None)
  runner(tmp_path, agent(logger="tensorboard")).learn(3)
  events = EventAccumulator(str(tmp_path)).Reload()
  with (tmp_path / "progress.csv").open(newline="") as file:
    rows = list(csv.DictReader(file))
  for tag in ("Loss/value", "Loss/learning_rate", "Policy/mean_std", "Episode_Reward/point"):
    written = [(event.step, event.value) for event in events.Scalars(tag)]
    assert [step for step, _ in written] == [int(row["iteration"]) for row in rows if row[tag]], tag
    assert [value for _, value in written] == pytest.approx([float(row[tag]) for row in rows if row[tag]], rel=1e-6)


@pytest.mark.parametrize("upload", [False, True])
def test_wandb_gets_the_same_values_the_config_and_checkpoints_if_wanted(
  tmp_path: Path, monkeypatch: pytest.MonkeyPatch, upload: bool
) -> None:
  run, opened = MagicMock(), MagicMock()
  opened.return_value = run
  monkeypatch.setitem(sys.modules, "wandb", SimpleNamespace(init=opened, __spec__=object()))
  runner(tmp_path, agent(logger="wandb", wandb_project="walk", upload_model=upload)).learn(3)
  assert opened.call_args.kwargs["project"] == "walk"
  assert opened.call_args.kwargs["config"]
  assert [call.kwargs["step"] for call in run.log.call_args_list] == [0, 1, 2]
  with (tmp_path / "progress.csv").open(newline="") as file:
    losses = [float(row["Loss/value"]) for row in csv.DictReader(file)]
  assert [call.args[0]["Loss/value"] for call in run.log.call_args_list] == pytest.approx(losses, rel=1e-6)
  assert run.save.called is upload
  run.finish.assert_called_once()


@pytest.mark.parametrize(
  ("path", "value", "message"),
  [
    ("algorithm.learning_rate", -1.0, "agent.algorithm.learning_rate must be positive, got -1.0"),
    ("algorithm.learning_rate", float("inf"), "learning_rate must be finite, got inf"),
    ("algorithm.gamma", 1.5, r"agent.algorithm.gamma must be in \[0, 1\], got 1.5"),
    ("algorithm.entropy_coef", float("nan"), "entropy_coef must be a number, got nan"),
    ("critic.hidden_dims", (64, 0), r"agent.critic.hidden_dims must be at least 1, got \(64, 0\)"),
    ("critic.hidden_dims", (), "agent.critic.hidden_dims is empty"),
    ("clip_actions", -1.0, "agent.clip_actions must be positive, got -1.0"),
    ("actor.distribution_cfg", {"init_std": 0.0}, "actor.distribution_cfg.init_std must be positive, got 0.0"),
    ("actor.distribution_cfg", None, r"agent\.actor\.distribution_cfg is None"),
    ("actor.activation", "ellu", "agent.actor.activation 'ellu' does not exist. Nearest: elu"),
    ("logger", "wandb", "pip install wandb"),
    ("experiment_name", "", r"agent\.experiment_name is ''"),
    *((field, name, rf"agent\.{field} is '{name}'") for field in NAMES for name in ("a/b", "../b", "..", ".")),
  ],
)
def test_impossible_settings_are_refused_by_their_flag(
  monkeypatch: pytest.MonkeyPatch, path: str, value: object, message: str
) -> None:
  monkeypatch.setitem(sys.modules, "wandb", None)
  refuse_setting(agent(), path, value, message)


def test_a_training_that_breaks_leaves_the_progress_line_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
  monkeypatch.setenv("TERM", "xterm")
  stream = Terminal()
  broken = runner(tmp_path, agent(), console=Console("normal", stream))
  at_step(40, broken, MagicMock(side_effect=RuntimeError("out of luck")))
  with pytest.raises(RuntimeError, match="out of luck"):
    broken.learn(50)
  # The last command shows the cursor again.
  assert stream.getvalue().endswith("\n\x1b[?25h")


def test_all_impossible_settings_are_in_one_message() -> None:
  cfg = agent(clip_actions=-1.0, logger="none")
  cfg.algorithm.gamma, cfg.critic.rnn_num_layers = 2.0, 0
  with pytest.raises(ConfigError) as caught:
    cfg.to_rsl_rl()
  assert [problem.split()[0] for problem in caught.value.problems] == [
    "agent.clip_actions",
    "agent.critic.rnn_num_layers",
    "agent.algorithm.gamma",
  ]


@pytest.mark.parametrize("count", [0, 10**8])
def test_more_mini_batches_than_samples_are_a_clear_error(count: int) -> None:
  cfg = agent()
  cfg.algorithm.num_mini_batches = count
  with pytest.raises(ConfigError, match=rf"agent\.algorithm\.num_mini_batches is {count}; an iteration of"):
    runner(None, cfg)


def test_a_run_directory_rebuilds_and_continues_its_run(tmp_path: Path) -> None:
  task = TaskCfg(env=PointEnvCfg(noise=0.1), agent=agent(3, experiment_name="point", seed=5))
  first = train(task, name="Point", make_env=PointEnv, log_root=tmp_path, console=QUIET)
  assert task.env.seed is None
  assert first.iterations == 3
  assert first.directory is not None
  run = load_run(first.directory)
  assert run.env == PointEnvCfg(noise=0.1, seed=5)
  assert run.agent == task.agent
  assert (run.task, run.seed) == ("Point", 5)
  longer = TaskCfg(env=run.env, agent=agent(5, experiment_name="point", seed=5))
  second = train(longer, name="Point", make_env=PointEnv, log_root=tmp_path, resume=first.checkpoint, console=QUIET)
  assert second.iterations == 5
  assert second.directory != first.directory
  with pytest.raises(ConfigError, match=r"raise --agent\.max-iterations, which is"):
    train(longer, name="Point", make_env=PointEnv, resume=second.checkpoint, console=QUIET)


def test_a_run_that_cannot_be_built_leaves_no_directory(tmp_path: Path) -> None:
  broken = MagicMock(side_effect=ValueError("no such joint"))
  task = TaskCfg(env=PointEnvCfg(), agent=agent())
  with pytest.raises(ValueError, match="no such joint"):
    train(task, name="Point", make_env=broken, log_root=tmp_path, console=QUIET)
  assert list(tmp_path.iterdir()) == []


def test_the_environment_is_closed_when_training_fails() -> None:
  failing = PointEnv(PointEnvCfg())
  failing.drain_log = MagicMock(side_effect=ArithmeticError)
  task = TaskCfg(env=failing.cfg, agent=agent())
  with pytest.raises(ArithmeticError):
    train(task, name="P", make_env=lambda cfg, device: failing, log_root=None, console=QUIET)
  assert failing.is_closed


@pytest.mark.parametrize(("part", "done"), [("step", 2), ("update", 2), ("drain_log", 2), ("_averages.reduce", 3)])
def test_a_failure_in_a_step_or_an_update_saves_an_emergency_checkpoint_first(
  tmp_path: Path, capsys: pytest.CaptureFixture[str], part: str, done: int
) -> None:
  failing = runner(tmp_path, agent(), console=Console())
  failing.learn(2)
  owner: Any = {"update": failing.alg, "_averages.reduce": failing._averages}.get(part, failing.env)
  setattr(owner, part.split(".")[-1], MagicMock(side_effect=ConfigError("event 'push': broken")))
  with pytest.raises(ConfigError, match="event 'push': broken"):
    failing.learn(2)
  saved = tmp_path / f"emergency_{done}.pt"
  assert f"ConfigError in a step or update; saved {saved}, which --resume takes" in capsys.readouterr().out
  assert [path.name for path in checkpoints(tmp_path)] == ["model_2.pt"]
  resumed = runner(None, agent())
  resumed.load(str(saved))
  assert resumed.current_learning_iteration == done
  resumed.learn(1)


def test_a_checkpoint_half_written_by_a_killed_run_is_removed_at_the_next_start(tmp_path: Path) -> None:
  run = create_run_directory(tmp_path, "exp")
  code = (
    "import os, sys; from mjlab_core.io.files import AtomicWrite\n"
    "AtomicWrite(sys.argv[1]).temporary.write_text('half'); os._exit(9)"
  )
  subprocess.run([sys.executable, "-c", code, run / "model_50.pt"], check=False)
  assert len(list(run.iterdir())) == 1
  create_run_directory(tmp_path, "exp")
  assert list(run.iterdir()) == []
