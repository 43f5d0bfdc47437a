"""Torch's compiler after pictures: software OpenGL must not be the first to load an LLVM."""

import importlib.util
import os
import subprocess
import sys

import pytest

PICTURES = {
  "viewer": "from mjlab_viewer.pictures.opengl import make_context; kept = make_context(64, 64)",
  "terrain": "from mjlab_terrain import FlatCfg, TerrainGridCfg\nfrom mjlab_terrain.view.picture import render\n"
  "render(TerrainGridCfg(types={'flat': FlatCfg()}, rows=1), (32, 32))",
  "deploy": "from mjlab_deploy.simulation.camera import _opengl; kept = _opengl(64, 64)",
}


@pytest.mark.skipif(importlib.util.find_spec("triton") is None, reason="Triton is not installed")
@pytest.mark.parametrize("code", PICTURES.values(), ids=PICTURES)
def test_the_compiler_is_imported_after_a_picture(code: str) -> None:
  """Class: every place that makes an OpenGL context. Before, a process died that imported torch's compiler later."""
  program = f"{code}\nprint('drawn', flush=True)\nimport triton._C.libtriton\nprint('imported')"
  environment = {**os.environ, "MUJOCO_GL": "egl"}
  done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment)
  if "drawn" not in done.stdout:
    pytest.skip(f"OpenGL does not work here: {done.stderr[-200:]}")
  assert (done.returncode, done.stdout.split()) == (0, ["drawn", "imported"]), done.stderr
