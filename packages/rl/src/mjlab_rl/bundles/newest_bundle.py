"""The newest policy of a training as a bundle beside its checkpoints."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from mjlab_core import printable

from mjlab_rl.config import RslRlBaseRunnerCfg
from mjlab_rl.reports.console import Console

if TYPE_CHECKING:
  from mjlab_rl.bundles.policy_bundle import BundleWriter


class NewestBundle:
  """Keeper of `bundle` beside the checkpoints of a training, with the newest policy and without a record.

  The first one is written with the first checkpoint at `agent.save_interval`: it takes seconds, later ones a fraction
  of one. `export` writes one for a shorter training.

  Args:
    env: Environment of the training.
    agent: Configuration of the learner.
    task: Task id.
    network: Returns the policy's network.
    console: Says once if the policy cannot be exported.
  """

  def __init__(
    self, env: Any, agent: RslRlBaseRunnerCfg, task: str, network: Callable[[], Any], console: Console
  ) -> None:
    self._parts, self._network, self._console = (env, agent, task), network, console
    self._interval = agent.save_interval
    self._writer: BundleWriter | None = None
    self._is_refused = False

  def __call__(self, checkpoint: Path) -> None:
    """Write the bundle for a checkpoint that was just saved, model_N.pt."""
    iterations = int(checkpoint.stem.rpartition("_")[2])
    if self._is_refused or (self._writer is None and iterations % self._interval):
      return
    try:
      if self._writer is None:
        # Imported here, because the exporter is heavy.
        from mjlab_rl.bundles.policy_bundle import BundleWriter

        self._writer = BundleWriter(*self._parts)
      training = {"checkpoint": checkpoint.name, "iterations": iterations}
      with torch.random.fork_rng(devices=[]):
        self._writer.write(checkpoint.parent / "bundle", self._network(), training=training)
    except Exception as error:
      # A policy that cannot be exported can still be trained.
      self._is_refused = True
      self._console.say(f"no policy bundle is written: {printable(error, 400)}")
