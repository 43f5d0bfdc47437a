"""Stepping of an environment under a policy, in real time."""

from __future__ import annotations

import logging
import queue
import time
import traceback
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from mjlab_core.policies import Policy

from mjlab_viewer.env import ViewedEnv

_log = logging.getLogger("mjlab")

SPEEDS = tuple(2.0**power for power in range(-5, 4))
"""Speeds to choose from, relative to real time."""

LONGEST_BURST = 1 / 30
"""Wall time that one `tick` may spend on steps [s]; steps that are due beyond it are dropped."""

# Time over which the real-time factor is measured [s].
_MEASURED = 0.5


class Playback:
  """Environment that runs under a policy, in real time, slower or faster.

  The thread that owns the environment calls `tick` regularly, which does the steps that are due. Other threads use
  `request`. An error in the policy, in the environment or in a request pauses; it stays in `error` until `resume` or
  `reset`.

  Args:
    env: The environment; its worlds are reset.
    policy: The policy that acts.
    clock: Function that returns the time [s].
  """

  def __init__(self, env: ViewedEnv, policy: Policy, *, clock: Callable[[], float] = time.perf_counter) -> None:
    self.env = env
    self.policy = policy
    self.speed = 1.0
    """Seconds of simulated time for each second of the clock."""
    self.paused = False
    self.error: str | None = None
    """Error that paused, one line, or None."""
    self.step_count = 0
    """Steps since the last reset of all worlds."""
    self.total_steps = 0
    """Steps since the start."""
    self.is_capped = False
    """True if the machine is too slow for `speed`, so that the last tick dropped time."""
    self.on_step: list[Callable[[], None]] = []
    """Called after every step."""
    self.clock = clock
    """Time [s]; viewers take theirs from here."""
    self._last: float | None = None
    self._budget = 0.0
    self._requests: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
    self._history: deque[tuple[float, int]] = deque()
    self.reset()

  @property
  def real_time_factor(self) -> float:
    """Seconds of simulated time for each second of the clock, measured over the last half second."""
    if len(self._history) < 2:
      return 0.0
    (begin, first), (end, last) = self._history[0], self._history[-1]
    return (last - first) * self.env.step_dt / (end - begin) if end > begin else 0.0

  @property
  def state(self) -> str:
    """Speed of the simulated time, or "paused", for users."""
    if self.paused:
      return "paused"
    capped = f" (this machine is too slow for {self.speed:g})" if self.is_capped else ""
    return f"{self.real_time_factor:.2g} x real time{capped}"

  def request(self, action: Callable[[], None]) -> None:
    """Call `action` in the thread that ticks, before its next step. Any thread may ask."""
    self._requests.put(action)

  def tick(self) -> int:
    """Handle requests, do the steps that are due, and return their number."""
    self._handle_requests()
    now = self.clock()
    elapsed = 0.0 if self._last is None else now - self._last
    self._last = now
    if self.paused:
      self._budget = 0.0
      self._history.clear()
      return 0
    self._budget += elapsed * self.speed
    steps = 0
    # The tolerance covers rounding: without it, a sum that falls short by 1e-17 delays a step.
    while self._budget >= self.env.step_dt - 1e-9 and not self.paused:
      if steps and self.clock() - now >= LONGEST_BURST:
        break
      self._budget -= self.env.step_dt
      steps += self._step()
    self.is_capped = self._budget >= self.env.step_dt
    if self.is_capped:
      self._budget %= self.env.step_dt
    self._measure(now)
    return steps

  def run(self, update: Callable[[], None], until: Callable[[], bool]) -> None:
    """Do the steps that are due, and `update` a viewer, until `until` returns True."""
    while not until():
      steps = self.tick()
      update()
      if not steps:
        time.sleep(0.002)

  def step_once(self) -> None:
    """Do one step, while paused."""
    if self.paused:
      self.error = None
      self._step()

  def resume(self) -> None:
    """Continue, and forget an error."""
    self.error, self.paused = None, False

  def pause(self) -> None:
    """Stop stepping."""
    self.paused = True

  def toggle(self) -> None:
    """Pause, or continue and clear the error."""
    if self.paused:
      self.resume()
    else:
      self.pause()

  def fail(self, what: str, error: Exception) -> None:
    """Pause for an error, and keep it as one line."""
    line = one_line(what, error)
    if line != self.error:
      _log.warning("paused: %s", line)
      _log.info("%s", "".join(traceback.format_exception(error)))
    self.error, self.paused = line, True

  def reset(self) -> None:
    """Reset all worlds. After an error, forget it and continue."""
    if self.error is not None:
      self.resume()
    self._guard("reset", self._reset)

  def faster(self, by: int = 1) -> None:
    """Take the next greater speed, or for -1 the next smaller one."""
    nearest = min(range(len(SPEEDS)), key=lambda i: abs(SPEEDS[i] - self.speed))
    self.speed = SPEEDS[max(0, min(len(SPEEDS) - 1, nearest + by))]

  def set_policy(self, policy: Policy) -> None:
    """Continue under another policy, from its initial state."""
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
    # Requests that arrive during this tick wait for the next one.
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
  """Return an error as one line, with the part that failed."""
  return f"{what}: {type(error).__name__}: {' '.join(str(error).split()) or 'no message'}"


@dataclass(kw_only=True, frozen=True)
class CheckpointList:
  """Checkpoints of a run that a user can choose from."""

  names: Callable[[], Sequence[str]]
  """Return the present names, oldest first; called again for each refresh."""
  load: Callable[[str], Policy]
  """Return the policy of a name, or raise an error that says why it cannot be loaded."""
  loaded: str
  """Name of the first policy; it need not be one of `names`."""
