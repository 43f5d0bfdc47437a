"""`export RUN [flags]`: a trained policy as a bundle for mjlab-deploy."""

import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mjlab_core
import mjlab_rl
from mjlab_core import UsageError
from mjlab_core.constraints import Count
from mjlab_core.errors import RenderingError
from mjlab_rl import find_checkpoint, load_run

from mjlab import environments
from mjlab.cli.shared._command_line import (
  CommandLine,
  CommonArguments,
  beside,
  building,
  built_env,
  output_folder,
)
from mjlab.registry import load_task


@dataclass(kw_only=True)
class Arguments(CommonArguments):
  """All that can be given after the run."""

  output: str | None = None
  """Folder to write, and a zip beside it; None: bundle below the run."""
  steps: Count = 500
  """Steps of the record golden.npz; 0: none."""
  task: str | None = None
  """Task of the policy; None: that of the manifest of its run."""
  others: bool = False
  """Also write OUTPUT-others: policy.onnx with the metadata of mjlab 1.x and BeyondMimic, motion.npz for LeRobot, and
  deploy.yaml for Unitree's runner."""
  force: bool = False
  """Replace an existing bundle."""
  log_root: str = "logs"
  """Folder of all runs."""


@CommandLine("export", "RUN|CHECKPOINT", Arguments)
def run(wanted: Arguments, sources: list[str]) -> int:
  """Write the policy of a run, or of a checkpoint, as a bundle.

  It has a graph from sensors to joint targets, its description, the robot's model, and a record of the training
  environment. mjlab-deploy verify checks it.
  """
  checkpoint = find_checkpoint(sources[0], log_root=Path(wanted.log_root), experiment="")
  folder = Path(wanted.output or beside(checkpoint, "bundle"))
  output_folder(folder, "bundle.json", force=wanted.force or wanted.output is None)
  from mjlab_rl.bundles.policy_bundle import BundleWriter, record, without_noise, write_zip
  from mjlab_rl.bundles.reference_policy import write_for_others

  parts, name = _parts(checkpoint, wanted.task)
  with building():
    cfg = without_noise(environments.for_watching(parts))
  with built_env(parts, cfg, "cpu") as env:
    policy = mjlab_rl.CheckpointPolicy(env, parts.agent, parts.runner)
    policy.load(checkpoint)
    mjlab_core.seed_everything(0)
    env.reset(seed=0)
    # Named first if it cannot be exported, before anything is recorded.
    writer = BundleWriter(env, parts.agent, name)
    golden = record(env, parts.agent, policy.network, policy, wanted.steps) if wanted.steps else None
    measured = checkpoint.parent / "evaluation" / checkpoint.stem / "evaluation.json"
    description = writer.write(
      folder,
      policy.network,
      training=_training(checkpoint, parts),
      evaluation=json.loads(measured.read_text(encoding="utf-8"))["groups"] if measured.is_file() else {},
      golden=golden,
      picture=_picture(env),
    )
    if wanted.others:
      others = write_for_others(folder.with_name(f"{folder.name}-others"), env, policy.network, description)
      print(f"wrote {others}")
  archive = write_zip(folder)
  print(f"wrote {folder} and {archive}; check it with: mjlab-deploy verify {folder}")
  return 0


def _parts(checkpoint: Path, task: str | None) -> tuple[Any, str]:
  """Return the run of a checkpoint, or the task that is named, and its id."""
  if task is not None:
    return load_task(task), task
  try:
    manifest = load_run(checkpoint)
  except FileNotFoundError:
    raise UsageError(f"{checkpoint.parent} has no manifest; name the task with --task") from None
  return manifest, manifest.task


def _training(checkpoint: Path, parts: Any) -> dict[str, Any]:
  from mjlab_rl.trained_policy import read_trained_policy

  found = read_trained_policy(checkpoint).record
  facts: dict[str, Any] = {name: getattr(parts, name, None) for name in ("seed", "created", "git")}
  if found is not None:
    facts |= {"iterations": found.iterations, "sha256": found.sha256}
  return {"checkpoint": checkpoint.name, **facts}


def _picture(env: Any) -> bytes | None:
  from PIL import Image

  try:
    env.render_mode = "rgb_array"
    picture = env.render()
  except (RenderingError, RuntimeError) as error:
    print(f"no picture: {error}")
    return None
  file = io.BytesIO()
  Image.fromarray(picture).save(file, format="PNG")
  return file.getvalue()
