"""Number of Python calls between `env.step` and the write of `ctrl`."""

import sys
from types import FrameType

import mjlab
import torch
from mjlab_envs import ManagerBasedRlEnv

TASK = "Mjlab-Velocity-Flat-Unitree-Go1"
LIMIT = 12
# The three parts of a step that handle the action; everything they call is on the action's path.
HANDLERS = ("ActionManager.process_action", "ActionManager.apply_action", "Scene.write_ctrl")


def action_path(env: ManagerBasedRlEnv, action: torch.Tensor) -> list[str]:
  """Step `env` once and return the calls on the path of `action` to `ctrl`, in order, indented by depth.

  The path begins below `env.step` and ends where `ctrl` is written for the first time. On it are the handlers of the
  action (`HANDLERS`), the calls that lead to them, and every call that they make into a member of the workspace,
  generated methods such as the `__init__` of a dataclass included. Calls into torch and MuJoCo do not count.
  """
  ctrl = env.sim.data.ctrl
  before = ctrl._version
  path: list[str] = []
  listed: set[int] = set()
  stack: list[tuple[int, str, bool]] = []
  number = 0

  def profile(frame: FrameType, event: str, _: object) -> None:
    nonlocal number
    if event == "call":
      number += 1
      name = frame.f_code.co_qualname
      is_ours = frame.f_globals.get("__name__", "").startswith("mjlab")
      handles = is_ours and (name in HANDLERS or any(entry[2] for entry in stack))
      stack.append((number, name if is_ours else "", handles))
      if handles and ctrl._version == before:
        for depth, (call, caller, _) in enumerate(entry for entry in stack if entry[1]):
          if depth and call not in listed:
            listed.add(call)
            path.append("  " * depth + caller)
    elif event == "return" and stack:
      stack.pop()

  sys.setprofile(profile)
  try:
    env.step(action)
  finally:
    sys.setprofile(None)
  assert ctrl._version != before, "the step did not write ctrl"
  return path


def calls_of_flat_go1() -> list[str]:
  """Return the path of an action of one flat Go1 on the native engine."""
  with mjlab.make(TASK, num_envs=1, device="cpu") as env:
    env.reset(seed=0)
    action = torch.full((1, env.action_manager.total_action_dim), 0.5)
    env.step(action)
    return action_path(env, action)


def test_an_action_reaches_ctrl_in_few_calls() -> None:
  path = calls_of_flat_go1()
  assert path[0].strip() == "StepGraph.__call__"
  assert len(path) <= LIMIT, "\n".join(path)
