"""Training with rsl-rl: vec-env adapter, runner, checkpoints, run manifests."""

import os
from typing import TYPE_CHECKING

from mjlab_core.lazy import lazy_exports

if TYPE_CHECKING:
  from mjlab_core.policies import FinitePolicy, Policy

  from mjlab_rl.bundles.bundle_policy import BundlePolicy
  from mjlab_rl.bundles.onnx_policy import OnnxPolicy
  from mjlab_rl.config import (
    RslRlBaseRunnerCfg,
    RslRlDistillationAlgorithmCfg,
    RslRlDistillationRunnerCfg,
    RslRlModelCfg,
    RslRlOnPolicyRunnerCfg,
    RslRlPpoAlgorithmCfg,
    TaskCfg,
    control_agent,
  )
  from mjlab_rl.env_protocol import RlEnv
  from mjlab_rl.evaluation import (
    Episodes,
    Evaluation,
    Evaluator,
    Interval,
    Progress,
    ReturnEvaluation,
    Threshold,
    bootstrap,
    play_first_episodes,
    summarize,
    wilson,
  )
  from mjlab_rl.offpolicy.config import OffPolicyModelCfg, OffPolicyRunnerCfg, SacCfg
  from mjlab_rl.offpolicy.presets import with_agent
  from mjlab_rl.offpolicy.runner import MjlabOffPolicyRunner
  from mjlab_rl.onpolicy.distillation import MjlabDistillationRunner
  from mjlab_rl.policies import CheckpointPolicy
  from mjlab_rl.reports.console import Console
  from mjlab_rl.reports.scalar_log import IterationReport
  from mjlab_rl.runner import MjlabOnPolicyRunner
  from mjlab_rl.runs.manifest import PolicyRecord, RunManifest, load_run
  from mjlab_rl.runs.references import trust_package
  from mjlab_rl.runs.run_directory import checkpoints, create_run_directory, find_checkpoint
  from mjlab_rl.trained_policy import TrainedPolicy, read_trained_policy
  from mjlab_rl.training import TrainingResult, train
  from mjlab_rl.vec_env import RslRlVecEnvWrapper

__all__ = [
  "BundlePolicy",
  "CheckpointPolicy",
  "Console",
  "Episodes",
  "Evaluation",
  "Evaluator",
  "FinitePolicy",
  "Interval",
  "IterationReport",
  "MjlabDistillationRunner",
  "MjlabOffPolicyRunner",
  "MjlabOnPolicyRunner",
  "OffPolicyModelCfg",
  "OffPolicyRunnerCfg",
  "OnnxPolicy",
  "Policy",
  "PolicyRecord",
  "Progress",
  "ReturnEvaluation",
  "RlEnv",
  "RslRlBaseRunnerCfg",
  "RslRlDistillationAlgorithmCfg",
  "RslRlDistillationRunnerCfg",
  "RslRlModelCfg",
  "RslRlOnPolicyRunnerCfg",
  "RslRlPpoAlgorithmCfg",
  "RslRlVecEnvWrapper",
  "RunManifest",
  "SacCfg",
  "TaskCfg",
  "Threshold",
  "TrainedPolicy",
  "TrainingResult",
  "bootstrap",
  "checkpoints",
  "control_agent",
  "create_run_directory",
  "find_checkpoint",
  "load_run",
  "play_first_episodes",
  "read_trained_policy",
  "summarize",
  "train",
  "trust_package",
  "wilson",
  "with_agent",
]

# rsl-rl imports GitPython, which complains at import where there is no git binary.
os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")

# Loaded on first use: a task's configuration needs no rsl-rl, and reading a manifest needs no torch.
__getattr__, __dir__ = lazy_exports(
  __name__,
  {
    ".bundles.bundle_policy": "BundlePolicy",
    ".config": (
      "RslRlBaseRunnerCfg RslRlDistillationAlgorithmCfg RslRlDistillationRunnerCfg RslRlModelCfg "
      "RslRlOnPolicyRunnerCfg RslRlPpoAlgorithmCfg TaskCfg control_agent"
    ),
    ".reports.console": "Console",
    ".onpolicy.distillation": "MjlabDistillationRunner",
    ".env_protocol": "RlEnv",
    "mjlab_core.policies": "FinitePolicy Policy",
    ".evaluation": (
      "Episodes Evaluation Evaluator Interval Progress ReturnEvaluation Threshold bootstrap "
      "play_first_episodes summarize wilson"
    ),
    ".runs.manifest": "PolicyRecord RunManifest load_run",
    ".offpolicy.config": "OffPolicyModelCfg OffPolicyRunnerCfg SacCfg",
    ".offpolicy.presets": "with_agent",
    ".offpolicy.runner": "MjlabOffPolicyRunner",
    ".bundles.onnx_policy": "OnnxPolicy",
    ".policies": "CheckpointPolicy",
    ".runs.references": "trust_package",
    ".runs.run_directory": "checkpoints create_run_directory find_checkpoint",
    ".runner": "MjlabOnPolicyRunner",
    ".reports.scalar_log": "IterationReport",
    ".trained_policy": "TrainedPolicy read_trained_policy",
    ".training": "TrainingResult train",
    ".vec_env": "RslRlVecEnvWrapper",
  },
)
