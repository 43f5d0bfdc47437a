"""Training with rsl-rl: vec-env adapter, runner, checkpoints, run manifests."""

import os
from typing import TYPE_CHECKING

from mjlab_core.lazy import lazy_exports

if TYPE_CHECKING:
  from mjlab_rl.checkpoint import CheckpointError
  from mjlab_rl.config import (
    ConfigError,
    RslRlBaseRunnerCfg,
    RslRlDistillationAlgorithmCfg,
    RslRlDistillationRunnerCfg,
    RslRlModelCfg,
    RslRlOnPolicyRunnerCfg,
    RslRlPpoAlgorithmCfg,
  )
  from mjlab_rl.console import Console
  from mjlab_rl.distillation import MjlabDistillationRunner
  from mjlab_rl.env_protocol import RlEnv
  from mjlab_rl.evaluation import (
    Episodes,
    Evaluation,
    EvaluationError,
    Evaluator,
    Interval,
    Policy,
    Progress,
    ReturnEvaluation,
    Threshold,
    bootstrap,
    play_first_episodes,
    summarize,
    wilson,
  )
  from mjlab_rl.iteration_report import IterationReport
  from mjlab_rl.manifest import ManifestError, PolicyRecord, RunManifest, load_run
  from mjlab_rl.policies import CheckpointPolicy, OnnxPolicy
  from mjlab_rl.run_directory import RunNotFoundError, checkpoints, create_run_directory, find_checkpoint
  from mjlab_rl.runner import DivergedError, MjlabOnPolicyRunner
  from mjlab_rl.task import TaskCfg
  from mjlab_rl.trained_policy import TrainedPolicy, read_trained_policy
  from mjlab_rl.training import TrainingResult, train
  from mjlab_rl.vec_env import RslRlVecEnvWrapper

__all__ = [
  "CheckpointError",
  "CheckpointPolicy",
  "ConfigError",
  "Console",
  "DivergedError",
  "Episodes",
  "Evaluation",
  "EvaluationError",
  "Evaluator",
  "Interval",
  "IterationReport",
  "ManifestError",
  "MjlabDistillationRunner",
  "MjlabOnPolicyRunner",
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
  "RunNotFoundError",
  "TaskCfg",
  "Threshold",
  "TrainedPolicy",
  "TrainingResult",
  "bootstrap",
  "checkpoints",
  "create_run_directory",
  "find_checkpoint",
  "load_run",
  "play_first_episodes",
  "read_trained_policy",
  "summarize",
  "train",
  "wilson",
]

# rsl-rl imports GitPython, which complains at import where there is no git binary.
os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")

# Loaded on first use: a task's configuration needs no rsl-rl, and reading a manifest needs no torch.
__getattr__, __dir__ = lazy_exports(
  __name__,
  {
    ".checkpoint": "CheckpointError",
    ".config": (
      "ConfigError RslRlBaseRunnerCfg RslRlDistillationAlgorithmCfg RslRlDistillationRunnerCfg RslRlModelCfg "
      "RslRlOnPolicyRunnerCfg RslRlPpoAlgorithmCfg"
    ),
    ".console": "Console",
    ".distillation": "MjlabDistillationRunner",
    ".env_protocol": "RlEnv",
    ".evaluation": (
      "Episodes Evaluation EvaluationError Evaluator Interval Policy Progress ReturnEvaluation Threshold bootstrap "
      "play_first_episodes summarize wilson"
    ),
    ".iteration_report": "IterationReport",
    ".manifest": "ManifestError PolicyRecord RunManifest load_run",
    ".policies": "CheckpointPolicy OnnxPolicy",
    ".run_directory": "RunNotFoundError checkpoints create_run_directory find_checkpoint",
    ".runner": "DivergedError MjlabOnPolicyRunner",
    ".task": "TaskCfg",
    ".trained_policy": "TrainedPolicy read_trained_policy",
    ".training": "TrainingResult train",
    ".vec_env": "RslRlVecEnvWrapper",
  },
)
