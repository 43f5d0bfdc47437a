"""Recorders: which hooks run, and when they cost nothing."""

from typing import Any

import pytest
import torch
from mjlab_core.errors import ConfigError
from mjlab_managers import RecorderManager, RecorderTerm, RecorderTermCfg


class Recorder(RecorderTerm):
  def __init__(self, env: Any, *, path: str = "") -> None:
    super().__init__(env)
    self.path = path
    self.seen: list[Any] = []

  def pre_reset(self, mask: torch.Tensor) -> None:
    self.seen.append(("pre", mask.tolist(), self.env.values[0, 0].item()))

  def close(self) -> None:
    self.seen.append("closed")


def test_hooks_run_outside_the_recording_and_only_those_that_exist(env):
  manager = RecorderManager({"rec": RecorderTermCfg(Recorder, params={"path": "x"})}, env)
  manager.pre_reset(env.mask(1))
  manager.post_reset(env.mask(1))
  manager.post_step()
  manager.close()
  recorder = manager.get_term("rec")
  assert isinstance(recorder, Recorder)
  assert recorder.seen == [("pre", [False, True, False, False], 0.0), "closed"]
  assert env.eager == ["recorders rec (pre_reset)"]


def test_a_function_is_no_recorder(env):
  with pytest.raises(ConfigError, match="must be a subclass of RecorderTerm"):
    RecorderManager({"rec": RecorderTermCfg(print)}, env)
