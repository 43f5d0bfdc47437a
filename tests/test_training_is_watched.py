"""The page that a training serves."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest
from mjlab_command import running
from playwright.sync_api import Browser
from viewer_page import eventually, patient_page, pixels, press_until

TRAIN = "import sys; from mjlab.cli import train; sys.exit(train(sys.argv[1:]))"
FLAGS = """--viewer --viewer-port 8730 --device cpu --env.scene.num-envs 1 --agent.algorithm.num-mini-batches 1
--agent.logger none --verbose""".split()


@pytest.mark.slow
def test_the_page_of_a_training_shows_its_robots_and_rewards_while_it_goes_on(
  chromium: Browser, tmp_path: Path
) -> None:
  def iterations() -> int:
    (progress,) = tmp_path.rglob("progress.csv")
    return len(list(csv.reader(progress.read_text().splitlines())))

  with running(TRAIN, "Mjlab-Velocity-Flat-Unitree-Go1", *FLAGS, folder=tmp_path, OMP_NUM_THREADS="1") as training:
    page = patient_page(chromium)
    page.goto(training.wait_for(r"watch at (http://\S+)\n")[1])

    def picture() -> np.ndarray:
      return pixels(page)[140:460]

    page.get_by_role("tab", name="Controls").wait_for()
    # More often than a page changes while it loads.
    for _ in range(3):
      before = picture()
      eventually(lambda before=before: (np.abs(picture() - before).max(axis=2) > 40).sum() > 1000, "nothing moves")
    page.get_by_text(re.compile(r"Iteration \d+ of \d+")).wait_for()
    assert page.get_by_text("Mjlab-Velocity-Flat-Unitree-Go1").first.is_visible()
    page.get_by_role("tab", name="Plots").click()
    page.get_by_text("track_linear_velocity").first.wait_for()
    seen = iterations()
    eventually(lambda: iterations() > seen, "a page that is open stops the training")
    page.close()
    left = iterations()
    eventually(lambda: iterations() > left, "a page that was closed stops the training")
    page = patient_page(chromium)
    page.goto(training.wait_for(r"watch at (http://\S+)\n")[1])
    stop = page.get_by_role("button", name="Save and stop")
    press_until(stop, lambda: "Stopping after this iteration" in training.said)
    training.wait_for(r"stopped \(SIGTERM\) after \d+ iterations; saved")
    eventually(lambda: training.exit_code is not None, "the training does not end")
    assert training.exit_code == 0
