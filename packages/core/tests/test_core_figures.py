"""Figures of matplotlib, which is optional."""

import io
import sys
from pathlib import Path

import matplotlib as mpl
import pytest
from mjlab_core.io.figures import figure


def test_a_figure_is_a_png_in_a_file_or_in_memory_and_leaves_the_settings(tmp_path: Path) -> None:
  size, memory = mpl.rcParams["font.size"], io.BytesIO()
  for target in (tmp_path / "new" / "plot.png", memory):
    with figure(target, (1.0, 0.5), package="mjlab-core", dpi=100, style={"font.size": 3}) as made:
      made.subplots().plot([0.0, 1.0])
  assert mpl.rcParams["font.size"] == size
  for data in ((tmp_path / "new" / "plot.png").read_bytes(), memory.getvalue()):
    assert data.startswith(b"\x89PNG")
    assert [int.from_bytes(data[at : at + 4], "big") for at in (16, 20)] == [100, 50]


def test_without_matplotlib_the_message_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
  monkeypatch.setitem(sys.modules, "matplotlib", None)
  message = "a plot needs matplotlib: install mjlab-motions with its extra 'plot'"
  with (
    pytest.raises(ModuleNotFoundError, match=message),
    figure(tmp_path / "plot.png", (1.0, 1.0), package="mjlab-motions", dpi=100),
  ):
    pass
  assert not list(tmp_path.iterdir())
