"""`sysid`: from records of a task's robot to an overlay that the task applies."""

import contextlib
import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from mjlab import cli
from mjlab_core import MjlabError
from mjlab_robots.go1 import go1
from mjlab_scene import EntityCfg, read_overlay
from mjlab_sysid import Identified, IdentifyCfg, Record, identify, parse_term, robot_on_stand, write_record

GO1 = "Mjlab-Velocity-Flat-Unitree-Go1"
CALF, THIGH = "FR_calf_joint", "FR_thigh_joint"
TERMS = (
  f"armature:{CALF}=0.001..0.05",
  f"stiffness:{THIGH}",
  "pseudo_inertia.alpha:FR_calf",
  f"delay:({THIGH}|{CALF}),shared",
  f"encoder_bias:{CALF}",
)


def leg_record(seconds: float = 3.0) -> tuple[EntityCfg, Any, Record]:
  """Return the Go1 on a stand at 5 ms a step, and a record of its right front leg with a delay of two steps."""
  cfg = go1(meshes="never")

  def on_stand() -> Any:
    entity = cfg.build("robot")
    assert cfg.articulation is not None
    entity.spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    pose = {name: values[0] for name, values in entity.initial_state.joint_pos.items()}
    return robot_on_stand(entity.spec, cfg.articulation.actuators, pose=pose, timestep=0.005, height=1.0)

  robot = on_stand()
  model = robot.model
  model.dof_armature[model.joint(CALF).dofadr[0]] *= 1.5
  data = mujoco.MjData(model)
  data.qpos[:] = robot.pose
  time = 0.01 * np.arange(round(seconds / 0.01))
  addresses, _ = robot.addresses([THIGH, CALF])
  waves = np.stack([np.sin(9.0 * time) + np.sin(23.0 * time), np.sin(7.0 * time) + np.sin(17.0 * time)], 1)
  commands = robot.pose[addresses] + 0.1 * waves
  places = [model.actuator(name).id for name in (THIGH, CALF)]
  data.ctrl[:] = [robot.pose[robot.addresses([model.actuator(i).name])[0][0]] for i in range(model.nu)]
  rows = []
  for step in range(2 * len(time)):
    if step % 2 == 0:
      rows.append(data.qpos[addresses])
    data.ctrl[places] = commands[max(0, step - 2) // 2]
    mujoco.mj_step(model, data)
  signals = {"position": np.array(rows), "position_target": commands}
  return cfg, on_stand(), Record(source="leg", joints=(THIGH, CALF), time=time, signals=signals)


def fit(records: Path, *words: str) -> int:
  """Run `sysid --fit WORDS`, which writes identified.json beside the records."""
  output = str(records.with_name("identified.json"))
  return cli.sysid([str(records), "--task", GO1, "--output", output, "--fit", *words])


@pytest.fixture(scope="module")
def leg() -> tuple[EntityCfg, Record, Identified]:
  cfg, robot, record = leg_record()
  return cfg, record, identify(robot, [record], [parse_term(text) for text in TERMS], IdentifyCfg(iterations=10))


def test_a_robot_with_the_overlay_has_the_identified_parameters(
  leg: tuple[EntityCfg, Record, Identified], tmp_path: Path
) -> None:
  cfg, _, found = leg
  found.save(tmp_path / "identified.json")
  assert [estimate.reason for estimate in found.estimates] == [""] * len(TERMS)
  assert found.value(f"delay:({THIGH}|{CALF})") == pytest.approx(0.01, rel=0.05)
  plain = cfg.build("robot").spec.compile()
  cfg.overlay = str(tmp_path / "identified.json")
  entity = cfg.build("robot")
  model = entity.spec.compile()
  armature = model.joint(CALF).armature[0]
  assert armature == pytest.approx(1.5 * plain.joint(CALF).armature[0], rel=0.02)
  assert armature == pytest.approx(found.value(f"dof_armature:{CALF}"))
  assert model.joint("FL_calf_joint").armature == plain.joint("FL_calf_joint").armature
  assert model.actuator(THIGH).gainprm[0] == pytest.approx(found.value(f"stiffness:{THIGH}"))
  assert model.actuator("FL_thigh_joint").gainprm[0] == plain.actuator("FL_thigh_joint").gainprm[0]
  alpha = found.value("pseudo_inertia.alpha:FR_calf")
  for name in ("mass", "inertia"):
    np.testing.assert_allclose(
      getattr(model.body("FR_calf"), name), getattr(plain.body("FR_calf"), name) * np.exp(2 * alpha), rtol=1e-6
    )
  assert entity.actuators is not None
  lags = {cfg.target_names_expr: (cfg.delay_min_lag, cfg.delay_max_lag) for cfg in entity.actuators.cfgs}
  assert set(lags.values()) == {(2, 2)}
  assert entity.overlay.encoder_bias[CALF] == pytest.approx(0.0, abs=4.0 * found.information.std[-1])


def test_the_flag_of_any_command_applies_the_overlay(leg: tuple[EntityCfg, Record, Identified], tmp_path: Path) -> None:
  _, _, found = leg
  found.save(tmp_path / "identified.json")
  words = [GO1, "--output", str(tmp_path / "scene")]
  assert cli.export_scene([*words, "--env.scene.entities.robot.overlay", str(tmp_path / "identified.json")]) == 0
  model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene" / "scene.xml"))
  assert model.joint(f"robot/{CALF}").armature[0] == pytest.approx(found.value(f"dof_armature:{CALF}"), rel=1e-5)
  assert model.actuator(f"robot/{THIGH}").gainprm[0] == pytest.approx(found.value(f"stiffness:{THIGH}"), rel=1e-5)


def test_the_command_writes_an_overlay_and_a_report(
  leg: tuple[EntityCfg, Record, Identified], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
  _, record, _ = leg
  records, output = tmp_path / "leg.npz", tmp_path / "identified.json"
  write_record(record, records)
  words = (f"armature:{CALF}", "--iterations", "2")
  assert fit(records, *words) == 0
  shown = capsys.readouterr().out
  assert f"dof_armature:{CALF}" in shown
  assert "fit: iteration 1, cost" in shown
  assert f"--env.scene.entities.robot.overlay {output}" in shown
  assert set(read_overlay(output).model) == {"dof_armature"}
  page = output.with_suffix(".html").read_text()
  assert "data:image/png;base64," in page
  assert "http" not in page
  assert fit(records, *words) == 2
  assert "identified.json exists" in capsys.readouterr().err


def test_resume_continues_a_fit_that_was_ended(
  leg: tuple[EntityCfg, Record, Identified],
  tmp_path: Path,
  monkeypatch: pytest.MonkeyPatch,
  capsys: pytest.CaptureFixture[str],
) -> None:
  records, output = tmp_path / "leg.npz", tmp_path / "identified.json"
  write_record(leg[1].rows(slice(0, 100)), records)
  words = (f"armature:{CALF}", f"stiffness:{THIGH}")
  with monkeypatch.context() as patch:
    # As if Ctrl-C came during the first iteration.
    patch.setattr("mjlab.cli._sysid.stop_on_ctrl_c", lambda: contextlib.nullcontext([2]))
    assert fit(records, *words) == 0
  assert "the same command with --resume continues it from" in capsys.readouterr().out
  assert Path(f"{output}.progress").exists()
  assert fit(records, words[0], "--resume") == 1
  assert "identified.json.progress: it is of other records, parameters or settings" in capsys.readouterr().err
  assert fit(records, *words, "--resume") == 0
  assert "stopped" not in capsys.readouterr().out
  assert not Path(f"{output}.progress").exists()
  scores = json.loads(output.read_text())["scores"]
  assert all(score["after"] < 0.8 * score["before"] for score in scores)


RECORD_OF_LEG = f"time,position/{CALF},position_target/{CALF}\n" + "".join(
  f"{0.01 * k:.2f},{-1.8 + 0.001 * (k % 7):.4f},-1.8\n" for k in range(60)
)


@pytest.mark.parametrize(
  ("old", "new", "message"),
  [
    ("\n0.20,", "\n0.10,", "row 21: time 0.1 s is not after that of the previous row; sort the rows"),
    ("-1.7950", "nan", "line 7, column 'position/FR_calf_joint': 'nan' is not a finite number"),
    ("/FR_calf_joint,", "/FR_calf_joint [degrees],", "unit of position 'degrees' does not exist"),
    (",-1.7", ",-103", "name the unit, such as 'position/FR_calf_joint [deg]'"),
    ("FR_calf_joint", "FR_knee_joint", "joint 'FR_knee_joint' does not exist"),
    ("position_target", "target", "no joint has a command"),
  ],
)
def test_a_wrong_record_is_one_line(
  tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, message: str
) -> None:
  (tmp_path / "leg.csv").write_text(RECORD_OF_LEG.replace(old, new))
  assert fit(tmp_path / "leg.csv", f"armature:{CALF}") in (1, 2)
  error = capsys.readouterr().err
  assert message in error
  assert error.count("\n") == 1
  assert {path.name for path in tmp_path.iterdir()} == {"leg.csv"}


def test_a_gap_is_one_warning_and_columns_have_any_order(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
  lines = [",".join(reversed(line.split(","))) for line in RECORD_OF_LEG.splitlines()]
  (tmp_path / "leg.csv").write_text("\n".join((*lines[:30], *lines[40:])) + "\n")
  assert fit(tmp_path / "leg.csv", f"armature:{CALF}", "--window", "0.1", "--iterations", "1") == 0
  shown = [line for line in capsys.readouterr().out.splitlines() if line.startswith("warning: ")]
  assert len(shown) == 1
  assert "1 gaps, the longest of 0.11 s, while rows are 0.01 s apart; each begins a new stretch" in shown[0]


def test_randomisation_has_the_width_of_the_uncertainty(leg: tuple[EntityCfg, Record, Identified]) -> None:
  found = leg[2]
  randomizers = {randomizer.field: randomizer for randomizer in found.randomizers(width=2.0)}
  assert set(randomizers) == {"dof_armature", "stiffness", "pseudo_inertia", "encoder_bias"}
  (armature,) = randomizers["dof_armature"].values.values()
  low, high = armature.support()
  value = found.value(f"dof_armature:{CALF}")
  assert low < value < high
  assert high - value == pytest.approx(2.0 * found.information.std[0])


@pytest.mark.parametrize(
  ("content", "message"),
  [
    (None, r"overlay .*a\.json: no such file"),
    ("{", "overlay .*a.json: "),
    ("[]", "expected an object with format 'mjlab overlay 1'"),
    ({"model": {"dof_armatur": {"knee": 1.0}}}, "field 'dof_armatur' does not exist. Nearest: dof_armature"),
    ({"model": {"geom_friction": {"FR_foot_collision": [1.0]}}}, "geom_friction must have at least 3 elements"),
    ({"model": {"dof_armature": {"knee": 1.0}}}, "joint 'knee' does not exist"),
    ({"model": {"geom_pos": {"foot": [0.0, 0.0, 0.0]}}}, "geom 'foot' does not exist"),
    ({"actuators": {"gain": {}}}, "actuator parameter 'gain' does not exist"),
    ({"actuators": {"stiffness": {"knee": 1.0}}}, "no actuator config has the stiffness of 'knee'"),
    ({"delay": {"FR_calf_joint": 0.1}}, "delays must lie between 0 and 1000 timesteps of 0 s"),
    ({"encoder_bias": {"FR_calf_joint": float("nan")}}, "encoder_bias must be a number"),
  ],
)
def test_a_wrong_overlay_is_refused_in_one_line(tmp_path: Path, content: object, message: str) -> None:
  text = json.dumps({"format": "mjlab overlay 1"} | content) if isinstance(content, dict) else str(content)
  path = tmp_path / "a.json"
  if content is not None:
    path.write_text(text)
  cfg = go1(meshes="never")
  cfg.overlay = str(path)
  with pytest.raises(MjlabError, match=message) as raised:
    cfg.build("robot")
  assert "\n" not in str(raised.value)
