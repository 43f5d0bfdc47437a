"""Replay memory on the device: past steps of all worlds, random n-step transitions, and their mirror images."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch

_HALF_MAX = 65504.0
# Bits of the marks of a row.
_TERMINATED, _TIMED_OUT, _FINAL = 1, 2, 4


@dataclass(frozen=True)
class Transitions:
  """Batch of n-step transitions."""

  obs: torch.Tensor
  """Observation at the start, (batch, obs width) float32."""
  action: torch.Tensor
  """Action there, (batch, num_actions) float32."""
  reward: torch.Tensor
  """Discounted sum of the rewards up to the end of the transition, (batch,)."""
  discount: torch.Tensor
  """Weight of the value at the end: gamma^m after m steps, 0 after a termination, (batch,)."""
  next_obs: torch.Tensor
  """Observation at the end, before a reset, (batch, obs width) float32."""


class Replay:
  """The last steps of all worlds as rows, time-major: row t * num_envs + w is step t of world w.

  A row holds the observation before a step, the action, the reward and marks. The next row of the world has the
  observation after the step, so that each is stored once. The last observation of an episode that ran out of time has
  an additional row, which starts no transition. Therefore each world has a separate pointer. Nothing waits for the
  device, and all shapes are fixed, so that a CUDA graph can record `sample`.

  Args:
    num_envs: Number of worlds.
    num_steps: Rows of each world; the oldest are overwritten.
    obs_dim: Width of observations, all groups side by side.
    num_actions: Width of actions.
    device: Device of the memory.
    is_half: Store observations and actions as float16 instead of float32.
  """

  def __init__(
    self,
    num_envs: int,
    num_steps: int,
    obs_dim: int,
    num_actions: int,
    device: torch.device | str,
    *,
    is_half: bool = False,
  ) -> None:
    self.num_envs, self.num_steps, self.obs_dim = num_envs, num_steps, obs_dim
    rows = num_steps * num_envs
    dtype = torch.float16 if is_half else torch.float32
    self._rows = torch.zeros(rows, obs_dim + num_actions, dtype=dtype, device=device)
    self._reward = torch.zeros(rows, device=device)
    self._marks = torch.zeros(rows, dtype=torch.uint8, device=device)
    self._world = torch.arange(num_envs, device=device)
    self._count = torch.zeros(num_envs, dtype=torch.int64, device=device)
    self.steps_added = 0
    """Steps added so far, the same for all worlds; kept on the host."""

  @property
  def num_bytes(self) -> int:
    """Memory of the rows [B]."""
    return sum(part.numel() * part.element_size() for part in (self._rows, self._reward, self._marks))

  def add(
    self,
    obs: torch.Tensor,
    action: torch.Tensor,
    reward: torch.Tensor,
    next_obs: torch.Tensor,
    terminated: torch.Tensor,
    timed_out: torch.Tensor,
  ) -> None:
    """Add one step of all worlds.

    Args:
      obs: Observations before the step, (num_envs, obs_dim).
      action: Actions, (num_envs, num_actions).
      reward: Rewards, (num_envs,).
      next_obs: Observations after it, before the reset where `timed_out`; elsewhere the next call gives them again.
      terminated: Worlds with a terminated episode, bool (num_envs,).
      timed_out: Worlds with an episode that was cut and not terminated, bool (num_envs,).
    """
    row = self._row(self._count)
    following = self._row(self._count + 1)
    for index, seen in ((row, obs), (following, next_obs)):
      self._rows[index, : self.obs_dim] = self._stored(seen)
    self._rows[row, self.obs_dim :] = self._stored(action)
    self._reward[row] = reward
    self._marks[row] = (terminated * _TERMINATED + timed_out * _TIMED_OUT).to(torch.uint8)
    self._marks[following] = (timed_out * _FINAL).to(torch.uint8)
    self._count += 1 + timed_out.to(torch.int64)
    self.steps_added += 1

  def is_ready(self, num_steps: int) -> bool:
    """Return True if every world has transitions of `num_steps` steps."""
    return self.steps_added > num_steps

  def sample(self, batch_size: int, num_steps: int, gamma: float) -> Transitions:
    """Draw transitions of up to `num_steps` steps, from all worlds alike.

    A transition ends before `num_steps` where the episode ends. The step that runs out of time is drawn twice as often
    as others, because the row after it starts no transition.

    Args:
      batch_size: Number of transitions.
      num_steps: Most steps of one.
      gamma: Discount of a step.
    """
    device = self._rows.device
    world = torch.randint(self.num_envs, (batch_size,), device=device)
    count = self._count[world]
    # The row after the newest has an observation only. Of the oldest row, the one before may be gone.
    first = (count - self.num_steps + 1).clamp(min=0)
    span = count - num_steps - first
    draw = torch.rand(batch_size, device=device, dtype=torch.float64)
    start = first + (draw * span).long() + 1
    start = start - ((self._marks[self._row(start, world)] & _FINAL) > 0).long()

    reward = torch.zeros(batch_size, device=device)
    discount = torch.ones(batch_size, device=device)
    is_terminated = torch.zeros(batch_size, dtype=torch.bool, device=device)
    is_running = torch.ones(batch_size, dtype=torch.bool, device=device)
    end = start.clone()
    for _ in range(num_steps):
      row = self._row(end, world)
      marks = self._marks[row]
      reward += torch.where(is_running, discount * self._reward[row], 0.0)
      discount *= torch.where(is_running, gamma, 1.0)
      end += is_running.long()
      is_terminated |= is_running & ((marks & _TERMINATED) > 0)
      is_running &= (marks & (_TERMINATED | _TIMED_OUT)) == 0
    both = torch.cat((self._row(start, world), self._row(end, world)))
    found = self._rows.index_select(0, both).float()
    return Transitions(
      obs=found[:batch_size, : self.obs_dim],
      action=found[:batch_size, self.obs_dim :],
      reward=reward,
      discount=torch.where(is_terminated, 0.0, discount),
      next_obs=found[batch_size:, : self.obs_dim],
    )

  def state_dict(self) -> dict[str, Any]:
    """Return the filled rows and the pointers; the rows are views of the memory."""
    used = min(self.num_steps, int(self._count.max()) + 1) * self.num_envs
    return {
      "num_steps": self.num_steps,
      "steps_added": self.steps_added,
      "count": self._count,
      "rows": self._rows[:used],
      "reward": self._reward[:used],
      "marks": self._marks[:used],
    }

  def load_state_dict(self, state: Mapping[str, Any]) -> None:
    """Restore a `state_dict` of a memory of the same sizes."""
    self.steps_added = int(state["steps_added"])
    self._count.copy_(state["count"])
    for name in ("rows", "reward", "marks"):
      saved = state[name]
      getattr(self, f"_{name}")[: len(saved)].copy_(saved)

  def problem(self, state: Mapping[str, Any]) -> str | None:
    """Return why a `state_dict` does not fit; None if it does."""
    theirs = (state["num_steps"], len(state["count"]), state["rows"].shape[1], state["rows"].dtype)
    ours = (self.num_steps, self.num_envs, self._rows.shape[1], self._rows.dtype)
    names = ("steps", "worlds", "columns", "precision")
    wrong = [f"{name} {a}, now {b}" for name, a, b in zip(names, theirs, ours, strict=True) if a != b]
    return "; ".join(wrong) or None

  def _row(self, count: torch.Tensor, world: torch.Tensor | None = None) -> torch.Tensor:
    return count % self.num_steps * self.num_envs + (self._world if world is None else world)

  def _stored(self, value: torch.Tensor) -> torch.Tensor:
    if self._rows.dtype == torch.float16:
      value = value.clamp(-_HALF_MAX, _HALF_MAX)
    return value.to(self._rows.dtype)


Mirror = tuple[Sequence[int], Sequence[float]]
"""Columns and signs: column i of the mirror image is column `columns[i]` times `signs[i]`."""


class Reflection:
  """Mirror images of transitions.

  Args:
    mirrors: Mirror by observation group, and "action".
    groups: Observation groups in the order of their columns.
    device: Device of the observations.
  """

  def __init__(self, mirrors: Mapping[str, Mirror], groups: Sequence[str], device: torch.device | str) -> None:
    columns: list[int] = []
    signs: list[float] = []
    for group in groups:
      start = len(columns)
      columns += [start + column for column in mirrors[group][0]]
      signs += mirrors[group][1]
    self._obs, self._action = (
      [torch.tensor(part, device=device) for part in mirror] for mirror in ((columns, signs), mirrors["action"])
    )

  def __call__(self, batch: Transitions) -> Transitions:
    """Return transitions and after them their mirror images, (2 batch, ...)."""

    def both(values: torch.Tensor, mirror: Sequence[torch.Tensor]) -> torch.Tensor:
      columns, signs = mirror
      return torch.cat((values, values[:, columns] * signs))

    return Transitions(
      obs=both(batch.obs, self._obs),
      action=both(batch.action, self._action),
      reward=batch.reward.repeat(2),
      discount=batch.discount.repeat(2),
      next_obs=both(batch.next_obs, self._obs),
    )
