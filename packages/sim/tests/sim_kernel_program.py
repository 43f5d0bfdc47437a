"""Process that loads two kernels once it is asked to, as the simulation does, and prints which ones it compiled."""

import sys

import warp as wp
from mjlab_sim.warp.kernel_loading import load_kernels


@wp.kernel(module="unique")
def first(out: wp.array(dtype=wp.int32)):  # pyright: ignore  # ty: ignore
  wp.atomic_add(out, 0, 1)


@wp.kernel(module="unique")
def second(out: wp.array(dtype=wp.int32)):  # pyright: ignore  # ty: ignore
  wp.atomic_add(out, 0, 2)


if __name__ == "__main__":
  wp.config.log_level = wp.LOG_WARNING
  wp.init()
  counter = wp.zeros(1, dtype=wp.int32, device="cpu")

  def stage() -> None:
    for kernel in (first, second):
      wp.launch(kernel, dim=1, outputs=[counter], device="cpu")

  print("ready", flush=True)
  sys.stdin.readline()
  # Warp then says of each module whether it was compiled.
  wp.config.log_level = wp.LOG_INFO
  load_kernels([stage], wp.get_device("cpu"))
  stage()
  print(f"counted {counter.numpy()[0]}", flush=True)
