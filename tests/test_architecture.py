"""The example of docs/architecture.md is a task that runs."""

import re
from pathlib import Path
from typing import Any

import pytest
import torch
from mjlab import make, register_task, registry

ARCHITECTURE = Path(__file__).parents[1] / "docs" / "architecture.md"


def test_terms_of_the_example_have_the_described_values(monkeypatch: pytest.MonkeyPatch) -> None:
  (block,) = re.findall(r"```python\n(.*?)```", ARCHITECTURE.read_text(encoding="utf-8"), re.DOTALL)
  names: dict[str, Any] = {"__name__": "example"}
  exec(compile(block, str(ARCHITECTURE), "exec"), names)
  monkeypatch.setattr(registry, "_registered", {})
  register_task("Example", names["hold"])
  with make("Example", num_envs=2, device="cpu") as env:
    env.reset(seed=0)
    speeds = [torch.zeros(2)]
    for action in (1.0, -1.0, 0.0):
      env.step(torch.full((2, 1), action))
      speeds.append(env.scene["robot"].data.joint_vel[:, 0].abs().float())
    peak = env.reward_manager.term("peak_speed")
    torch.testing.assert_close(peak(), torch.stack(speeds).amax(0))
    env.reset(env_ids=[1])
    assert (peak() > 0).tolist() == [True, False]
    angle = env.scene["robot"].data.joint_pos[:, 0]
    expected = torch.exp(-((angle - 0.5) ** 2) / 0.2**2)
    torch.testing.assert_close(env.reward_manager.term("at_angle")(), expected)
