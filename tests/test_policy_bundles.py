"""Untrained policies of every task family are exported, verified and, where a robot could run them, run."""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import onnx
import onnxruntime
import pytest
import torch
import yaml
from mjlab.environments import standard_env
from mjlab.registry import load_task
from mjlab_core.errors import MjlabError
from mjlab_deploy import Bundle, DeployError, Policy, open_bundle
from mjlab_deploy.formats.adoption import adopted
from mjlab_deploy.formats.other_formats import G1_MOTORS, REFERENCE_OUTPUTS
from mjlab_deploy.simulation.camera import Cameras
from mjlab_deploy.simulation.closed_loop import ClosedLoop
from mjlab_deploy.simulation.simulated_run import SimulatedRun
from mjlab_deploy.simulation.verification import verify
from mjlab_rl import CheckpointPolicy, OnnxPolicy
from mjlab_rl.bundles.policy_bundle import BundleWriter, record, without_noise
from mjlab_rl.bundles.reference_policy import write_for_others
from mjlab_velocity import sim_to_real

STEPS = 110
MEASURED = set("imu/gyro imu/projected_gravity joint/position joint/velocity last_action command/velocity".split())
"""Sources that every legged robot has."""
NO_OPENGL = "no camera images"
TRACKING = "Mjlab-Tracking-Flat-Unitree-G1-No-State-Estimation"
FOR_OTHERS = {"Mjlab-Velocity-Flat-Unitree-G1-Blind", "Mjlab-Velocity-Flat-Unitree-Go1", TRACKING}
"""Tasks whose files for other runners are tested."""


def exported(task: str, folder: Path, preset: Callable[[Any], Any] = lambda parts: parts) -> Path:
  """Export the policy of a task that was not trained, with a record, and the files for other runners."""
  torch.manual_seed(0)
  parts = preset(load_task(task))
  cfg = without_noise(parts.play(parts.env) if parts.play is not None else parts.env)
  with standard_env(cfg, device="cpu") as env:
    policy = CheckpointPolicy(env, parts.agent, parts.runner)
    env.reset(seed=0)
    golden = record(env, parts.agent, policy.network, policy, STEPS)
    description = BundleWriter(env, parts.agent, task).write(folder / "bundle", policy.network, golden=golden)
    if task in FOR_OTHERS:
      others = write_for_others(folder / "others", env, policy.network, description)
      # The reader of files of mjlab 1.x compares every key of the metadata with the environment.
      reader = OnnxPolicy(others / "policy.onnx", parts.agent, env)
      seen: Any = env.get_observations()
      policy.reset(None)
      torch.testing.assert_close(reader(seen), policy(seen), atol=1e-5, rtol=0)
  return folder


@pytest.fixture(scope="module")
def folder_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
  """Return the folder with what is exported of a task, once for all tests."""
  return functools.cache(lambda task: exported(task, tmp_path_factory.mktemp("exported")))


def images_are_those_of_the_record(bundle: Bundle) -> None:
  """Draw the recorded states with the loopback robot's cameras: another renderer than that of the training."""
  loop, golden = ClosedLoop(bundle), bundle.arrays("golden.npz")
  cameras = Cameras(loop.model, bundle.description)
  for step in (0, 50) if cameras.inputs else ():
    loop.start(golden["state/qpos"][step].astype(float), golden["state/qvel"][step].astype(float))
    loop.readings()
    for name, image in cameras.draw(loop.data).items():
      away = np.abs(image - golden[f"input/{name}"][step])
      # Depth is the same but for a pixel at an edge; OpenGL shades textures otherwise.
      assert away.mean() < (1e-3 if name.endswith("depth") else 0.05), (name, step)
      assert np.median(away) < (1e-5 if name.endswith("depth") else 0.05), (name, step)


def assert_runs(run: SimulatedRun) -> None:
  run.run(1.2)
  assert run.runner.phase == "policy", run.runner.reason


def sources(bundle: Bundle) -> set[str]:
  return {source for term in bundle.description.observations for source in term.sources}


@pytest.mark.slow
@pytest.mark.parametrize(
  ("task", "expected", "refusal"),
  [
    ("Mjlab-Cartpole-Swingup", {"cartpole/joint/position", "cartpole/joint/velocity"}, "other targets than positions"),
    ("Mjlab-Velocity-Flat-Unitree-Go1", {"estimate/linear_velocity", *MEASURED}, None),
    ("Mjlab-Velocity-Rough-Unitree-G1", {"terrain/terrain_scan", "command/velocity"}, "the bundle has no scene"),
    ("Mjlab-Velocity-Flat-Unitree-G1-Blind", MEASURED, None),
    (TRACKING, {"motion/joint_position", "motion/anchor_orientation", "imu/torso_link/orientation"}, None),
    ("Mjlab-Lift-Cube-Yam", {"perception/object/position", "hand/grasp_site/position", "command/goal"}, None),
    ("Mjlab-Lift-Objects-Yam", {"perception/object/size", "perception/object/orientation"}, "supply perception"),
    ("Mjlab-Lift-Cube-Yam-Depth", {"camera/wrist_camera/depth", "hand/grasp_site/orientation"}, None),
    ("Mjlab-Lift-Cube-Yam-Rgb", {"camera/wrist_camera/rgb"}, None),
  ],
)
def test_a_policy_of_each_family_repeats_its_record_and_its_trajectory_and_runs(
  task: str, expected: set[str], refusal: str | None, folder_of: Callable[[str], Path]
) -> None:
  with open_bundle(folder_of(task) / "bundle") as bundle:
    assert expected == sources(bundle) if task.endswith("-Blind") else expected <= sources(bundle)
    report = verify(bundle)
    if refusal is None:
      try:
        run = SimulatedRun(bundle, latency=0.004)
      except DeployError as error:
        if NO_OPENGL in str(error):
          pytest.skip(str(error))
        raise
      images_are_those_of_the_record(bundle)
      assert_runs(run)
    else:
      with pytest.raises(DeployError, match=refusal):
        SimulatedRun(bundle)
  assert report.passed, report.failures
  assert report.notes[0].startswith(f"replay: {STEPS} steps")
  assert bundle.description.has_scene == ("Rough" not in task)


def test_a_policy_of_the_sim_to_real_preset_is_verified_and_runs(tmp_path: Path) -> None:
  folder = exported("Mjlab-Velocity-Flat-Unitree-Go2-Blind", tmp_path, sim_to_real)
  with open_bundle(folder / "bundle") as bundle:
    assert sources(bundle) == MEASURED
    report = verify(bundle)
    assert report.passed, report.failures
    assert_runs(SimulatedRun(bundle, latency=0.004, command=[0.5, 0.0, 0.0]))


def test_an_action_that_needs_the_robots_model_is_refused_by_name(tmp_path: Path) -> None:
  with pytest.raises(MjlabError, match=r"action 'hand' \(DifferentialIKAction\) has no computation outside"):
    exported("Mjlab-Lift-Cube-Yam-IK", tmp_path)


def test_unitrees_file_has_gains_of_motors_and_terms_of_its_runner(
  folder_of: Callable[[str], Path], tmp_path: Path
) -> None:
  """The schema is that of Unitree's `export_deploy_cfg`; its runner gives `stiffness[i]` to motor i."""
  made = folder_of("Mjlab-Velocity-Flat-Unitree-G1-Blind")
  folder, ours = made / "others", made / "bundle"
  data = yaml.safe_load((folder / "deploy.yaml").read_text())
  assert sorted(data) == sorted(
    "joint_ids_map step_dt stiffness damping default_joint_pos commands actions observations".split()
  )
  with open_bundle(ours) as bundle:
    description = bundle.description
  assert data["step_dt"] == description.timing.control_dt
  assert [G1_MOTORS[motor] for motor in data["joint_ids_map"]] == list(description.robot.joint_names)
  assert set(data["commands"]["base_velocity"]["ranges"]) == {"lin_vel_x", "lin_vel_y", "ang_vel_z", "heading"}
  (action,) = data["actions"].values()
  assert (len(action["scale"]), len(action["offset"]), action["joint_ids"]) == (29, 29, None)
  assert {name: len(term["scale"]) for name, term in data["observations"].items()} == {
    **dict.fromkeys(("base_ang_vel", "projected_gravity", "velocity_commands"), 3),
    **dict.fromkeys(("joint_pos_rel", "joint_vel_rel", "last_action"), 29),
  }
  assert {term["history_length"] for term in data["observations"].values()} == {5}
  # The pair as Unitree's trainings publish it, a network without metadata and this file, is read and runs alike.
  model = onnx.load(folder / "policy.onnx")
  del model.metadata_props[:]
  for name in ("params", "exported"):
    (tmp_path / name).mkdir()
  policy = tmp_path / "exported" / "policy.onnx"
  onnx.save(model, policy)
  (tmp_path / "params" / "deploy.yaml").write_text((folder / "deploy.yaml").read_text())
  with adopted(policy, ours / "scene.xml") as bundle, open_bundle(ours) as own_bundle:
    assert bundle.description.timing.control_dt == description.timing.control_dt
    theirs, own, rng = Policy(bundle), Policy(own_bundle), np.random.default_rng(0)
    for _ in range(7):
      readings = {item.name: rng.normal(0.0, 0.3, item.shape) for item in own_bundle.description.inputs}
      step, wanted = theirs.step(readings), own.step(readings)
      np.testing.assert_allclose(step.targets["target/position"], wanted.targets["target/position"], atol=1e-5)
    assert_runs(SimulatedRun(bundle))


def test_a_term_that_unitrees_runner_lacks_is_named(folder_of: Callable[[str], Path]) -> None:
  folder = folder_of("Mjlab-Velocity-Flat-Unitree-Go1") / "others"
  assert "no term for 'base_lin_vel'" in (folder / "NO_DEPLOY_YAML.txt").read_text()


def test_a_tracking_policy_is_the_pair_that_lerobot_reads(folder_of: Callable[[str], Path]) -> None:
  """LeRobot's controller of mjlab policies builds 154 numbers, and takes the torso as body 15 of all."""
  made = folder_of(TRACKING)
  folder, ours = made / "others", made / "bundle"
  session = onnxruntime.InferenceSession(folder / "policy.onnx", providers=["CPUExecutionProvider"])
  metadata = session.get_modelmeta().custom_metadata_map
  gains = {
    name: np.array([float(word) for word in metadata[name].split(",")])
    for name in ("default_joint_pos", "action_scale", "joint_stiffness", "joint_damping")
  }
  assert {len(values) for values in gains.values()} == {29}
  assert tuple(metadata["joint_names"].split(",")) == G1_MOTORS
  motion = np.load(folder / "motion.npz")
  joints, bodies = motion["joint_pos"], motion["body_quat_w"]
  assert motion["body_names"][15] == "torso_link"
  assert bodies.shape == (len(joints), 30, 4)
  assert {item.name: item.shape for item in session.get_inputs()} == {"obs": [1, 154], "time_step": [1, 1]}
  # BeyondMimic's controller takes the clip out of the network, frame by frame.
  names = [item.name for item in session.get_outputs()]
  assert names == ["actions", *REFERENCE_OUTPUTS]
  followed = [list(motion["body_names"]).index(name) for name in metadata["body_names"].split(",")]
  assert metadata["anchor_body_name"] in metadata["body_names"].split(",")
  for step, frame in ((0, 0), (7, 7), (10**6, len(joints) - 1)):
    feed = {"obs": np.zeros((1, 154), np.float32), "time_step": np.full((1, 1), step, np.float32)}
    shown: dict[str, Any] = dict(zip(names, session.run(None, feed), strict=True))
    for name in REFERENCE_OUTPUTS:
      wanted = motion[name][frame][followed] if name.startswith("body") else motion[name][frame]
      np.testing.assert_allclose(shown[name][0], wanted, atol=1e-6)
  with open_bundle(ours) as bundle:
    clip, description = bundle.arrays("motion.npz"), bundle.description
    policy = Policy(bundle)
  np.testing.assert_allclose(bodies[:, 15], clip["anchor_orientation"], atol=1e-5)
  np.testing.assert_allclose(motion["joint_vel"], clip["joint_velocity"], atol=1e-4)
  # Its observation, as its controller concatenates it, is the one that the bundle's graph assembles.
  rng = np.random.default_rng(0)
  turn = np.array([0.9, 0.1, -0.2, 0.3]) / np.linalg.norm([0.9, 0.1, -0.2, 0.3])
  q, dq, gyro = rng.normal(0, 0.2, 29), rng.normal(0, 0.5, 29), rng.normal(0, 0.5, 3)
  readings = {"joint/position": q, "joint/velocity": dq, "imu/gyro": gyro, "imu/torso_link/orientation": turn}
  readings |= {"motion/joint_position": joints[4], "motion/joint_velocity": motion["joint_vel"][4]}
  readings |= {"motion/anchor_orientation": bodies[4, 15]}
  relative, columns = np.zeros(4), np.zeros(9)
  mujoco.mju_mulQuat(relative, turn * [1, -1, -1, -1], bodies[4, 15].astype(float))
  mujoco.mju_quat2Mat(columns, relative)
  six = columns.reshape(3, 3)[:, :2].ravel()
  seen = [joints[4], motion["joint_vel"][4], six, gyro, q - gains["default_joint_pos"], dq, np.zeros(29)]
  obs = np.concatenate(seen)[None].astype(np.float32)
  step = policy.step({item.name: readings[item.name] for item in description.inputs})
  np.testing.assert_allclose(step.observations["actor"], obs[0], atol=1e-5)
  action = np.asarray(session.run(["actions"], {"obs": obs, "time_step": np.full((1, 1), 4, np.float32)})[0])
  target = gains["default_joint_pos"] + action[0] * gains["action_scale"]
  np.testing.assert_allclose(target, step.targets["target/position"], atol=1e-5)
  # The network itself, read by its metadata, drives the robot alike. Its clip begins a frame earlier.
  with adopted(folder / "policy.onnx", ours / "scene.xml") as bundle:
    assert bundle.description.robot.joints[3].stiffness == description.robot.joints[3].stiffness
    assert bundle.description.timing.control_dt == description.timing.control_dt
    again, shown = Policy(bundle), bundle.arrays("motion.npz")
    # Equal frames at the end are one.
    rows = np.minimum(np.arange(len(joints)) + 1, len(shown["joint_position"]) - 1)
    for name in clip:
      np.testing.assert_allclose(shown[name][rows], clip[name], atol=1e-4)
    targets = again.step({item.name: readings[item.name] for item in bundle.description.inputs}).targets
    np.testing.assert_allclose(targets["target/position"], step.targets["target/position"], atol=1e-5)
    assert_runs(SimulatedRun(bundle))
