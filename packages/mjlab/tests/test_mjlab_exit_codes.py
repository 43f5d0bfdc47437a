"""Wrong command lines and failures of every command: one line, its exit code, and no file written or changed."""

import re
import shlex
from collections.abc import Generator
from importlib import metadata
from pathlib import Path
from typing import Any

import mjlab
import mjlab_pendulum
import pytest
from mjlab import cli
from mjlab.demos import shipped
from mjlab_rl import TaskCfg

ROOT = Path(__file__).parents[3]
TASK = mjlab_pendulum.TASK
GO1 = "Mjlab-Velocity-Flat-Unitree-Go1"
WITH_TASK = ("train", "play", "evaluate", "record-motion", "inspect-dr", "design-excitation", "sweep", "export-scene")
WITH_FILE = {
  "convert-motion": "a.csv",
  "export": "run",
  "viz-nan": "a.npz",
  "sysid": "a.csv",
  "train-actuator": "a.csv",
}

TRAIN = f"train {TASK} --device cpu"
PLAY = f"play {TASK} --device cpu"
EVALUATE = f"evaluate {TASK} --device cpu"
ZERO = f"{EVALUATE} --agent zero"
GRID = "evaluate {} --device cpu --agent zero --quiet --grid"
RECORD = "record-motion Mjlab-Tracking-Flat-Unitree-G1 --device cpu --agent zero"
INSPECT = f"inspect-dr {TASK}"
CLIP = "convert-motion march.csv --rate 50"
STAIRS = "visualize-terrain stairs_up --image never.png"
MOTOR = "train-actuator motor.csv"
FIT = f"sysid a.csv --task {GO1} --fit"
EXCITE = f"design-excitation {GO1}"

# Mistakes on the command line: exit code 2.
WRONG = [
  *((command, "no TASK given") for command in WITH_TASK),
  *((f"{command} Test-Pendulun", "Nearest: Test-Pendulum") for command in WITH_TASK),
  *((f"{command} {TASK} --nope 1", "--nope: no such option") for command in WITH_TASK),
  *((f"{command} {TASK} --traceback 1", "--traceback: expected no value") for command in WITH_TASK[:-1]),
  *((command, " given. usage: ") for command in WITH_FILE),
  *((f"{command} {file} --nope 1", "--nope: no such option") for command, file in WITH_FILE.items()),
  ("trian", "command 'trian' does not exist. Nearest: train"),
  ("help trian", "Nearest: train"),
  ("new", "error: nothing given. usage: new robot FILE"),
  ("new robott", "Nearest: robot. All 2: robot, task. usage: new robot FILE"),
  ("demo --task lit", "demo 'lit' does not exist"),
  ("demo walk", f"'walk': not a flag; --task selects the policy: {', '.join(shipped())}\n"),
  ("list-envs --nope", "--nope: no such option"),
  ("list-envs --all", "--all"),
  (f"train --device cpu {TASK}", "no TASK given"),
  (f"{TRAIN} --help no_such_flag", "no flag has 'no-such-flag' in its name"),
  (f"{TRAIN} --env.rewards.alife.weight 1", "--env.rewards.alife.weight: no such option. Did you mean --env.rewards.a"),
  (f"{TRAIN} --num-envs 3", "--num-envs: no such option. Did you mean --env.scene.num-envs?"),
  (f"{TRAIN} --devise cpu", "--devise: no such option. Did you mean --device?"),
  (f"{TRAIN} --verbose yes", "--verbose: expected no value (--no-verbose switches it off), got yes"),
  (f"{TRAIN} --seed x", "--seed: expected {None}|INT, got x"),
  (f"{TRAIN} --resume nothing", "'nothing' is neither a checkpoint nor a run"),
  (f"{TRAIN} --init-from nothing", "'nothing' is neither a checkpoint nor a run"),
  (f"{TRAIN} --init-from x --resume y", "exclude each other: a resumed run keeps its policy"),
  (f"{TRAIN} --init-from Test-Pendulun", "Nearest task: Test-Pendulum"),
  (f"{TRAIN} --seed 1 --resume", "exclude each other: a resumed run keeps its random numbers"),
  (f"{TRAIN} --agent flashsax", "learner 'flashsax' does not exist. Nearest: flashsac"),
  (f"{TRAIN} --agent --quiet", "learner '' does not exist"),
  (f"{TRAIN} --agent=fastsac --resume", "--agent and --resume exclude each other"),
  *((f"{TRAIN} --gpus {gpus}", f"--gpus {gpus}: ") for gpus in ("0", "two", "0,0")),
  (f"{TRAIN} --agent.torch-compile-mode maximal", "--agent.torch-compile-mode: expected {None,default,"),
  (f"{TRAIN} --agent.max-iterations 0", "agent.max_iterations must be at least 1, got 0"),
  (f"{TRAIN} --agent.obs-groups.actor acto", "acto"),
  (f"{TRAIN} --viewer --viewer-port 99999", "port 99999 does not exist; use 1 to 65535"),
  (f"{TRAIN} --video --video-length 0", "--video-length must be at least 1, got 0"),
  (f"{TRAIN} --video --video-interval 5", "--video-length must be at most --video-interval, 5"),
  (f"train {TASK} --device cuda:77", "device 'cuda:77' does not exist"),
  (f"train {TASK} --device gpu", "device 'gpu' does not exist"),
  (f"{TRAIN} --env.actions.torque.actuators hings", "Nearest: hinge"),
  (f"{TRAIN} --env.sim.engine warp --env.sim.solver pgs", "mjSOL_PGS is unsupported. Its solvers are"),
  (f"{TRAIN} --env.decimation 0", "env.decimation must be at least 1, got 0"),
  (PLAY, "no run of Test-Pendulum with a checkpoint in"),
  *((f"{PLAY} --checkpoint missing.{kind}", "is neither a checkpoint nor a run") for kind in ("pt", "onnx")),
  (f"{PLAY} --agent chance", "--agent: expected"),
  (f"{PLAY} --viewer none", "--viewer none shows nothing; add --video FILE.mp4"),
  (f"{PLAY} --video film.gif", "--video: film.gif does not end in .mp4"),
  (f"{PLAY} --video film.mp4 --video-length inf", "--video-length must be finite, got inf"),
  (f"{PLAY} --agent zero --speed 0", "--speed must be positive, got 0"),
  (f"play {TASK} --device cuda:7", "device 'cuda:7' does not exist"),
  (EVALUATE, "no run of Test-Pendulum with a checkpoint"),
  *(
    (f"{EVALUATE} --checkpoint {name}", f"'{name}' is neither a checkpoint nor a run") for name in ("gone.onnx", "gone")
  ),
  (f"{EVALUATE} --eval.episode 3", "--eval.episodes"),
  (f"{ZERO} --require 'length>25'", "expected [GROUP:]METRIC>=NUMBER"),
  (f"{ZERO} --require ''", "expected [GROUP:]METRIC>=NUMBER"),
  (f"{ZERO} --env.scene.num-envs 3", "--env.scene.num-envs: an evaluation plays one episode in each"),
  (f"{ZERO} --require 'lenght>=25' --quiet", "metric 'lenght' does not exist. Nearest: length"),
  (f"{GRID.format(TASK)} payload=1", "ReturnEvaluation, the evaluation of Test-Pendulum, has no levels"),
  (f"{GRID.format(GO1)} mass=1,2", "event 'mass' does not exist"),
  (f"{GRID.format(GO1)} payload", "'payload' is not of the form EVENT=NUMBER,NUMBER,..."),
  (RECORD, "--output is missing: name the clip's file"),
  (f"{RECORD} --output clip.csv", "--output: clip.csv does not end in .npz"),
  (f"{RECORD} --output there.npz", "there.npz exists; --force"),
  (f"{RECORD} --output clip.npz --seconds nan", "--seconds must be a number, got nan"),
  (f"{RECORD} --output clip.npz --skip -1", "--skip must not be negative, got -1"),
  (f"{RECORD} --output clip.npz --entity robbot", "entity 'robbot' does not exist. Nearest: robot"),
  (f"{INSPECT} --num-env 4", "--num-envs"),
  (f"{INSPECT} --num-envs many", "many"),
  (f"{INSPECT} --num-envs 1", "--num-envs must be at least 2, got 1"),
  (f"{INSPECT} --seed", "--seed"),
  (f"{INSPECT} --device tpu", "device 'tpu' does not exist"),
  (f"{INSPECT} --png picture.jpg", "does not end in .png"),
  (f"{INSPECT} --png there.png", "there.png exists; --force overwrites it"),
  ("export gone", "'gone' is neither a checkpoint nor a run"),
  ("export gone --steps -1", "--steps must not be negative"),
  ("viz-nan gone.npz", "gone.npz: no such file"),
  ("viz-nan --fast x", "no FILE given"),
  ("convert-motion gone.csv", "gone.csv: no such file"),
  ("convert-motion march_in_plaze", "clip 'march_in_plaze' does not exist. Nearest: march_in_place"),
  ("convert-motion march_in_place --robot g2", "robot 'g2' does not exist. Nearest: g1"),
  ("convert-motion march_in_place --crop 5 1", "cannot crop it to 5 .. 1 s"),
  ("convert-motion march_in_place --preview --port 0", "port 0 does not exist"),
  ("convert-motion .", "clip '.' does not exist"),
  (f"{CLIP} --output there.npz", "there.npz exists; --force"),
  (f"{CLIP} --video there.mp4", "there.mp4 exists; --force"),
  (f"{CLIP} --output march.csv", "march.csv does not end in .npz"),
  (f"{CLIP} --report report.txt", "report.txt does not end in .png"),
  (f"{CLIP} --video film.gif", "film.gif does not end in .mp4"),
  ("convert-motion march.csv march.csv --rate 50 --preview", "--preview shows one clip, not 2"),
  ("convert-motion march.csv march.csv --rate 50 --output one.npz", "2 clips need a folder"),
  ("convert-motion march.csv march.csv --rate 50 --output two", "two clips would have the same file name in two"),
  *((f"{CLIP} --crop {crop}", "lasts 1.180 s") for crop in ("0.5 9", "nan 1")),
  *((f"{CLIP} --output-rate {rate}", "resample: rate must be") for rate in ("0", "nan")),
  *((f"{CLIP} --smooth {width}", "smooth: width must be") for width in ("inf", "nan")),
  (f"{CLIP} --concatenate nan", "concatenate: blend must be a number"),
  ("visualize-terrain stair --image never.png", "type 'stair' does not exist. Nearest: stairs_up"),
  ("visualize-terrain --rows 0", "rows 0 must be at least 1"),
  ("visualize-terrain waves --seed -1 --image never.png", "seed -1 must be at least 0"),
  ("visualize-terrain flat --plot --image x.jpg --image-size 80 60", "x.jpg"),
  (f"{STAIRS} --difficulty 0 0.5 1", "--difficulty must have at most 2 elements, got (0.0, 0.5, 1.0)"),
  (f"{STAIRS} --plot --image-size 0 9", "--image-size must be at least 1, got (0, 9"),
  (f"{STAIRS} --set platform=9", "make the platform at most 5.9 m"),
  (f"{STAIRS} --set waves.amplitude=0,1", "there is no type 'waves' here. There are stairs_up"),
  (f"{STAIRS} --set hight=3", "there is no setting 'hight'. There are border"),
  (f"{STAIRS} --set step_height=3", "must be like (0.0, 0.2), without brackets"),
  (f"{STAIRS} --set holes", "must be like False"),
  ("train-actuator gone.csv", "record gone.csv: no such file"),
  ("train-actuator --force", "no RECORD given"),
  (f"{MOTOR} --histroy-length 2", "no such option. Did you mean --history-length?"),
  (f"{MOTOR} --epochs many", "--epochs: expected INT, got many"),
  (f"{MOTOR} --activation relo", "--activation: expected"),
  (f"{MOTOR} --output motor.csv --force", "--output: motor.csv is one of the records"),
  (f"{MOTOR} --output . --force", "--output: . is a folder; name a file in it"),
  ("sysid a.csv --fit armature:.*", "task '' does not exist"),
  (f"sysid a.csv --task {GO1}", "--fit must have at least 1 element"),
  ("sysid a.csv --task Mjlab-Velocity-Flat-Unitree-Go --fit armature:.*", "task 'Mjlab-Velocity-Flat"),
  (f"{FIT} armour:.*", "field 'armour' does not exist"),
  (f"{FIT} armature:.*", "record a.csv: no such file"),
  (EXCITE, "--fit must have at least 1 element"),
  (f"{EXCITE} --fit armour:.*", "field 'armour' does not exist"),
  (f"{EXCITE} --fit armature:.* --joints FR_knee", "pattern 'FR_knee' matches no driven joint"),
  (f"{EXCITE} --fit armature:.* --output a.txt", "a.txt does not end in .csv"),
  (f"sweep {TASK}", "--space FILE is missing"),
  (f"sweep {TASK} --resume absent", "no such file"),
]

# Failures behind a right command line: exit code 1.
FAILED = [
  (f"{CLIP} --joint-map list.json", "Expected `object`, got `array`; expected {"),
  (f"{CLIP} --joint-map damaged.csv", "JSON is malformed"),
  ("convert-motion there.pkl", "there.pkl: expected .csv or .npz"),
  ("convert-motion march.csv --rate 1e-320", "rate must be in [1, 10000]"),
  ("convert-motion march.csv", "state it with --rate"),
  (f"{TRAIN} --seed {2**64}", "env.seed must be in"),
  # More than any machine has addresses for: it must not be tried.
  (f"{TRAIN} --env.scene.num-envs {10**15}", "not enough memory"),
  (f"{TRAIN} --agent.num-steps-per-env {10**15}", "not enough memory"),
  (f"{TRAIN} --viewer --viewer-host 192.0.2.1", "cannot listen on 192.0.2.1"),
  (f"{TRAIN} --log-root damaged.csv", "damaged.csv"),
  (f"{PLAY} --agent zero --num-envs 0", "num_envs"),
  (f"{PLAY} --agent zero --viewer browser --host 192.0.2.1", "192.0.2.1: Cannot assign requested address\n"),
  (f"{PLAY} --agent zero --video damaged.csv/film.mp4", "damaged.csv"),
  *((f"{ZERO} --output damaged.csv{inside}", "damaged.csv") for inside in ("", "/folder")),
  ("convert-motion damaged.csv", "damaged.csv"),
  ("viz-nan damaged.npz", "NaN dump damaged.npz: not an .npz file\n"),
  ("train-actuator damaged.csv", "damaged.csv"),
  ("train-actuator broken.csv", "record broken.csv: line 3, column 'effort': 'much' is not a finite number"),
  (f"{MOTOR} --epochs 0", "epochs must be at least 1, got 0"),
  (f"export-scene {TASK} --output damaged.csv/folder", "damaged.csv"),
  ("visualize-terrain flat --plot --image damaged.csv/x.png --image-size 80 60", "damaged.csv"),
]

THERE = ("damaged.csv", "damaged.npz", "there.npz", "there.mp4", "there.png", "there.pkl")
FILES: dict[str, str] = dict.fromkeys(THERE, "nothing\n")
FILES["list.json"] = "[1]"
FILES["motor.csv"] = "time,position_target,position,velocity,effort\n0,0,0,0,0\n1,0,0,0,1\n2,0,0,0,1\n"
FILES["broken.csv"] = FILES["motor.csv"].replace("0,1\n", "0,much\n", 1)


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Generator[None]:
  monkeypatch.chdir(tmp_path)
  with mjlab_pendulum.registered():
    yield


@pytest.fixture(scope="module")
def clip() -> str:
  """60 frames of a clip that ships, at 50 Hz."""
  from mjlab_motions import load_motion, shipped_clips

  motion = load_motion(shipped_clips()["march_in_place"])
  rows = zip(motion.root_pos[:60].tolist(), motion.root_quat[:60].tolist(), motion.joint_pos[:60].tolist(), strict=True)
  return "".join(",".join(map(str, (*pos, *quat, *joints))) + "\n" for pos, quat, joints in rows)


@pytest.mark.parametrize(("line", "message", "code"), [*((*row, 2) for row in WRONG), *((*row, 1) for row in FAILED)])
def test_a_refusal_is_one_line_and_an_exit_code_and_writes_nothing(
  line: str, message: str, code: int, clip: str, capsys: pytest.CaptureFixture[str]
) -> None:
  files = FILES | {"march.csv": clip}
  for name, text in files.items():
    Path(name).write_text(text)
  assert cli.main(shlex.split(line)) == code
  shown = capsys.readouterr()
  assert shown.err.startswith("error: ")
  assert shown.err.count("\n") == 1
  assert message in shown.err
  # No work was done.
  assert not shown.out or line.startswith(("train", "play", "convert-motion")) or "lenght" in line
  assert {path.name: path.read_text() for path in Path.cwd().iterdir()} == files


def test_a_configuration_that_is_wrong_without_flags_is_a_failure(capsys: pytest.CaptureFixture[str]) -> None:
  def broken() -> "TaskCfg[Any]":
    task = mjlab_pendulum.pendulum()
    task.env.decimation = 0
    return task

  mjlab.register_task("Test-Broken", broken)
  assert cli.main(["inspect-dr", "Test-Broken", "--num-envs", "2"]) == 1
  assert "decimation must be at least 1, got 0" in capsys.readouterr().err


def test_every_command_is_installed_and_documented_and_each_flag_has_one_line_with_choices_and_default(
  capsys: pytest.CaptureFixture[str],
) -> None:
  shown = []
  for words, code in (([], 2), (["--help"], 0)):
    assert cli.main(words) == code
    shown.append(capsys.readouterr().out)
  assert shown[0] == shown[1]
  commands = {line.split()[0] for line in shown[0].splitlines() if line.startswith("  ")}
  scripts = {point.name for point in metadata.entry_points(group="console_scripts") if point.value.startswith("mjlab.")}
  rows = re.findall(r"^\| `([\w-]+)` \|(.*)$", (ROOT / "docs/commands.md").read_text(), re.MULTILINE)
  assert {name for name, _ in rows} == commands == scripts - {"mjlab"}
  assert cli.main(["play", "--help"]) == 0
  playing = capsys.readouterr().out
  for name, cells in rows:
    assert cli.main([name, "--help"]) == 0
    text = capsys.readouterr().out
    assert f"usage: {name} " in text
    assert "  " not in text.partition("flags:")[0], name
    for flag in re.findall(r"`(--[\w-]+)`", cells):
      assert f"  {flag} " in (playing if name == "demo" else text), (name, flag)
    lines = [line for line in text.partition("flags:\n")[2].partition("  --help")[0].splitlines() if "  --" in line]
    assert lines or name in ("list-envs", "new"), name
    for line in lines:
      assert re.match(r"  --[\w-]+( [^\[\]]+)? \[[^\]]+\]( |$)", line), (name, line)
