"""Manifests from strangers run nothing and write nothing. They are refused in one line."""

import functools
import importlib
import json
from pathlib import Path
from typing import Any

import pytest
import rl_point_env
from hostile_manifests import PLACED, VICTIM, hostile, nothing_happens, partial, put, write
from mjlab_core.errors import ConfigError, FileError
from mjlab_rl import MjlabDistillationRunner, RslRlOnPolicyRunnerCfg, RunManifest, load_run, trust_package
from mjlab_rl.runs.encoding import decode, encode
from mjlab_rl.runs.manifest import encode_manifest


def manifest(**changes: Any) -> dict[str, Any]:
  return (
    encode_manifest(RunManifest(task="T", env=rl_point_env.PointEnvCfg(), agent=RslRlOnPolicyRunnerCfg())) | changes
  )


def test_a_hostile_manifest_is_refused_in_one_line_and_does_nothing(
  tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
  """Class of mistakes: reading a file calls something, or names something that is called with chosen arguments."""
  monkeypatch.chdir(tmp_path)
  for name in ("mujoco", "mjlab_rl.runner"):
    # The first import opens libraries.
    importlib.import_module(name)
  variants = hostile(manifest())
  assert len(variants) > 200
  accepted = []
  for reference, variant in variants:
    write(tmp_path, variant)
    try:
      with nothing_happens():
        load_run(tmp_path)
    except FileError as error:
      message = str(error)
      assert message.startswith(f"manifest {tmp_path / 'manifest.json'}: "), message
      assert reference[:40] in message
      assert message.isprintable()
      assert len(message) < 1500
    else:
      accepted.append(variant)
  assert not accepted
  assert not (tmp_path / VICTIM).exists()


@pytest.mark.parametrize(("place", "payload"), PLACED[:30], ids=lambda value: str(value)[:60])
def test_the_refusal_names_the_field(place: str, payload: Any, tmp_path: Path) -> None:
  write(tmp_path, put(manifest(), place, payload))
  field = place.replace(".fields", "")
  with pytest.raises(FileError, match=rf"manifest\.json: (\$\w+: )?{field}"):
    load_run(tmp_path)


def test_a_configuration_that_could_not_be_read_is_refused_when_the_run_starts() -> None:
  cfg = rl_point_env.PointEnvCfg(rewards={"f": functools.partial(rl_point_env.point_reward, weight=2.0)})
  with pytest.raises(ConfigError, match=r"env\.rewards\.f: a partial may stand only in"):
    encode_manifest(RunManifest(task="T", env=cfg, agent=RslRlOnPolicyRunnerCfg()))
  with pytest.raises(ConfigError, match=r"env\.rewards\.f: reference 'json:loads' is refused: .* could not be loaded"):
    encode(rl_point_env.PointEnvCfg(rewards={"f": json.loads}), "env")


def test_functions_partials_and_classes_of_trusted_packages_fit_fields_that_declare_them(tmp_path: Path) -> None:
  cfg = rl_point_env.PointEnvCfg(
    terms={"t": rl_point_env.PointTermCfg(func=functools.partial(rl_point_env.point_reward, weight=2.0))},
    entities={"e": rl_point_env.PointEntityCfg(spec_fn=functools.partial(rl_point_env.point_scene, 7))},
    rewards={"kind": rl_point_env.PointEnv, "plain": rl_point_env.point_scene},
  )
  options: Any = {"runner": MjlabDistillationRunner, "make_env": rl_point_env.PointEnv, "play": rl_point_env.play}
  write(tmp_path, encode_manifest(RunManifest(task="T", env=cfg, agent=RslRlOnPolicyRunnerCfg(), **options)))
  back = load_run(tmp_path)
  assert back.env.entities["e"].spec_fn() == rl_point_env.PointSceneCfg(num_envs=7)
  assert back.env.terms["t"].func.keywords == {"weight": 2.0}
  assert {name: getattr(back, name) for name in options} == options
  assert back.env.rewards == cfg.rewards


def test_output_folders_are_not_taken_from_a_file(tmp_path: Path) -> None:
  write(tmp_path, put(manifest(), "env.fields.output_dir", "/somewhere/else"))
  assert load_run(tmp_path).env.output_dir is None


def test_a_package_is_trusted_by_name_only(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
  (tmp_path / "their_robots").mkdir()
  (tmp_path / "their_robots" / "__init__.py").write_text("def spec(): ...\nclass Robot: ...\n")
  monkeypatch.syspath_prepend(tmp_path)
  with pytest.raises(FileError, match=r"'their_robots' is not trusted.*mjlab_rl\.trust_package\('their_robots'\)"):
    decode({"$ref": "their_robots:spec"}, "env")
  trust_package("their_robots")
  assert decode({"$ref": "their_robots:spec"}, "env").__name__ == "spec"


def test_a_module_outside_the_folder_of_its_package_is_not_imported(
  monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
  (tmp_path / "inside").mkdir()
  (tmp_path / "inside" / "__init__.py").write_text("")
  (tmp_path / "elsewhere.py").write_text(f"open({str(tmp_path / VICTIM)!r}, 'w')\ndef run(): ...\n")
  (tmp_path / "inside" / "linked.py").symlink_to(tmp_path / "elsewhere.py")
  monkeypatch.syspath_prepend(tmp_path)
  trust_package("inside")
  with pytest.raises(FileError, match=r"no module 'inside\.linked' in the folder of package 'inside'"):
    decode(partial("inside.linked:run"), "env")
  assert not (tmp_path / VICTIM).exists()
