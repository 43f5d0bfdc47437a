"""Stepping worlds in the time of the one who watches."""

from __future__ import annotations

import logging
import queue
import time
import traceback
from collections import deque
from collections.abc import Callable

import torch

from mjlab_viewer.worlds import PlayedEnv, Policy

_log = logging.getLogger("mjlab")

SPEEDS = tuple(2.0**power for power in range(-5, 4))
"""Speeds to choose from, relative to real time: 1/32 to 8."""

LONGEST_BURST = 1 / 30
"""Wall time that one `tick` may spend on steps [s]; what is due beyond it is dropped."""

_MEASURED = 0.5


class Playback:
  """An environment that runs under a policy, in real time, slower or faster.

  `tick` is called again and again by the thread that owns the environment, and does what is due by then. Everybody
  else asks for things with `request`. An error in the policy, in the environment or in a request pauses; it is kept in
  `error` until somebody resumes or resets.

  Args:
    env: The environment; its worlds are reset.
    policy: Who acts.
    clock: Time [s].
  """

  def __init__(self, env: PlayedEnv, policy: Policy, *, clock: Callable[[], float] = time.perf_counter) -> None:
    self.env = env
    self.policy = policy
    self.speed = 1.0
    """Seconds of the worlds for each of the clock."""
    self.paused = False
    self.error: str | None = None
    """What went wrong, one line; None if nothing did."""
    self.step_count = 0
    """Steps since the last reset of all worlds."""
    self.total_steps = 0
    """Steps since the beginning."""
    self.is_capped = False
    """Whether the machine is too slow for `speed`: time was dropped in the last tick."""
    self.on_step: list[Callable[[], None]] = []
    """Called after every step."""
    self._clock = clock
    self._last: float | None = None
    self._budget = 0.0
    self._requests: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
    self._history: deque[tuple[float, int]] = deque()
    self.reset()

  @property
  def real_time_factor(self) -> float:
    """Seconds of the worlds for each of the clock, measured over the last half second."""
    if len(self._history) < 2:
      return 0.0
    (begin, first), (end, last) = self._history[0], self._history[-1]
    return (last - first) * self.env.step_dt / (end - begin) if end > begin else 0.0

  def request(self, action: Callable[[], None]) -> None:
    """Have something done by the thread that ticks, before its next step. From any thread."""
    self._requests.put(action)

  def tick(self) -> int:
    """Do what was asked for and what is due; returns the number of steps done."""
    self._handle_requests()
    now = self._clock()
    elapsed = 0.0 if self._last is None else now - self._last
    self._last = now
    if self.paused:
      self._budget = 0.0
      self._history.clear()
      return 0
    self._budget += elapsed * self.speed
    steps = 0
    # A hair early rather than a step late: sums of floats fall short of what they should be.
    while self._budget >= self.env.step_dt - 1e-9 and not self.paused:
      if steps and self._clock() - now >= LONGEST_BURST:
        break
      self._budget -= self.env.step_dt
      steps += self._step()
    self.is_capped = self._budget >= self.env.step_dt
    if self.is_capped:
      self._budget %= self.env.step_dt
    self._measure(now)
    return steps

  def step_once(self) -> None:
    """One step, while paused."""
    if self.paused:
      self.error = None
      self._step()

  def resume(self) -> None:
    """Go on; an error is forgotten."""
    self.error, self.paused = None, False

  def pause(self) -> None:
    """Stop stepping."""
    self.paused = True

  def fail(self, what: str, error: Exception) -> None:
    """Pause for an error, and keep it as one line."""
    said = one_line(what, error)
    if said != self.error:
      _log.warning("paused: %s", said)
      _log.info("%s", "".join(traceback.format_exception(error)))
    self.error, self.paused = said, True

  def reset(self) -> None:
    """Begin anew in all worlds; an error is forgotten, and who paused for it goes on."""
    if self.error is not None:
      self.resume()
    self._guard("reset", self._reset)

  def faster(self, by: int = 1) -> None:
    """The next greater speed, or for -1 the next smaller one."""
    nearest = min(range(len(SPEEDS)), key=lambda i: abs(SPEEDS[i] - self.speed))
    self.speed = SPEEDS[max(0, min(len(SPEEDS) - 1, nearest + by))]

  def set_policy(self, policy: Policy) -> None:
    """Go on under another policy, which remembers nothing yet."""
    self.policy = policy
    self._forget(None)

  def _reset(self) -> None:
    self.env.reset()
    self._forget(None)
    self.step_count = 0

  def _step(self) -> int:
    if not self._guard("policy or environment", self._advance):
      return 0
    self.step_count += 1
    self.total_steps += 1
    for callback in self.on_step:
      self._guard("viewer", callback)
    return 1

  def _advance(self) -> None:
    with torch.no_grad():
      actions = self.policy(self.env.get_observations())
      _, _, terminated, truncated, _ = self.env.step(actions)
      self._forget(terminated | truncated)

  def _forget(self, dones: torch.Tensor | None) -> None:
    reset = getattr(self.policy, "reset", None)
    if reset is not None:
      reset(dones)

  def _handle_requests(self) -> None:
    # Those that come in meanwhile wait for the next tick.
    for _ in range(self._requests.qsize()):
      self._guard("control", self._requests.get_nowait())

  def _guard(self, what: str, action: Callable[[], None]) -> bool:
    try:
      action()
    except Exception as error:
      self.fail(what, error)
      return False
    return True

  def _measure(self, now: float) -> None:
    self._history.append((now, self.total_steps))
    while len(self._history) > 2 and now - self._history[1][0] >= _MEASURED:
      self._history.popleft()


def one_line(what: str, error: Exception) -> str:
  """Where something went wrong, and what."""
  return f"{what}: {type(error).__name__}: {' '.join(str(error).split()) or 'no message'}"


class ZeroPolicy:
  """Zero actions, (num_envs, num_actions)."""

  def __init__(self, num_envs: int, num_actions: int, device: torch.device) -> None:
    self._actions = torch.zeros(num_envs, num_actions, device=device)

  def __call__(self, observations: object) -> torch.Tensor:
    del observations
    return self._actions


class RandomPolicy:
  """Uniform actions in [-1, 1), (num_envs, num_actions)."""

  def __init__(self, num_envs: int, num_actions: int, device: torch.device) -> None:
    self._actions = torch.zeros(num_envs, num_actions, device=device)

  def __call__(self, observations: object) -> torch.Tensor:
    del observations
    return self._actions.uniform_(-1.0, 1.0)
