"""Kernels are found without running anything, and made before they are launched."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import mujoco
import pytest
import torch
import warp as wp
from mjlab_sim.warp.kernel_loading import load_kernels
from sim_world import MakeSim, scatter


@wp.kernel
def _count(out: wp.array(dtype=wp.int32)):  # pyright: ignore  # ty: ignore
  wp.atomic_add(out, 0, 1)


@pytest.mark.warp
def test_looking_for_kernels_launches_none_and_visits_every_branch() -> None:
  counter, condition = wp.zeros(1, dtype=wp.int32, device="cpu"), wp.zeros(1, dtype=wp.int32, device="cpu")
  visited: list[str] = []

  def launch(branch: str) -> None:
    visited.append(branch)
    wp.launch(_count, dim=1, outputs=[counter], device="cpu")

  def stage() -> None:
    launch("plain")
    wp.capture_while(condition, while_body=launch, branch="while")
    wp.capture_if(condition, on_true=launch, on_false=launch, branch="if")

  load_kernels([stage], wp.get_device("cpu"))
  assert visited == ["plain", "while", "if", "if"]
  assert counter.numpy()[0] == 0
  stage()
  # The condition does not hold: the loop is left out, and of two branches one is taken.
  assert visited[4:] == ["plain", "if"]
  assert counter.numpy()[0] == 2


@wp.kernel(module="unique")
def _increment(out: wp.array(dtype=wp.int32)):  # pyright: ignore  # ty: ignore
  wp.atomic_add(out, 0, 1)


@wp.kernel(module="unique")
def _count_twice(out: wp.array(dtype=wp.int32)):  # pyright: ignore  # ty: ignore
  wp.atomic_add(out, 0, 1)
  wp.atomic_add(out, 0, 1)


@wp.kernel(module="unique")
def _sum(out: wp.array(dtype=wp.int32)):  # pyright: ignore  # ty: ignore
  wp.tile_store(out, wp.tile_sum(wp.tile_load(out, 1)))  # pyright: ignore  # ty: ignore


def test_kernels_that_wait_for_solvers_are_compiled_first_and_then_those_with_most_code(
  monkeypatch: pytest.MonkeyPatch,
) -> None:
  counter = wp.zeros(1, dtype=wp.int32, device="cpu")
  order: list[wp.Module] = []
  monkeypatch.setattr(wp.Module, "load", lambda module, device, block_dim=None: order.append(module))
  monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0}, raising=False)
  kernels: tuple[Any, ...] = (_increment, _count_twice, _sum)
  short, long, tiled = (kernel.module for kernel in kernels)

  def stage() -> None:
    for kernel in kernels:
      wp.launch(kernel, dim=1, outputs=[counter], device="cpu")

  load_kernels([stage], wp.get_device("cpu"))
  assert order == [tiled, long, short]


def test_looking_for_kernels_asks_the_device_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
  asked: list[wp.Kernel] = []
  # A GPU's answer is that of a loaded kernel, and while kernels are looked for none is.
  monkeypatch.setattr(wp, "get_suggested_block_size", lambda kernel, device=None: asked.append(kernel))
  sizes: list[tuple[int, int]] = []
  load_kernels([lambda: sizes.append(wp.get_suggested_block_size(_count, "cpu"))], wp.get_device("cpu"))
  assert (sizes, asked) == ([(1, 1)], [])


@pytest.mark.warp
def test_a_step_loads_no_kernel_that_was_not_loaded_when_the_simulation_was_made(make_sim: MakeSim) -> None:
  sim = make_sim("warp", capture=False)
  sim.expand_model_fields(["body_mass", "body_pos"])
  scatter(sim)
  before = {module: set(module.execs) for module in _modules()}
  sim.step()
  sim.reset(torch.tensor([True, False, False, True]))
  sim.model.body_mass *= 2.0
  sim.model.body_pos += 0.1
  sim.recompute_constants()
  sim.forward()
  assert {module: set(module.execs) for module in _modules()} == before


def _modules() -> list[wp.Module]:
  from warp._src.context import user_modules

  return list(user_modules.values())


def test_an_error_of_a_kernel_is_raised() -> None:
  def stage() -> None:
    raise mujoco.FatalError("broken")

  with pytest.raises(mujoco.FatalError, match="broken"):
    load_kernels([stage], wp.get_device("cpu"))


@pytest.mark.warp
def test_two_processes_on_an_empty_cache_compile_each_kernel_once(tmp_path: Path) -> None:
  program = Path(__file__).with_name("sim_kernel_program.py")
  both = []
  env = os.environ | {"WARP_CACHE_PATH": str(tmp_path)}
  for _ in range(2):
    both.append(
      subprocess.Popen([sys.executable, program], env=env, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    )
  said = ""
  try:
    for process in both:
      # Both look for kernels before either has compiled one.
      assert process.stdout is not None
      assert process.stdout.readline() == "ready\n"
    for process in both:
      assert process.stdin is not None
      process.stdin.write("go\n")
      process.stdin.flush()
    said = "".join(process.communicate(timeout=300)[0] for process in both)
  finally:
    for process in both:
      process.kill()
      process.communicate()
  assert said.count("counted 3") == 2
  assert (said.count("(compiled)"), said.count("(cached)")) == (2, 2)
