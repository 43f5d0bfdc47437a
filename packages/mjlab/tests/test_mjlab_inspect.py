"""`inspect-dr`: draws and effects of events beside their requests."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import mjlab
import mjlab.registry as registry
import mjlab_pendulum
import pytest
import torch
from mjlab import cli
from mjlab_dr import Categorical, Custom, FieldRandomizer, body_mass, pseudo_inertia, randomize_field
from mjlab_envs import mdp
from mjlab_managers import EventTermCfg

TASK = "Test-Randomised-Pendulum"


def raise_ctrl(env: Any, mask: torch.Tensor, *, height: tuple[float, float]) -> None:
  env.sim.data.qvel[:] = torch.linspace(*height, env.num_envs)[:, None].to(env.sim.data.qvel.dtype)


def offer(monkeypatch: pytest.MonkeyPatch, **randomizers: FieldRandomizer) -> None:
  def task():
    cfg = mjlab_pendulum.pendulum()
    cfg.env.events |= {
      name: EventTermCfg(mdp.randomize, mode="reset", params={"randomizer": randomizer})
      for name, randomizer in randomizers.items()
    }
    limit = {"randomizer": randomize_field("effort_limit", ".*", (0.8, 1.2))}
    cfg.env.events["effort"] = EventTermCfg(mdp.randomize, mode="reset", params=limit)
    (robot,) = cfg.env.scene.entities.values()
    articulation: Any = robot.articulation
    (motor,) = articulation.actuators
    articulation.actuators = (replace(motor, delay_min_lag=0, delay_max_lag=3),)
    lag = {"randomizer": randomize_field("delay", ".*", Categorical((1, 2, 3)))}
    cfg.env.events["late"] = EventTermCfg(mdp.randomize, mode="reset", params=lag)
    cfg.env.events["raise"] = EventTermCfg(raise_ctrl, mode="reset", params={"height": (2.0, 3.0)})
    cfg.env.events["nothing"] = EventTermCfg(lambda env, mask: None, mode="step")
    return cfg

  monkeypatch.setattr(registry, "_registered", {})
  mjlab.register_task(TASK, task)


def inspect(*flags: str) -> int:
  return cli.main(["inspect-dr", TASK, "--num-envs", "200", *flags])


def test_every_event_is_shown_with_draws_and_request(
  monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
  damping = randomize_field("dof_damping", "hinge", (0.5, 2.0), operation="scale", distribution="log_uniform")
  offer(monkeypatch, inertia=pseudo_inertia("pole", scale=0.2), damping=damping)
  picture = tmp_path / "events.png"
  assert inspect("--png", str(picture)) == 0
  shown = capsys.readouterr().out
  rows = [line.split() for line in shown.splitlines()]
  assert sum(row[-2:] == ["as", "asked"] for row in rows) == 10
  (damping_row,) = [row for row in rows if row[0] == "damping"]
  assert damping_row[1:5] == ["reset", "dof_damping", "hinge", "scale"]
  least, mean, most = (float(cell) for cell in damping_row[-5:-2])
  assert 0.5 <= least < 0.6 < mean < 1.9 < most <= 2.0
  assert ["nothing", "step", "-", "NOTHING", "CHANGED"] in rows
  # An event without distributions shows its parameters and what it wrote.
  (raised,) = [row for row in rows if row[0] == "raise"]
  assert raised == "raise reset qvel 1 height: (2.0, 3.0) 2 2.5 3 differs between worlds".split()
  (effort,) = [row for row in rows if row[0] == "effort"]
  assert effort[1:6] == ["reset", "effort_limit", "hinge", "scale", "Uniform(lo=0.8,"]
  assert 0.8 <= float(effort[-5]) < 0.81 < 1.19 < float(effort[-3]) <= 1.2
  (late,) = [line for line in shown.splitlines() if line.startswith("late ")]
  assert "absolute Categorical(values=(1, 2, 3), weights=None)" in late
  assert late.split()[-5::2] == ["1", "3", "asked"]
  assert "as compiled 0.2" in shown
  assert picture.read_bytes().startswith(b"\x89PNG")
  assert [path.name for path in tmp_path.iterdir()] == ["events.png"]


def test_a_draw_without_effect_or_unlike_its_request_is_in_capitals_and_fails(
  monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
  calls = []

  def stuck(shape, *, generator, device, dtype) -> torch.Tensor:
    calls.append(shape)
    # Alike for all worlds of the environment, while many are asked for at once to compare with.
    return torch.full(shape, 1.2, device=device, dtype=dtype) if len(shape) == 2 else torch.linspace(0.5, 1.5, shape[0])

  offer(monkeypatch, mass=body_mass("pole", Custom(stuck, 0.5, 1.5), operation="scale"))
  assert inspect() == 1
  assert "NOTHING DIFFERS" in capsys.readouterr().out

  offer(monkeypatch, mass=body_mass("pole", (1.0, 1.0), operation="scale"), damping=damping_of(3.0))
  assert inspect() == 1
  rows = {row[0]: row for row in map(str.split, capsys.readouterr().out.splitlines())}
  assert rows["mass"][-2:] == ["NOTHING", "CHANGES"]
  # Alike in all worlds as it was asked to be.
  assert rows["damping"][-2:] == ["as", "asked"]

  def low(shape, *, generator, device, dtype) -> torch.Tensor:
    draw = torch.rand(shape, generator=generator, device=device, dtype=dtype)
    return 0.5 + (0.5 if len(shape) == 2 else 1.0) * draw

  offer(monkeypatch, mass=body_mass("pole", Custom(low, 0.5, 1.5), operation="scale"))
  assert inspect() == 1
  assert "NOT AS ASKED" in capsys.readouterr().out


def damping_of(value: float) -> FieldRandomizer:
  return randomize_field("dof_damping", "hinge", (value, value))


def test_a_task_that_cannot_be_built_is_an_error_of_one_line(
  monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
  offer(monkeypatch, mass=body_mass("pol", (0.1, 0.2)))
  assert inspect() == 1
  assert "pattern 'pol' matches no body. Nearest: pole" in capsys.readouterr().err
