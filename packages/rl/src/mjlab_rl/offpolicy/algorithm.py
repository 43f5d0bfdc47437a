"""Base of off-policy algorithms: collection into the replay memory, interleaved updates, state."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import torch
from mjlab_core.errors import ConfigError
from rsl_rl.utils import resolve_class
from tensordict import TensorDict
from torch import distributed
from torch.nn import BatchNorm1d

from mjlab_rl.offpolicy.config import SacCfg
from mjlab_rl.offpolicy.networks import Actor, Critic
from mjlab_rl.offpolicy.replay import Reflection, Replay, Transitions
from mjlab_rl.offpolicy.returns import RepeatedNoise, ReturnScale
from mjlab_rl.recording import Recorded


class OffPolicyAlgorithm(ABC):
  """Algorithm that learns from a replay memory.

  A subclass defines `round`, the updates for one update of the policy, `parameter_groups` and `figures`, and adds its
  parts with state to `modules`. A round has fixed shapes and reads nothing back, because a GPU records it as one graph.

  Args:
    actor: The policy.
    critic: The estimate of returns.
    groups: Width of each observation group that either network sees.
    env: Environment, a VecEnv of rsl-rl.
    cfg: Settings.
    total_steps: Steps of all worlds in the whole run, for the step size.
    device: Device of everything.
  """

  learning_rate: float
  """Present step size."""

  def __init__(
    self,
    actor: Actor,
    critic: Critic,
    groups: Mapping[str, int],
    env: Any,
    cfg: SacCfg,
    total_steps: int,
    device: torch.device | str,
  ) -> None:
    self.cfg, self.total_steps, self.device = cfg, total_steps, torch.device(device)
    self.actor, self.critic = actor.to(device), critic.to(device)
    self._groups = tuple(groups)
    ends = torch.tensor([0, *groups.values()]).cumsum(0).tolist()
    columns = {name: slice(*ends[i : i + 2]) for i, name in enumerate(groups)}
    self._actor_columns = [columns[name] for name in actor.obs_groups]
    self._critic_columns = [columns[name] for name in critic.obs_groups]
    self.actor.squash.bound.copy_(action_bounds(env.unwrapped, env.num_actions, cfg))
    self.replay = Replay(env.num_envs, cfg.replay_steps, ends[-1], env.num_actions, device, is_half=cfg.replay_half)
    self.noise = RepeatedNoise(env.num_envs, env.num_actions, cfg.noise_repetition, device)
    self.modules: dict[str, torch.nn.Module] = {}
    """Parts with state besides actor and critic."""
    self.scale: ReturnScale | None = None
    if cfg.return_scaling:
      self.scale = self.modules["scale"] = ReturnScale(env.num_envs, cfg.gamma, cfg.value_limit).to(device)
    self.reflection: Reflection | None = None
    if cfg.symmetry is not None:
      self.reflection = Reflection(cfg.symmetry(env.unwrapped), self._groups, device)
    self.rounds_done = 0
    """Rounds of updates so far."""
    self.steps_done = 0
    """Steps of all worlds so far, on which the step size depends."""
    self._due = 0.0
    self._lr = torch.tensor(cfg.learning_rate, device=device)
    # Collectives of several processes stay outside of recordings.
    is_eager = not cfg.capture or distributed.is_initialized()
    self._recorded_round = Recorded(self.round, self.device, is_eager=is_eager)
    self.set_learning_rate()

  @classmethod
  def construct_algorithm(cls, obs: TensorDict, env: Any, cfg: dict[str, Any], device: str) -> "OffPolicyAlgorithm":
    """Build networks and algorithm; rsl-rl's name for it."""
    algorithm: SacCfg = cfg["algorithm"]["cfg"]
    actor_class, options = resolve_class(cfg["actor"])
    actor: Any = actor_class(obs, cfg["obs_groups"], "actor", env.num_actions, **options)
    critic_class, options = resolve_class(cfg["critic"])
    options |= {"num_actions": env.num_actions, "num_atoms": algorithm.num_atoms, "value_limit": algorithm.value_limit}
    critic: Any = critic_class(obs, cfg["obs_groups"], "critic", **options)
    groups = {name: obs[name].shape[-1] for part in cfg["obs_groups"].values() for name in part}
    return cls(actor, critic, groups, env, algorithm, cfg["num_steps_per_env"] * cfg["max_iterations"], device)

  # The parts of a subclass.

  @abstractmethod
  def round(self) -> None:
    """Update the critic `cfg.policy_every` times and the policy once."""

  @abstractmethod
  def parameter_groups(self) -> list[dict[str, Any]]:
    """Return the groups of parameters of the optimiser."""

  @abstractmethod
  def figures(self) -> dict[str, torch.Tensor]:
    """Return figures of the last round by name, 0-d tensors on the device."""

  # Collection.

  @torch.no_grad()
  def collect(self, env: Any, obs: TensorDict) -> tuple[TensorDict, torch.Tensor, torch.Tensor]:
    """Make one step of all worlds and keep it; return observations, rewards and dones.

    Raises:
      ConfigError: The environment does not give the last observations of episodes that run out of time.
    """
    seen = self._flat(obs)
    self.actor.learn_statistics(self.of_actor(seen))
    self.critic.learn_statistics(self.of_critic(seen))
    self.actor.eval()
    output = self.actor.output(self.of_actor(seen))
    self.actor.squash.update(output)
    action = self.actor.squash.act(output, self.noise.next())
    obs, rewards, dones, extras = env.step(action)
    timed_out = extras.get("time_outs")
    following = self._flat(obs)
    if timed_out is None:
      timed_out = torch.zeros_like(dones, dtype=torch.bool)
    elif (final := extras.get("final_obs")) is None:
      raise ConfigError('an off-policy learner needs extras["final_obs"] of a step; the environment does not give it')
    else:
      following = torch.where(timed_out[:, None], self._flat(final), following)
    if self.scale is not None:
      self.scale.add(rewards, dones)
    self.replay.add(seen, action, rewards, following, (dones > 0) & ~timed_out, timed_out)
    self.steps_done += 1
    return obs, rewards, dones

  def _flat(self, obs: Any) -> torch.Tensor:
    return torch.cat([obs[name] for name in self._groups], -1)

  # Updates.

  def update(self) -> None:
    """Make the rounds that are due after a step."""
    if not self.replay.is_ready(max(self.cfg.learning_starts, self.cfg.n_step)):
      return
    self._due += self.cfg.updates_per_step / self.cfg.policy_every
    while self._due >= 1.0:
      self._due -= 1.0
      self._recorded_round()
      self.rounds_done += 1
      self._share_statistics()

  def _share_statistics(self) -> None:
    """Give the batch normalisations of all processes the means of their statistics."""
    if distributed.is_initialized():
      layers = [layer for part in self._parts for layer in part.modules() if isinstance(layer, BatchNorm1d)]
      values = [value for layer in layers for value in (layer.running_mean, layer.running_var) if value is not None]
      for value, mean in zip(values, averaged(values), strict=True):
        value.copy_(mean)

  def sample(self) -> Transitions:
    """Draw a batch, with mirror images after it, and rewards in the scale of the critic."""
    batch = self.replay.sample(self.cfg.batch_size, self.cfg.n_step, self.cfg.gamma)
    if self.scale is not None:
      batch = replace(batch, reward=batch.reward / self.scale.divisor())
    return batch if self.reflection is None else self.reflection(batch)

  def of_actor(self, obs: torch.Tensor) -> torch.Tensor:
    """Return the columns of observations that the policy sees."""
    return _take(obs, self._actor_columns)

  def of_critic(self, obs: torch.Tensor) -> torch.Tensor:
    """Return the columns of observations that the critic sees."""
    return _take(obs, self._critic_columns)

  def step(self, loss: torch.Tensor, parameters: Sequence[torch.Tensor]) -> None:
    """Step these parameters along the gradient of a loss, averaged over all processes."""
    gradients = averaged(torch.autograd.grad(loss, parameters))
    for parameter, gradient in zip(parameters, gradients, strict=True):
      parameter.grad = gradient
    self.optimizer.step()
    for parameter in parameters:
      parameter.grad = None

  @cached_property
  def optimizer(self) -> torch.optim.AdamW:
    """Optimiser of the subclass's `parameter_groups`."""
    options: dict[str, Any] = {"lr": self._lr, "betas": self.cfg.betas, "weight_decay": self.cfg.weight_decay}
    return torch.optim.AdamW(self.parameter_groups(), fused=True, capturable=self.device.type == "cuda", **options)

  def set_learning_rate(self) -> None:
    """Set the step size for the steps done so far."""
    start, end = self.cfg.learning_rate, self.cfg.final_learning_rate
    progress = min(1.0, self.steps_done / max(1, self.total_steps))
    last = start if end is None else end
    self.learning_rate = last + 0.5 * (start - last) * (1.0 + math.cos(math.pi * progress))
    self._lr.fill_(self.learning_rate)

  # State, under the names of rsl-rl's algorithms.

  @property
  def _parts(self) -> list[torch.nn.Module]:
    return [self.actor, self.critic, *self.modules.values()]

  @property
  def worlds(self) -> dict[str, torch.Tensor]:
    """State of each world, which is saved with the replay memory."""
    running = {} if self.scale is None else {"running": self.scale.running}
    return {"noise": self.noise.noise, "left": self.noise.left, **running}

  def save(self) -> dict[str, Any]:
    """Return the state without the replay memory."""
    return {
      "actor_state_dict": self.actor.state_dict(),
      "critic_state_dict": self.critic.state_dict(),
      "optimizer_state_dict": self.optimizer.state_dict(),
      "algorithm_state_dict": {
        "rounds_done": self.rounds_done,
        "due": self._due,
        "steps_done": self.steps_done,
        "modules": {name: part.state_dict() for name, part in self.modules.items()},
      },
    }

  def load(self, state: Mapping[str, Any], load_cfg: Mapping[str, bool] | None, strict: bool) -> bool:
    """Restore the parts of a `save` that are wanted, all by default; return True if iterations count on."""
    wanted = load_cfg or {"actor": True, "critic": True, "optimizer": True, "iteration": True}
    for name in ("actor", "critic"):
      if wanted.get(name):
        getattr(self, name).load_state_dict(state[f"{name}_state_dict"], strict=strict)
    if wanted.get("optimizer"):
      # Settings are those of this run.
      groups = self.optimizer.state_dict()["param_groups"]
      self.optimizer.load_state_dict({**state["optimizer_state_dict"], "param_groups": groups})
      for group in self.optimizer.param_groups:
        # Loading copies the tensor that a recording reads.
        group["lr"] = self._lr
      own = state["algorithm_state_dict"]
      self.rounds_done, self._due, self.steps_done = own["rounds_done"], own["due"], own["steps_done"]
      self.set_learning_rate()
      for name, part in self.modules.items():
        part.load_state_dict(own["modules"][name])
    self._recorded_round.clear()
    return bool(wanted.get("iteration"))

  def get_policy(self) -> Actor:
    """Return the policy."""
    return self.actor

  def train_mode(self) -> None:  # noqa: B027
    """Do nothing; updates and collection set the mode."""

  def eval_mode(self) -> None:
    """Put both networks into evaluation mode."""
    self.actor.eval()
    self.critic.eval()

  def compile(self, mode: str | None) -> None:  # noqa: B027
    """Do nothing; a GPU records the updates as a graph."""

  def broadcast_parameters(self) -> None:
    """Give all processes the networks of the first."""
    for part in self._parts:
      for value in part.state_dict().values():
        distributed.broadcast(value, src=0)


def averaged(tensors: Sequence[torch.Tensor]) -> Sequence[torch.Tensor]:
  """Return the means of tensors over all processes, with one message."""
  if not tensors or not distributed.is_initialized():
    return tensors
  flat = torch.cat([tensor.flatten() for tensor in tensors])
  distributed.all_reduce(flat)
  parts = (flat / distributed.get_world_size()).split([tensor.numel() for tensor in tensors])
  return [part.view_as(tensor) for part, tensor in zip(parts, tensors, strict=True)]


def action_bounds(env: Any, num_actions: int, cfg: SacCfg) -> torch.Tensor:
  """Return the largest absolute value of each action, (1, num_actions).

  The action terms of an environment that know the limits of their joints have `reach`; others get `cfg.action_bound`.
  """
  bounds = torch.full((1, num_actions), cfg.action_bound)
  slices = getattr(env.action_manager, "term_slices", dict)() if cfg.joint_limits else {}
  for name, columns in slices.items():
    reach = getattr(env.action_manager.get_term(name), "reach", None)
    if reach is not None:
      bounds[:, columns] = torch.where(reach.isfinite(), reach, cfg.action_bound).cpu().float()
  return bounds


def _take(obs: torch.Tensor, columns: Sequence[slice]) -> torch.Tensor:
  return obs[:, columns[0]] if len(columns) == 1 else torch.cat([obs[:, part] for part in columns], -1)
