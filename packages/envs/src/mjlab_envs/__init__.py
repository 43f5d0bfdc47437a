"""The manager-based environment and its generic term library."""

from mjlab_envs.base_env import ManagerBasedEnv, Observations
from mjlab_envs.env import ManagerBasedRlEnv
from mjlab_envs.env_cfg import ManagerBasedRlEnvCfg, ViewerCfg

__all__ = ["ManagerBasedEnv", "ManagerBasedRlEnv", "ManagerBasedRlEnvCfg", "Observations", "ViewerCfg"]
