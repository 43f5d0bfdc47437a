"""Off-policy learners on tasks of Gymnasium with published results of SAC.

  uv run python tools/parity.py pendulum --agent flashsac --seed 1 --output OUT
  uv run python tools/parity.py hopper --device cuda --output OUT

The published returns are those of RL Baselines3 Zoo (benchmark.md), mean and standard deviation of one run. Worlds of
our own train (`gymnasium_worlds.py`); the mean action of the last policy is evaluated in Gymnasium's own environment.
OUT gets the policy, TASK_AGENT_SEED.json with the learning curve and the returns, and TASK.md, the table of all runs
there. `--only train` needs no renderer of Gymnasium; `--only evaluate`, elsewhere, goes on from the files. Flags such
as --algorithm.batch-size change the settings of the learner.

- pendulum: 20 000 steps as in the published run, of 16 worlds, with 10 000 updates of 256 transitions instead of
  20 000. Networks of (64, 64). A quarter of an hour on one core.
- hopper: 1 000 000 steps as in the published run, of 64 worlds, with its discount, target entropy and networks. The
  published run makes an update of 256 transitions after each step; here there are an eighth of these updates with
  eight times as many transitions each.
"""

import argparse
import json
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium_worlds import Hopper, Pendulum, SceneCfg, Worlds, WorldsCfg
from mjlab.cli.shared._flags import parse
from mjlab_rl import Console, OffPolicyRunnerCfg, RslRlOnPolicyRunnerCfg
from mjlab_rl.offpolicy import PRESETS
from mjlab_rl.offpolicy.runner import MjlabOffPolicyRunner
from mjlab_rl.vec_env import RslRlVecEnvWrapper

ITERATION = 25
"""Steps of all worlds in an iteration."""


@dataclass(frozen=True)
class Task:
  """Task with a published result.

  `algorithm` has the settings that all learners get; rewards are scaled, since they do not fit the values of FastSAC,
  which are those of rewards times the step.
  """

  name: str
  worlds: type[Worlds]
  num_envs: int
  steps: int
  """Steps of each world."""
  hidden_dims: tuple[int, ...]
  algorithm: dict[str, Any]
  published: tuple[float, float]
  """Mean and standard deviation of returns."""
  episodes: int
  """Episodes of the evaluation."""


TASKS = {
  "pendulum": Task(
    name="Pendulum-v1",
    worlds=Pendulum,
    num_envs=16,
    steps=1250,
    hidden_dims=(64, 64),
    algorithm={"batch_size": 256, "updates_per_step": 8.0, "gamma": 0.98, "action_bound": 2.0, "learning_starts": 10},
    published=(-156.995, 88.714),
    episodes=750,
  ),
  "hopper": Task(
    name="Hopper-v5",
    worlds=Hopper,
    num_envs=64,
    steps=15_625,
    hidden_dims=(256, 256),
    algorithm={
      "batch_size": 2048,
      "updates_per_step": 8.0,
      "gamma": 0.99,
      "target_entropy": -1.0,
      "learning_starts": 160,
    },
    published=(2325.547, 1129.676),
    episodes=50,
  ),
}


def settings(task: Task, preset: str, seed: int, flags: list[str]) -> OffPolicyRunnerCfg:
  """Return a preset with the discount, batch and networks of a task, and with the flags of a user."""
  agent = PRESETS[preset](RslRlOnPolicyRunnerCfg(seed=seed, obs_groups={"actor": ("actor",), "critic": ("critic",)}))
  agent.max_iterations, agent.num_steps_per_env, agent.save_interval = task.steps // ITERATION, ITERATION, 10**6
  agent.actor.hidden_dims = agent.critic.hidden_dims = task.hidden_dims
  agent.algorithm = replace(agent.algorithm, return_scaling=True, replay_steps=task.steps, **task.algorithm)
  return parse(agent, flags)


def runner_of(task: Task, agent: OffPolicyRunnerCfg, device: str) -> MjlabOffPolicyRunner:
  """Return a runner with new worlds."""
  torch.manual_seed(agent.seed)
  env: Any = task.worlds(WorldsCfg(scene=SceneCfg(num_envs=task.num_envs), seed=agent.seed), device)
  return MjlabOffPolicyRunner(RslRlVecEnvWrapper(env), agent, device=device, console=Console("quiet"))


def difference_from_gymnasium(task: Task) -> float:
  """Return the largest difference of observations and rewards from Gymnasium's environment over 500 steps.

  Raises:
    RuntimeError: An episode ends in one of them alone.
  """
  env, other = task.worlds(WorldsCfg(scene=SceneCfg(num_envs=1))), gymnasium.make(task.name)
  inner: Any = other.unwrapped
  rng, largest, is_new = np.random.default_rng(0), 0.0, True
  for number in range(500):
    if is_new:
      env.reset(seed=number)
      other.reset(seed=number)
      if isinstance(env, Hopper):
        inner.set_state(env.qpos[0].numpy(), env.qvel[0].numpy())
      elif isinstance(env, Pendulum):
        inner.state = np.array([float(env.angle[0]), float(env.speed[0])])
    action = rng.uniform(-1.0, 1.0, env.num_actions).astype(np.float32)
    expected, reward, *ended, _ = other.step(action)
    _, found, *flags, extras = env.step(torch.from_numpy(action)[None])
    seen = extras["final_obs"]["actor"][0].numpy()
    largest = max(largest, float(np.abs(seen - expected).max()), abs(float(found[0]) - float(reward)))
    if list(map(bool, ended)) != list(map(bool, flags)):
      raise RuntimeError(f"step {number}: Gymnasium's episode {'ends' if any(ended) else 'goes on'}, ours does not")
    is_new = any(ended)
  return largest


@torch.inference_mode()
def returns_of(task: Task, runner: MjlabOffPolicyRunner) -> list[float]:
  """Return the return of each episode in Gymnasium's environment under the mean action."""
  policy = runner.get_inference_policy(runner.device)
  env = gymnasium.make_vec(task.name, task.episodes)
  space: Any = env.single_action_space
  obs, _ = env.reset(seed=0)
  total, is_running = np.zeros(task.episodes), np.ones(task.episodes, dtype=bool)
  while is_running.any():
    seen = torch.as_tensor(obs, dtype=torch.float32, device=runner.device)
    action = policy({"actor": seen, "critic": seen}).cpu().numpy()
    obs, reward, terminated, truncated, _ = env.step(np.clip(action, space.low, space.high))
    total += reward * is_running
    is_running &= ~(terminated | truncated)
  return total.tolist()


def curve(returns: list[tuple[int, float]]) -> list[tuple[int, float]]:
  """Return the mean return of the training's episodes in 25 equal parts of its steps."""
  steps, values = np.array(returns).T
  ends = np.linspace(0, steps.max(), 26)[1:]
  part = np.searchsorted(ends, steps)
  return [(int(ends[i]), float(values[part == i].mean())) for i in range(25) if (part == i).any()]


def table(folder: Path, name: str) -> str:
  """Return the table of the evaluated runs of a task in a folder."""
  lines = [
    "| learner | seed | steps | updates | training [min] | return, mean | standard deviation | episodes |",
    "|---|---:|---:|---:|---:|---:|---:|---:|",
  ]
  mean, deviation = TASKS[name].published
  lines.append(f"| SAC, published | | | | | {mean:.0f} | {deviation:.0f} | |")
  for path in sorted(folder.glob(f"{name}_*.json")):
    run = json.loads(path.read_text(encoding="utf-8"))
    if returns := run["returns"]:
      cells = [run["agent"], run["seed"], run["steps"], run["updates"], f"{run['seconds'] / 60:.1f}"]
      cells += [f"{np.mean(returns):.0f}", f"{np.std(returns):.0f}", len(returns)]
      lines.append(f"| {' | '.join(map(str, cells))} |")
  return "\n".join(lines) + "\n"


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("task", choices=TASKS)
  parser.add_argument("--agent", default="fastsac", choices=PRESETS)
  parser.add_argument("--seed", type=int, default=1)
  parser.add_argument("--num-envs", type=int, help="worlds; those of the task unless given")
  parser.add_argument("--steps", type=int, help="steps of each world; those of the task unless given")
  parser.add_argument("--device", default="cpu")
  parser.add_argument("--only", choices=("train", "evaluate"), help="one half; to evaluate reads the files of training")
  parser.add_argument("--output", type=Path, required=True, help="folder")
  args, flags = parser.parse_known_args()
  changes = {name: value for name in ("num_envs", "steps") if (value := getattr(args, name)) is not None}
  task = replace(TASKS[args.task], **changes)
  agent = settings(task, args.agent, args.seed, flags)
  args.output.mkdir(parents=True, exist_ok=True)
  policy = args.output / f"{args.task}_{args.agent}_{args.seed}.pt"
  file = policy.with_suffix(".json")
  runner = runner_of(task, agent, args.device)
  if args.only == "evaluate":
    run = json.loads(file.read_text(encoding="utf-8"))
    runner.load(str(policy), {"actor": True})
  else:
    began = time.monotonic()
    runner.learn(agent.max_iterations)
    env: Any = runner.env.unwrapped
    run = {
      "task": task.name,
      "agent": args.agent,
      "seed": args.seed,
      "flags": flags,
      "steps": env.steps_done,
      "updates": runner.algorithm.rounds_done * agent.algorithm.policy_every,
      "seconds": time.monotonic() - began,
      "device": args.device if args.device == "cpu" else torch.cuda.get_device_name(args.device),
      "curve": curve(env.returns),
      "returns": [],
    }
    runner.save(str(policy))
    file.write_text(json.dumps(run, indent=1) + "\n", encoding="utf-8")
    print(f"trained in {run['seconds']:.0f} s; last episodes of training: {run['curve'][-1][1]:.0f}", flush=True)
  if args.only != "train":
    print(f"largest difference from Gymnasium's environment: {difference_from_gymnasium(task):.1e}")
    run["returns"] = returns_of(task, runner)
    file.write_text(json.dumps(run, indent=1) + "\n", encoding="utf-8")
    (args.output / f"{args.task}.md").write_text(table(args.output, args.task), encoding="utf-8")
    print(table(args.output, args.task))


if __name__ == "__main__":
  main()
