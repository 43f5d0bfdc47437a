"""Returns and lengths of the last finished episodes, kept on the device."""

import torch

WINDOW = 100


class EpisodeStatistics:
  """Means over the last 100 finished episodes, the window of rsl-rl's curves, without a host sync per step.

  Episodes that end in the same step enter in the order of their worlds.
  """

  def __init__(self, num_envs: int, device: torch.device | str):
    self._return = torch.zeros(num_envs, device=device)
    self._length = torch.zeros(num_envs, device=device)
    # The last column takes all other values, so that the scatter has a fixed shape.
    self._window = torch.zeros(2, WINDOW + 1, device=device)
    self._finished = torch.zeros((), dtype=torch.int64, device=device)

  def add(self, rewards: torch.Tensor, dones: torch.Tensor) -> None:
    """Account for one step; rewards (num_envs,), dones (num_envs,) nonzero where the episode ended."""
    self._return += rewards
    self._length += 1.0
    done = dones > 0
    order = done.cumsum(0)
    count = order[-1]
    slot = torch.where(done & (order > count - WINDOW), (self._finished + order - 1) % WINDOW, WINDOW)
    ended = torch.stack((self._return, self._length))
    self._window.scatter_(1, slot.expand(2, -1), ended)
    self._finished += count
    self._return.masked_fill_(done, 0.0)
    self._length.masked_fill_(done, 0.0)

  def means(self) -> tuple[float, ...]:
    """Return (mean return, mean length in steps), with a wait for the device; () before the first episode end."""
    count = min(int(self._finished), WINDOW)
    return tuple(self._window[:, :count].double().mean(1).tolist()) if count else ()

  def state_dict(self) -> dict[str, torch.Tensor]:
    """Return copies of all tensors."""
    return {name.removeprefix("_"): value.clone() for name, value in vars(self).items()}

  def load_state_dict(self, state: dict[str, torch.Tensor], *, same_worlds: bool = True) -> None:
    """Restore in place; without `same_worlds` only the window, and running episodes start at zero."""
    for name in ("window", "finished") + (("return", "length") if same_worlds else ()):
      getattr(self, f"_{name}").copy_(state[name])
    if not same_worlds:
      self._return.zero_()
      self._length.zero_()
