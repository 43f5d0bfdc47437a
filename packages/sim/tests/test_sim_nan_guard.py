"""Memory of worlds that diverge, and their replay in MuJoCo C."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab_core import MjlabError
from mjlab_sim import NanDump, NanGuard, NanGuardCfg, Simulation, SimulationCfg
from sim_world import MakeSim, scatter
from torch.utils._python_dispatch import TorchDispatchMode

DECIMATION = 2


def run(
  sim: Simulation, guard: NanGuard, steps: int, writes: dict[tuple[int, int], Callable[[], object]] | None = None
) -> list[torch.Tensor]:
  """Run environment steps with `writes` before some physics steps, by (step, substep); return qpos before each."""
  seen = []
  for step in range(steps):
    for substep in range(DECIMATION):
      if writes and (step, substep) in writes:
        writes[step, substep]()
      seen.append(sim.data.qpos.clone())
      guard.record(substep)
      sim.step()
    guard.keep(~torch.isfinite(sim.data.qpos).all(dim=1))
  return seen


def make_guard(sim: Simulation, folder: Path | None, **options: Any) -> NanGuard:
  return NanGuard(sim, DECIMATION, NanGuardCfg(output_dir=None if folder is None else str(folder), **options))


def only_dump(guard: NanGuard, folder: Path) -> NanDump:
  guard.report()
  [path] = folder.iterdir()
  return NanDump.load(path)


@pytest.mark.parametrize("on_host", [True, False], ids=["as on a CPU", "as on a GPU"])
def test_a_dump_holds_the_last_states_and_names_the_first_bad_number(
  sim: Simulation, tmp_path: Path, *, on_host: bool
) -> None:
  scatter(sim)
  guard = make_guard(sim, tmp_path, buffer_size=3)
  guard._on_host = on_host
  seen = run(sim, guard, 5, {(4, 1): lambda: sim.data.qfrc_applied[2, 19].fill_(torch.nan)})
  lines = guard.report()
  assert lines[0] == (
    "world 2 diverged: qfrc_applied of joint 'elbow' was nan before physics step 2 of 2 of environment step 5:"
    " it was written so"
  )
  world = only_dump(guard, tmp_path).worlds[0]
  assert (world.index, world.env_step, world.num_steps) == (2, 5, 6)
  np.testing.assert_array_equal(world.states["qpos"][:-1], torch.stack(seen[-6:])[:, 2].numpy())
  assert np.isnan(world.states["qpos"][-1]).any()
  assert guard.report() == []


def test_mujoco_c_diverges_from_a_dumped_state_where_the_physics_do(
  sim: Simulation, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
  guard = make_guard(sim, tmp_path)
  huge = 1e300 if sim.dtype == torch.float64 else 3e38
  run(sim, guard, 3, {(2, 0): lambda: sim.data.qfrc_applied[1, 0].fill_(huge)})
  world = only_dump(guard, tmp_path).worlds[0]
  replay = world.replay()
  assert capfd.readouterr() == ("", "")
  # The force is finite, but it is the first number beyond the bound.
  assert world.describe_first().startswith("qfrc_applied of joint 0 was ")
  assert replay.diverged_at is not None
  assert replay.diverged_at >= 4


def test_mujoco_c_stays_finite_where_the_state_was_written(make_sim: MakeSim, tmp_path: Path) -> None:
  sim = make_sim()
  scatter(sim)
  guard = make_guard(sim, tmp_path)
  run(sim, guard, 4, {(3, 0): lambda: sim.data.qvel[0, 19].fill_(torch.inf)})
  world = only_dump(guard, tmp_path).worlds[0]
  assert world.describe_first() == (
    "qvel of joint 'elbow' was inf before physics step 1 of 2 of environment step 4: an event, a reset or a"
    " command wrote it so, or the step before left it so"
  )
  replay = world.replay()
  assert replay.diverged_at is None
  # The native engine and MuJoCo C are the same code.
  assert replay.error < 1e-12


def test_a_replay_uses_the_worlds_own_model_fields(make_sim: MakeSim, tmp_path: Path) -> None:
  sim = make_sim()
  scatter(sim)
  sim.expand_model_fields(["body_mass", "opt.gravity", "opt.timestep"])
  sim.model.body_mass[:, 1] *= torch.tensor([0.5, 1.0, 3.0, 2.0], dtype=sim.dtype)
  sim.model.opt.gravity[:, 2] = torch.tensor([-1.0, -2.0, -3.0, -4.0], dtype=sim.dtype)
  sim.recompute_constants()
  guard = make_guard(sim, tmp_path)
  run(sim, guard, 6, {(5, 0): lambda: sim.data.qfrc_applied[2, 0].fill_(torch.nan)})
  # The world restarts with other values; the dump keeps those it diverged with.
  sim.model.body_mass[:, 1] = 7.0
  world = only_dump(guard, tmp_path).worlds[0]
  assert world.model_fields["body_mass"][1] == pytest.approx(3.0)
  assert world.model_fields["opt.gravity"][2] == pytest.approx(-3.0)
  assert world.replay().error < 1e-12


def test_states_before_a_reset_are_left_out(make_sim: MakeSim, tmp_path: Path) -> None:
  sim = make_sim()
  guard = make_guard(sim, tmp_path)
  only = torch.tensor([False, True, False, False])
  run(sim, guard, 6, {(3, 0): lambda: sim.reset(only), (5, 0): lambda: sim.data.qfrc_applied[1, 0].fill_(torch.nan)})
  world = only_dump(guard, tmp_path).worlds[0]
  assert world.num_steps == 3 * DECIMATION
  assert world.states["time"][0] == 0.0


def test_many_worlds_at_once_share_one_file_of_bounded_size(make_sim: MakeSim, tmp_path: Path) -> None:
  sim = make_sim()
  guard = make_guard(sim, tmp_path, max_envs_to_dump=2, max_dumps=1)
  sim.data.qvel[:3, 0] = torch.nan
  run(sim, guard, 3)
  lines = guard.report()
  assert [line.split(":")[0] for line in lines[:3]] == [
    "world 0 diverged",
    "world 1 diverged",
    "1 more world of 4 diverged",
  ]
  assert lines[-1] == "worlds that diverge from now on are only counted (--env.sim.nan-guard.max-dumps)"
  assert [world.index for world in only_dump(guard, tmp_path).worlds] == [0, 1]
  # A world that diverges again counts, but all files are used.
  sim.reset()
  run(sim, guard, 1)
  sim.data.qvel[3, 0] = torch.nan
  run(sim, guard, 1)
  assert guard.report() == []
  assert len(list(tmp_path.iterdir())) == 1


def test_worlds_that_diverge_again_and_again_are_counted_once(make_sim: MakeSim) -> None:
  sim = make_sim()
  guard = make_guard(sim, None, max_envs_to_dump=2)
  for _ in range(5):
    sim.data.qvel[:, 0] = torch.nan
    run(sim, guard, 1)
    sim.reset()
    run(sim, guard, 1)
  assert guard.report()[2:] == ["2 more worlds of 4 diverged", "they diverged 20 times in all"]
  assert guard.report() == []


def test_a_world_that_stays_diverged_is_reported_once(make_sim: MakeSim) -> None:
  sim = make_sim()
  guard = make_guard(sim, None)
  sim.data.qvel[0, 0] = torch.nan
  run(sim, guard, 2)
  assert len(guard.report()) == 1
  run(sim, guard, 2)
  assert guard.report() == []
  sim.reset()
  run(sim, guard, 1)
  sim.data.qvel[0, 0] = torch.nan
  run(sim, guard, 1)
  assert len(guard.report()) == 1


def test_a_later_run_overwrites_nothing(make_sim: MakeSim, tmp_path: Path) -> None:
  for _ in range(2):
    sim = make_sim()
    guard = make_guard(sim, tmp_path)
    sim.data.qvel[0, 0] = torch.nan
    run(sim, guard, 1)
    guard.report()
  assert sorted(path.name for path in tmp_path.iterdir()) == ["nan_dump_step_1.npz", "nan_dump_step_1_2.npz"]


def test_a_file_that_cannot_be_written_stops_nothing(make_sim: MakeSim, tmp_path: Path) -> None:
  sim = make_sim()
  (tmp_path / "dumps").write_text("a file is in the way")
  guard = make_guard(sim, tmp_path / "dumps")
  sim.data.qvel[0, 0] = torch.nan
  run(sim, guard, 1)
  lines = guard.report()
  assert lines[-1].startswith("the NaN dump could not be written: ")
  assert (tmp_path / "dumps").read_text() == "a file is in the way"


class _Waits(TorchDispatchMode):
  def __init__(self) -> None:
    super().__init__()
    self.names: list[str] = []

  def __torch_dispatch__(self, func, types, args=(), kwargs=None):
    if func.overloadpacket.__name__ in ("_local_scalar_dense", "nonzero", "masked_select"):
      self.names.append(func.overloadpacket.__name__)
    return func(*args, **(kwargs or {}))


def test_remembering_and_keeping_never_wait_for_the_device(make_sim: MakeSim) -> None:
  sim = make_sim()
  guard = make_guard(sim, None)
  guard._on_host = False
  run(sim, guard, 1)
  sim.data.qvel[0, 0] = torch.nan
  with _Waits() as waits:
    run(sim, guard, 2)
  assert waits.names == []
  assert len(guard.report()) == 1


def test_files_that_are_no_dumps_are_refused_by_name(tmp_path: Path) -> None:
  path = tmp_path / "x.npz"

  def refused(message: str) -> None:
    with pytest.raises(MjlabError, match=rf"^NaN dump \S+x\.npz: {message}"):
      NanDump.load(path)

  refused("no such file")
  path.write_bytes(b"nonsense")
  refused(r"not an \.npz file$")
  np.savez(path, about=np.array('{"format": "mjlab NaN dump 9"}'))
  refused("format is 'mjlab NaN dump 9', here it is")
  np.savez(path, a=np.zeros(3))
  refused("lacks 'about'")
  np.savez(path, about=np.array([{"evil": 1}], dtype=object))
  refused("Object arrays cannot be loaded")


def test_sizes_that_keep_nothing_are_refused() -> None:
  cfg = SimulationCfg(nan_guard=NanGuardCfg(buffer_size=0, max_dumps=-1))
  spec = mujoco.MjSpec.from_string("<mujoco/>")
  with pytest.raises(MjlabError, match=r"nan_guard\.buffer_size must be at least 1, got 0\n.*nan_guard\.max_dumps"):
    Simulation(1, spec, cfg)


def test_a_world_that_diverged_in_inference_mode_does_not_keep_a_later_one_from_being_kept(make_sim: MakeSim) -> None:
  sim = make_sim()
  sim.expand_model_fields(["body_mass"])
  guard = make_guard(sim, None)
  sim.data.qvel[0, 0] = torch.nan
  with torch.inference_mode():
    run(sim, guard, 1)
  sim.data.qvel[1, 0] = torch.nan
  run(sim, guard, 1)
  assert [line.split(":")[0] for line in guard.report()] == ["world 0 diverged", "world 1 diverged"]
