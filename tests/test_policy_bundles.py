"""Untrained policies of every task family are exported, verified and, where a robot could run them, run."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from mjlab.environments import standard_env
from mjlab.registry import list_tasks, load_task
from mjlab_core.errors import MjlabError
from mjlab_deploy import Bundle, open_bundle
from mjlab_deploy.simulated_run import SimulatedRun
from mjlab_deploy.verification import verify
from mjlab_rl import CheckpointPolicy, OnnxPolicy
from mjlab_rl.policy_bundle import BundleWriter, record, without_noise
from mjlab_rl.reference_policy import write_for_others
from mjlab_velocity import sim_to_real

STEPS = 110
MEASURED = {
  "imu/gyro",
  "imu/projected_gravity",
  "joint/position",
  "joint/velocity",
  "last_action",
  "command/velocity",
}
"""Sources that every legged robot has."""


def exported(task: str, folder: Path, preset: Callable[[Any], Any] = lambda parts: parts) -> Path:
  """Export the policy of a task that was not trained, with a record."""
  torch.manual_seed(0)
  parts = preset(load_task(task))
  cfg = without_noise(parts.play(parts.env) if parts.play is not None else parts.env)
  with standard_env(cfg, device="cpu") as env:
    policy = CheckpointPolicy(env, parts.agent, parts.runner)
    env.reset(seed=0)
    golden = record(env, parts.agent, policy.network, policy, STEPS)
    BundleWriter(env, parts.agent, task).write(folder, policy.network, golden=golden)
  return folder


def sources(bundle: Bundle) -> set[str]:
  return {source for term in bundle.description.observations for source in term.sources}


@pytest.mark.slow
@pytest.mark.parametrize(
  ("task", "expected"),
  [
    ("Mjlab-Cartpole-Swingup", {"cartpole/joint/position", "cartpole/joint/velocity"}),
    (
      "Mjlab-Velocity-Flat-Unitree-Go1",
      {
        "estimate/linear_velocity",
        "imu/gyro",
        "imu/projected_gravity",
        "joint/position",
        "joint/velocity",
        "last_action",
        "command/velocity",
      },
    ),
    ("Mjlab-Velocity-Rough-Unitree-G1", {"terrain/terrain_scan", "command/velocity"}),
    ("Mjlab-Velocity-Flat-Unitree-G1-Blind", MEASURED),
    (
      "Mjlab-Tracking-Flat-Unitree-G1-No-State-Estimation",
      {"motion/joint_position", "motion/joint_velocity", "motion/anchor_orientation", "imu/torso_link/orientation"},
    ),
    ("Mjlab-Lift-Cube-Yam", {"perception/object/position", "hand/grasp_site/position", "command/goal"}),
    ("Mjlab-Lift-Objects-Yam", {"perception/object/size", "perception/object/orientation"}),
    ("Mjlab-Lift-Cube-Yam-Depth", {"camera/wrist_camera/depth", "hand/grasp_site/orientation"}),
    ("Mjlab-Lift-Cube-Yam-Rgb", {"camera/wrist_camera/rgb"}),
  ],
)
def test_a_policy_of_each_family_repeats_its_record_and_its_trajectory(
  task: str, expected: set[str], tmp_path: Path
) -> None:
  with open_bundle(exported(task, tmp_path / "bundle")) as bundle:
    assert expected <= sources(bundle)
    report = verify(bundle)
  assert report.passed, report.failures
  assert report.notes[0].startswith(f"replay: {STEPS} steps")
  assert bundle.description.has_scene == ("Rough" not in task)


@pytest.mark.parametrize("task", [name for name in list_tasks() if name.endswith("-Blind")])
def test_a_blind_policy_needs_only_sensors_that_the_robot_has(task: str, tmp_path: Path) -> None:
  parts = load_task(task)
  with standard_env(without_noise(parts.env), device="cpu") as env:
    policy = CheckpointPolicy(env, parts.agent, parts.runner)
    description = BundleWriter(env, parts.agent, task).write(tmp_path / "bundle", policy.network)
  assert {source for term in description.observations for source in term.sources} == MEASURED


def test_a_legged_robot_stands_up_and_walks_until_it_is_stopped(tmp_path: Path) -> None:
  with open_bundle(exported("Mjlab-Velocity-Flat-Unitree-Go1", tmp_path / "bundle")) as bundle:
    run = SimulatedRun(bundle, latency=0.004, command=[0.5, 0.0, 0.0])
    run.run(1.2)
    # An untrained policy stands for a moment, which is enough to see that every joint is where it belongs.
    assert run.runner.phase == "policy", run.runner.reason
    assert not run.robot.is_damped


def test_a_policy_of_the_sim_to_real_preset_is_verified_and_runs(tmp_path: Path) -> None:
  folder = exported("Mjlab-Velocity-Flat-Unitree-Go2-Blind", tmp_path / "bundle", sim_to_real)
  with open_bundle(folder) as bundle:
    report = verify(bundle)
    assert report.passed, report.failures
    run = SimulatedRun(bundle, latency=0.004, command=[0.5, 0.0, 0.0])
    run.run(1.2)
    assert run.runner.phase == "policy", run.runner.reason


def test_an_action_that_needs_the_robots_model_is_refused_by_name(tmp_path: Path) -> None:
  with pytest.raises(MjlabError, match=r"action 'hand' \(DifferentialIKAction\) has no computation outside"):
    exported("Mjlab-Lift-Cube-Yam-IK", tmp_path / "bundle")


@pytest.mark.parametrize("blind", [False, True])
def test_files_for_other_runners_fit_the_environment(blind: bool, tmp_path: Path) -> None:
  torch.manual_seed(0)
  parts = load_task("Mjlab-Velocity-Flat-Unitree-Go1")
  if blind:
    parts.env.observations["actor"].terms["base_lin_vel"] = None
  with standard_env(without_noise(parts.env), device="cpu") as env:
    trained = CheckpointPolicy(env, parts.agent, parts.runner)
    description = BundleWriter(env, parts.agent, "Go1").write(tmp_path / "bundle", trained.network)
    folder = write_for_others(tmp_path / "others", trained.network, description)
    # The reader of files of mjlab 1.x compares every key of the metadata with the environment.
    policy = OnnxPolicy(folder / "policy.onnx", parts.agent, env)
    seen: Any = env.get_observations()
    torch.testing.assert_close(policy(seen), trained(seen), atol=1e-5, rtol=0)
  assert all(joint.velocity_limit in (30.1, 20.06) for joint in description.robot.joints)
  if blind:
    lines = (folder / "deploy.yaml").read_text().splitlines()
    assert "joint_ids_map: [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]" in lines
    assert "step_dt: 0.02" in lines
    terms = [
      line.strip(" :") for line in lines[lines.index("observations:") + 1 :] if line.startswith("  ") and line[2] != " "
    ]
    assert terms == [
      "base_ang_vel",
      "projected_gravity",
      "joint_pos_rel",
      "joint_vel_rel",
      "last_action",
      "velocity_commands",
    ]
  else:
    assert "no term for 'base_lin_vel'" in (folder / "NO_DEPLOY_YAML.txt").read_text()
