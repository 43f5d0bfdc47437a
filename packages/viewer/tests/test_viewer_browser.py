"""The page of the browser viewer: pictures, controls, films and connections."""

import asyncio
import importlib.metadata
import itertools
import socket
import sys
import threading
import zipfile
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import av
import msgspec
import mujoco
import numpy as np
import pytest
import torch
import trimesh
import viser
from mjlab_core import MjlabError
from mjlab_viewer import BrowserViewer, CheckpointList, Playback, Replay, SnapshotTaker, ZeroPolicy
from mjlab_viewer.browser import viser_internals
from mjlab_viewer.browser.controls import _ratio
from mjlab_viewer.browser.viser_internals import LoopEvent
from mjlab_viewer.browser.world import mjviser_scene
from mjlab_viewer.browser.world.groups import geom_labels, site_labels
from mjlab_viewer.browser.world.mjviser_scene import PRIVATE_FUNCTIONS, PRIVATE_NAMES, TESTED_VERSION, MujocoScene
from mjviser import conversions
from playwright.sync_api import Browser, Page
from viewer_env import GROUND, BoxEnv
from viewer_page import (
  Served,
  choose,
  closing_pages,
  eventually,
  headless_chromium,
  inputs_of,
  is_red,
  opened,
  pixels,
  press_until,
  row,
  served,
  slide,
  stepping,
)
from viser import _icons as icons
from websockets.sync.client import connect
from websockets.typing import Subprotocol


@pytest.fixture(scope="module")
def launched() -> Iterator[Browser]:
  with headless_chromium() as browser:
    yield browser


@pytest.fixture
def chromium(launched: Browser) -> Iterator[Browser]:
  with closing_pages(launched) as browser:
    yield browser


Policies = dict[str, Callable[..., torch.Tensor]]


@contextmanager
def running(env: BoxEnv, folder: Path, policies: Policies | None = None) -> Generator[Served]:
  """Run a viewer of boxes in a thread, with the first policy loaded and the others to choose from."""
  known = policies or {"zero": ZeroPolicy(env.num_envs, 1, env.sim.device)}
  first = next(iter(known))
  checkpoints = CheckpointList(names=lambda: list(known), load=known.__getitem__, loaded=first)
  options: dict[str, Any] = {"checkpoints": checkpoints, "max_worlds": 5, "video_folder": folder}
  with served(env, known[first], **options) as run, stepping(run.viewer):
    yield run


def red(page: Page) -> int:
  """Return the number of red pixels."""
  return is_red(pixels(page)).sum()


def blue(page: Page) -> int:
  """Return the number of blue pixels above the axes in the corner."""
  return is_red(pixels(page)[:460, :, ::-1]).sum()


def push(value: float, env: BoxEnv) -> Callable[..., torch.Tensor]:
  return lambda observations: torch.full((env.num_envs, 1), value)


def test_every_control_of_the_page_does_what_it_says(chromium: Browser, tmp_path: Path) -> None:
  env = BoxEnv(7)
  policies = {"first": push(0.0, env), "second": push(3.0, env)}
  with running(env, tmp_path, policies) as run:
    playback, viewer = run.playback, run.viewer
    page = opened(chromium, run.viewer.url)
    eventually(lambda: red(page) > 300, "the robot is not seen")

    page.get_by_role("button", name="Pause").click()
    page.get_by_role("button", name="Play", exact=True).wait_for()
    assert playback.paused
    before = playback.step_count
    page.get_by_role("button", name="Step").click()
    eventually(lambda: playback.step_count == before + 1)
    page.get_by_role("button", name="Reset").click()
    eventually(lambda: playback.step_count == 0)

    choose(page, "Speed", "2")
    eventually(lambda: playback.speed == 2.0)
    slide(page, "World", 3)
    eventually(lambda: viewer.selection.worlds == (3, 4, 5, 6, 0))
    slide(page, "Shown", 2)
    eventually(lambda: viewer.selection.worlds == (3, 4))
    eventually(lambda: len(viewer.history[-1].worlds) == 2)

    page.get_by_label("Manual").check()
    slide(page, "forward", 0.5)
    eventually(lambda: env.command.manual.get(3) == (0.5, 0.0))
    page.get_by_role("button", name="Stop", exact=True).click()
    eventually(lambda: env.command.manual.get(3) == (0.0, 0.0))
    page.get_by_label("Manual").uncheck()
    eventually(lambda: 3 not in env.command.manual)

    page.get_by_text("Push").click()
    press_until(page.get_by_role("button", name="left"), lambda: env.sim.data.qvel[3, 1] > 0.99)
    assert env.sim.data.qvel[[0, 1, 2, 4, 5, 6], 1].abs().max() < 1e-6

    assert not viewer.history[-1].drawings[0].shapes
    page.get_by_label("command speed").check()
    eventually(lambda: viewer.history[-1].drawings[0].shapes)
    page.get_by_label("Follow").uncheck()
    eventually(lambda: not viewer.scene.scene.camera_tracking_enabled)
    page.get_by_label("Follow").check()

    choose(page, "Checkpoint", "second")
    eventually(lambda: playback.policy is policies["second"])
    policies["third"] = push(1.0, env)
    page.get_by_role("button", name="Newest").click()
    eventually(lambda: playback.policy is policies["third"])

    page.get_by_role("tab", name="Overlays").click()
    page.get_by_label("Enabled").first.check()
    page.get_by_label("Enabled").nth(1).check()
    eventually(lambda: viewer.scene.scene.show_contact_points and viewer.scene.scene.show_contact_forces)
    page.get_by_role("tab", name="Plots").click()
    page.locator(".uplot").first.wait_for()
    page.get_by_text("height").first.wait_for()
    groups = [group for group, (names, _) in env.signals().items() if len(names)]
    page.get_by_text("above").first.wait_for()
    row(page, "Filter").nth(groups.index("observations actor")).locator("input").fill("cross")
    eventually(lambda: page.get_by_text("above").count() == 0, "the filter leaves all curves")
    page.get_by_text("across").first.wait_for()
    page.get_by_role("tab", name="Controls").click()
    page.get_by_role("button", name="Play", exact=True).click()
    eventually(lambda: playback.step_count > 20)
    drawn = viewer.scene._shapes._handles
    for shape in ("ellipsoid", "head"):
      eventually(lambda shape=shape: shape in drawn and len(drawn[shape].batched_positions) >= 4, f"no {shape}")

    # Keys do as the buttons do.
    page.mouse.click(60, 400)
    page.keyboard.press("Space")
    eventually(lambda: playback.paused, "space does not pause")
    before = playback.total_steps
    page.keyboard.press("ArrowRight")
    eventually(lambda: playback.total_steps == before + 1, "the arrow does not step")
    page.keyboard.press("Enter")
    eventually(lambda: playback.step_count == 0, "enter does not reset")
    page.keyboard.press("Space")
    eventually(lambda: not playback.paused, "space does not go on")
    assert playback.error is None
    page.close()


def test_a_paused_page_goes_back_in_time(chromium: Browser, tmp_path: Path) -> None:
  env = BoxEnv(1)
  with running(env, tmp_path, {"slide": push(2.0, env)}) as run:
    page = opened(chromium, run.viewer.url)
    eventually(lambda: run.playback.step_count > 60 and len(run.viewer.history) > 10)
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("button", name="Play", exact=True).wait_for()
    eventually(lambda: run.shown.step == run.playback.total_steps)
    slide(page, "Seconds back", 0.6)
    eventually(lambda: run.shown.step < run.playback.total_steps)
    past, now = run.shown, run.viewer.history[-1]
    # A busy machine leaves pictures out.
    apart = int(np.diff([kept.step for kept in run.viewer.history]).max())
    assert past.step == pytest.approx(run.playback.total_steps - 0.6 / env.step_dt, abs=max(1, apart))
    assert past.data["qpos"][0, 0] < now.data["qpos"][0, 0]
    page.get_by_role("button", name="Play", exact=True).click()
    eventually(lambda: run.shown.step > now.step)
    page.close()


@pytest.mark.parametrize("tick", [0.001, 0.4])
def test_a_film_lasts_as_long_as_the_page_shows_on_a_slow_machine(
  tick: float, opengl: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
  """`tick` is the time between two readings of the clock [s]; a slow machine drops most steps that are due."""
  monkeypatch.setattr("mjlab_viewer.pictures.video._ROOM", 1)
  env, looks = BoxEnv(1), itertools.count()
  with served(env, clock=lambda: tick * next(looks), video_folder=tmp_path) as run:
    playback, viewer = run.playback, run.viewer

    def shown() -> float:
      return float(run.status().split(" s, world 0")[0].split()[-1])

    # More steps than pictures, and more than can be rendered meanwhile.
    playback.speed = 8.0
    films = []
    for _ in range(2):
      films.append(viewer.recorder.start())
      begin, first = shown(), playback.total_steps
      while playback.total_steps < first + 30:
        playback.tick()
        viewer.update()
      assert viewer.recorder.stop() == films[-1]
      assert playback.is_capped == (tick > 0.1)
      with av.open(str(films[-1])) as film:
        times = [frame.time for frame in film.decode(video=0)]
      assert len(times) == playback.total_steps - first
      assert times[-1] + env.step_dt == pytest.approx(shown() - begin)
    assert len(set(films)) == 2


def look(image: np.ndarray) -> np.ndarray:
  """Mean colour of red boxes, the ground's brightness, its shares of grey and of black [%], and the sky's darkest."""
  box = is_red(image)
  # Below the horizon, and below the note that the browser has no GPU.
  ground = image[140:][~box[140:]].max(axis=1)
  shares = (100.0 * (ground < 236).mean(), 100.0 * (ground < 120).mean())
  return np.array([*image[box].mean(axis=0), np.median(ground), *shares, image[:12].min()])


def test_a_film_has_the_ground_sky_and_colours_of_the_page(chromium: Browser, opengl: None, tmp_path: Path) -> None:
  model = mujoco.MjModel.from_xml_string(GROUND)
  replay = Replay(model, {"qpos": np.tile(model.qpos0, (4, 1, 1))}, 0.02)
  playback = Playback(replay, ZeroPolicy(1, 0, replay.sim.device))
  playback.pause()
  viewer = BrowserViewer(replay, playback=playback, port=8300, video_folder=tmp_path)
  path = viewer.recorder.start()
  playback.step_once()
  viewer.recorder.stop()
  with av.open(str(path)) as film:
    (frame,) = (frame.to_ndarray(format="rgb24").astype(int) for frame in film.decode(video=0))
  filmed = look(frame)
  assert filmed[3] > 250.0
  assert filmed[6] > 250.0
  # Lines and a shadow, but nothing black.
  assert 5.0 < filmed[4] < 30.0
  assert filmed[5] < 1.0
  with stepping(viewer):
    page = opened(chromium, viewer.url)
    eventually(lambda: red(page) > 300, "the box is not seen")
    seen: list[np.ndarray] = []

    def is_alike() -> bool:
      seen.append(look(pixels(page)))
      return bool((np.abs(seen[-1] - filmed) < (20.0, 20.0, 20.0, 5.0, 15.0, 1.0, 5.0)).all())

    try:
      eventually(is_alike)
    finally:
      print(f"film {filmed.round(1)}, page {seen[-1:]}")
    page.close()


def test_a_film_is_saved_and_errors_are_shown_until_the_viewer_goes_on(
  chromium: Browser, opengl: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
  env = BoxEnv(1)
  zeros = ZeroPolicy(1, 1, env.sim.device)
  broken = ""

  def policy(observations: object) -> torch.Tensor:
    if broken == "policy":
      raise RuntimeError("the policy <broke>")
    return zeros(observations)

  def draw(draw: object) -> None:
    if broken == "drawing":
      raise ZeroDivisionError("a drawing")

  env.command.debug_draw = draw
  env.draws_at_first = True
  with running(env, tmp_path, {"policy": policy}) as run:
    playback, page = run.playback, opened(chromium, run.viewer.url)

    page.get_by_role("button", name="Record").click()
    page.get_by_role("button", name="Stop recording").wait_for()
    first = playback.step_count
    eventually(lambda: playback.step_count > first + 10)
    page.get_by_role("button", name="Stop recording").click()
    eventually(lambda: list(tmp_path.glob("*.mp4")))
    page.get_by_text("saved as").wait_for()

    for broken, message in (
      ("drawing", "viewer: ZeroDivisionError: a drawing"),
      ("policy", "RuntimeError: the policy <broke>"),
    ):
      page.get_by_text(message).first.wait_for()
      assert playback.paused
      assert playback.error is not None
      assert playback.error.endswith(message)
      broken = ""
      page.get_by_role("button", name="Reset").click()
      eventually(lambda: playback.error is None and not playback.paused and playback.step_count > 5)

    # The thread that films meets its error when it makes its first context.
    monkeypatch.setenv("MUJOCO_GL", "disabled")
    page.get_by_role("button", name="Record").click()
    page.get_by_text("film: RenderingError: no pictures: ").first.wait_for()
    assert playback.paused
    page.get_by_role("button", name="Record").wait_for()
    page.get_by_role("button", name="Play", exact=True).click()
    eventually(lambda: not playback.paused and playback.error is None)
    page.close()
  assert len(list(tmp_path.iterdir())) == 1


def test_a_world_that_diverged_stays_where_it_was_and_hides_no_other() -> None:
  env = BoxEnv(3)
  with served(env) as run:
    page = run.viewer.scene
    page.scene.show_contact_forces = page.scene.show_inertia = True
    boxes = page.scene._mesh_groups[0].handle
    # A world that was never finite has the pose of the model.
    env.sim.datas[2].xpos[:] = np.nan
    for step in range(3):
      for data in env.sim.datas[:2]:
        data.xpos[1, 1] += 1.0
      if step == 1:
        for name in ("xpos", "xquat", "qpos"):
          getattr(env.sim.datas[0], name)[:] = np.nan
      if step == 2:
        env.reset()
      page.show(SnapshotTaker(env, contacts=True).take((0, 1, 2)))
      status = run.status()
      middle = page.scene.fixed_bodies_frame.position
      drawn = [handle.batched_positions for handle in (boxes, *page.scene._decor_handles.values())]
      assert all(np.isfinite(position).all() for position in (middle, *drawn))
      across = (boxes.batched_positions - middle)[:, 1]
      np.testing.assert_allclose(across, [(1, 1, 0), (1, 2, 0), (0, 0, 0)][step], atol=1e-6)
      assert ("world 0 is not finite" in status) == (step == 1)
      assert page.is_finite == (step != 1)


def colorful_env() -> BoxEnv:
  """Worlds 1 and 3 have blue boxes, world 2 a small red one with another ornament."""
  env = BoxEnv(4)
  model = env.sim.mj_model
  # Far enough to see all of them.
  model.stat.extent = 5.0
  box = model.geom("box").id
  env.sim.expand("geom_rgba")[[1, 3], box] = torch.tensor([0.1, 0.1, 0.9, 1.0])
  env.sim.expand("geom_size")[2, box] *= 0.5
  env.sim.expand("geom_dataid")[2, model.geom("ornament").id] = model.mesh("spike").id
  return env


def test_each_world_is_shown_with_its_appearance() -> None:
  env = colorful_env()
  with BrowserViewer(env, port=8300) as viewer:
    taker = SnapshotTaker(env)
    for worlds in ((0, 1, 2, 3), (1, 2, 3, 0), (0, 1, 2, 3)):
      viewer.scene.show(taker.take(worlds))
      others = viewer.scene.others.scenes
      assert len(others) == 2
      assert all(scene.root.visible for scene in others)
      shown = {
        scene.scene.mj_model.geom_rgba[1].tobytes() + scene.scene.mj_model.geom_size[1].tobytes(): len(
          scene.scene._mesh_groups[0].handle.batched_positions
        )
        for scene in (viewer.scene, *others)
      }
      assert sorted(shown.values()) == [1, 1, 2]
    for groups in ("geom_groups_visible", "site_groups_visible"):
      getattr(viewer.scene.scene, groups)[4] = True
    viewer.scene.show(taker.take((0, 1, 2, 3)))
    for scene in viewer.scene.others.scenes:
      assert scene.scene.geom_groups_visible[4]
      assert scene.scene.site_groups_visible[4]
    viewer.scene.show(taker.take((0,)))
    assert not any(scene.root.visible for scene in viewer.scene.others.scenes)


def test_colours_of_each_world_are_seen(chromium: Browser, tmp_path: Path) -> None:
  with running(colorful_env(), tmp_path) as run:
    page = opened(chromium, run.viewer.url)
    eventually(lambda: red(page) > 20 and blue(page) > 20)
    slide(page, "Shown", 1)
    eventually(lambda: run.viewer.selection.count == 1, "the slider did not arrive")
    eventually(lambda: blue(page) == 0 and red(page) > 20, "the blue box stays")
    page.close()


def test_two_pages_are_open_at_once_and_one_vanishes(chromium: Browser, tmp_path: Path) -> None:
  with running(BoxEnv(2), tmp_path) as run:
    first, second = opened(chromium, run.viewer.url), opened(chromium, run.viewer.url)
    eventually(lambda: len(run.viewer.server.get_clients()) == 2)
    eventually(lambda: red(first) > 300 and red(second) > 300)
    first.close(run_before_unload=False)
    eventually(lambda: len(run.viewer.server.get_clients()) == 1)
    second.get_by_role("button", name="Pause").click()
    eventually(lambda: run.playback.paused)
    second.close()
    eventually(lambda: not run.viewer.server.get_clients())
    run.playback.request(run.playback.resume)
    before = run.playback.step_count
    eventually(lambda: run.playback.step_count > before + 5)
    assert run.playback.error is None


def test_the_page_says_why_the_last_episode_of_the_selected_world_ended() -> None:
  env = BoxEnv(3, length=3)
  with served(env) as run:
    env.age[0], env.age[2] = 2, 1
    run.playback.pause()
    run.viewer.selection.world = 2
    for step in range(3):
      run.playback.step_once()
      assert ("last ended" in run.status()) == (step > 0), step
      assert ("world 2 last ended by too_old" in run.status()) == (step > 0), step
    assert run.playback.error is None


@pytest.mark.parametrize(("speed", "name"), [(1 / 32, "1/32"), (0.1, "1/10"), (0.3, "0.3"), (1.0, "1"), (2.5, "2.5")])
def test_speeds_are_named_as_fractions_where_they_are(speed: float, name: str) -> None:
  assert _ratio(speed) == name


def test_without_a_page_no_snapshots_are_taken() -> None:
  env = BoxEnv(1)
  with BrowserViewer(env, port=8300) as viewer:
    for _ in range(3):
      viewer.update()
    assert not viewer.history


def test_the_page_is_served_to_this_machine_alone_by_default() -> None:
  with BrowserViewer(BoxEnv(1), port=8300) as viewer:
    assert viewer.server.get_host() == "127.0.0.1"
    assert viewer.url == f"http://localhost:{viewer.server.get_port()}"


def test_a_connection_that_is_not_from_a_browser_leaves_no_traceback(caplog: pytest.LogCaptureFixture) -> None:
  with BrowserViewer(BoxEnv(1), port=8300) as viewer:
    for greeting in (b"", b"not HTTP\r\n\r\n"):
      with socket.create_connection(("127.0.0.1", viewer.server.get_port())) as stranger:
        stranger.sendall(greeting)
        stranger.shutdown(socket.SHUT_WR)
        while stranger.recv(4096):
          pass
  assert not [record for record in caplog.records if record.exc_info]


def test_a_viewer_closed_while_it_films_keeps_the_film_and_shows_no_more(opengl: None, tmp_path: Path) -> None:
  with served(BoxEnv(1), video_folder=tmp_path) as run:
    run.playback.pause()
    film = run.viewer.recorder.start()
    run.playback.step_once()
    run.status()
    assert (run.controls._record.label, run.controls._record.color) == ("Stop recording", "red")
    run.viewer.close()
    assert list(tmp_path.iterdir()) == [film]
    run.viewer.close()
    run.show()
    run.playback.step_once()
    assert run.playback.error is None


def test_an_address_of_another_machine_is_refused_by_name() -> None:
  with pytest.raises(MjlabError, match=r"cannot listen on 192\.0\.2\.1: "):
    BrowserViewer(BoxEnv(1), host="192.0.2.1", port=8300)


def test_curves_of_a_training_follow_its_steps_where_few_are_shown(monkeypatch: pytest.MonkeyPatch) -> None:
  env = BoxEnv(1)
  with BrowserViewer(env, port=8300) as viewer:
    monkeypatch.setattr(viewer.server, "get_clients", lambda: {0: None})
    for step in range(1, 701):
      env.step(torch.zeros(1, 1))
      viewer._due["frame"] = 0.0 if step % 2 else float("inf")
      viewer.update()
    assert viewer.error is None
    assert [kept.step for kept in viewer.history] == list(range(101, 701, 2))


def test_manual_commands_follow_the_selection_and_the_previous_world_gets_its_own_commands_again() -> None:
  with served(BoxEnv(3)) as run:
    steered = []
    for label, value in (("forward", 0.5), ("Manual", True), ("World", 2), ("forward", -1.0), ("Manual", False)):
      run.inputs[label].value = value
      run.show()
      run.playback.tick()
      steered.append(dict(run.env.command.manual))
    assert steered == [{}, {0: (0.5, 0.0)}, {2: (0.5, 0.0)}, {2: (-1.0, 0.0)}, {}]
    assert run.playback.error is None


def test_a_fixed_axis_keeps_its_value_while_others_move() -> None:
  env = BoxEnv(1)
  env.command.axes = (("forward", -1.0, 1.0), ("left", 0.25, 0.25))
  with served(env) as run:
    run.inputs["Manual"].value = True
    for value in (0.5, 0.0):
      run.inputs["forward"].value = value
      run.show()
      run.playback.tick()
      assert env.command.manual == {0: (value, 0.25)}
    assert run.inputs["left"].disabled


@pytest.mark.parametrize("others", [[], ["model_0.pt", "model_50.pt"]])
def test_a_loaded_checkpoint_missing_from_the_list_is_added_to_the_choices(others: list[str]) -> None:
  env = BoxEnv(1)
  zeros = ZeroPolicy(1, 1, env.sim.device)
  listed = CheckpointList(names=lambda: others, load=lambda name: zeros, loaded="best.pt")
  with served(env, zeros, checkpoints=listed) as run:
    choice = run.inputs["Checkpoint"]
    assert choice.value == "best.pt"
    assert set(choice.options) == {"best.pt", *others}


def test_the_status_describes_the_shown_moment_and_play_returns_to_now(monkeypatch: pytest.MonkeyPatch) -> None:
  with served(BoxEnv(1)) as run:
    monkeypatch.setattr(run.viewer.server, "get_clients", lambda: {0: None})
    run.playback.pause()
    for _ in range(10):
      run.playback.step_once()
      run.show()
    assert "step 10, " in run.status()
    run.inputs["Seconds back"].value = 4 * run.env.step_dt
    run.show()
    shown = run.status()
    assert f"step 6, {6 * run.env.step_dt:.2f} s" in shown
    assert "Play returns to now" in shown
    run.inputs["Pause"].value = True
    eventually(lambda: run.playback.tick() or not run.playback.paused, "Play does nothing")
    assert run.controls.seconds_back == run.inputs["Seconds back"].value == 0.0


@pytest.mark.parametrize(
  ("rewards", "curve"),
  [
    ((1.0,), "0,0 100,0"),
    ((0.0, 8.0, 2.0, 4.0), "0,100 25,0 50,75 75,50 100,50"),
    ((2.0, 2.0), "0,0 50,0 100,0"),
  ],
)
def test_the_panel_of_a_training_shows_its_state_and_stops_it_once(rewards: tuple[float, ...], curve: str) -> None:
  stops: list[int] = []
  with BrowserViewer(BoxEnv(1), port=8300, label="Task", on_stop=lambda: stops.append(1)) as viewer:
    panel = viewer.training
    assert panel is not None
    common: dict[str, Any] = {"end": 300, "steps_per_second": 12345.6, "eta": "0:10:00"}
    panel.show(iteration=1, reward=None, episode_length=None, terms={"success": 0.25}, **common)
    assert "No episode has ended yet." in panel._text.content
    for reward in rewards:
      panel.show(iteration=2, reward=reward, episode_length=51.0, terms={"foot_slip": -0.1}, **common)
    lines = panel._text.content.split("\n\n")
    assert lines[0] == "**Iteration 2 of 300**, 12,346 steps/s, ETA 0:10:00"
    assert lines[1:] == [f"Reward **{rewards[-1]:.2f}**, episode 51 steps"]
    assert f'points="{curve}"' in panel._curve.content
    assert "| success | 0.25 |\n| foot slip | -0.1 |" in panel._table.content
    for _ in range(2):
      panel._press()
    assert stops == [1]
    assert panel._stop.disabled
  with BrowserViewer(BoxEnv(1), port=8300) as viewer:
    assert viewer.training is None


@pytest.mark.parametrize(("label", "value"), [("Reset", True), ("World", 2), ("Shown", 1)])
def test_reset_and_a_change_of_worlds_return_to_now(label: str, value: int) -> None:
  with served(BoxEnv(3)) as run:
    back, resets = run.inputs["Seconds back"], run.env.num_resets
    run.playback.pause()
    back.value = 2.0
    run.viewer.update()
    assert back.value == 2.0
    run.inputs[label].value = value

    def is_now() -> bool:
      run.show()
      run.playback.tick()
      return run.controls.seconds_back == back.value == 0.0

    eventually(is_now)
    assert (run.env.num_resets > resets) == (label == "Reset")


def test_the_button_that_pauses_shows_its_action() -> None:
  with served(BoxEnv(1)) as run:
    button = run.controls._pause
    for act, label, icon in (
      (run.playback.pause, "Play", viser.Icon.PLAYER_PLAY),
      (run.playback.resume, "Pause", viser.Icon.PLAYER_PAUSE),
    ):
      act()
      run.status()
      assert (button.label, button.icon) == (label, icon)


def test_only_the_thread_that_shows_draws(monkeypatch: pytest.MonkeyPatch) -> None:
  env = BoxEnv(1)
  with BrowserViewer(env, port=8300) as viewer:
    scene, drew = viewer.scene.scene, []
    update = scene._update_visualization_locked
    monkeypatch.setattr(
      scene, "_update_visualization_locked", lambda *given: (drew.append(threading.get_ident()), update(*given))
    )
    for mode in ("Body", "None"):
      viewer.scene.show(SnapshotTaker(env).take((0,)))
      # As viser does for a page.
      page = threading.Thread(target=setattr, args=(inputs_of(viewer)["Frames"], "value", mode))
      page.start()
      page.join()
      assert scene.frame_mode == mode
    assert drew == [threading.get_ident()] * 2


def test_curves_go_on_after_a_value_that_is_not_finite() -> None:
  env = BoxEnv(1)
  with BrowserViewer(env, port=8300) as viewer:
    taker, history = SnapshotTaker(env), []
    for step, height in enumerate((torch.nan, 1.0, torch.nan, torch.inf, 4.0, torch.nan)):
      env.rewards[0] = torch.tensor([height, torch.nan])
      history.append(taker.take((0,), step=step))
    (plot, *_) = viewer._plots
    plot.show(history, 1.0)
    assert plot._plot is not None
    time, heights, never = plot._plot.data
    np.testing.assert_allclose(time, range(6))
    np.testing.assert_allclose(heights, [1.0, 1.0, 2.0, 3.0, 4.0, 4.0])
    np.testing.assert_allclose(never, 0.0)


def test_inputs_act_before_the_page_has_sent_its_camera() -> None:
  env = BoxEnv(3)
  with served(env) as run:
    playback, viewer = run.playback, run.viewer
    inputs = {handle.label: uuid for uuid, handle in viewer.server.gui._gui_input_handle_from_uuid.items()}

    def send(label: str, value: object) -> None:
      message = {"type": "GuiUpdateMessage", "uuid": inputs[label], "updates": {"value": value}}
      page.send(msgspec.msgpack.encode(message))

    def is_so(holds: Callable[[], bool]) -> bool:
      viewer.update()
      playback.tick()
      return holds()

    address = viewer.url.replace("http", "ws", 1)
    with connect(address, subprotocols=[Subprotocol(f"viser-v{viser.__version__}")], max_size=None) as page:
      for label, value in (("World", 2), ("Manual", True), ("forward", 0.5), ("Speed", "2")):
        send(label, value)
      eventually(lambda: is_so(lambda: env.command.manual == {2: (0.5, 0.0)}), "the command is not manual")
      eventually(lambda: is_so(lambda: playback.speed == 2.0), "the speed stays")
      assert viewer.selection.world == 2
      presses: tuple[tuple[str, object, Callable[[], bool]], ...] = (
        ("Pause", True, lambda: playback.paused),
        ("Reset", True, lambda: env.num_resets == 3),
        ("Direction", "up", lambda: env.sim.data.qvel[:, 2].tolist() == [0.0, 0.0, 1.0]),
        ("Step", True, lambda: playback.step_count == 1),
        ("Step", True, lambda: playback.step_count == 2),
        ("Stop", True, lambda: env.command.manual == {2: (0.0, 0.0)}),
        ("Pause", True, lambda: not playback.paused),
      )
      for label, value, holds in presses:
        send(label, value)
        eventually(lambda holds=holds: is_so(holds), f"{label} does nothing")
      assert not viewer.server.get_clients()


def test_the_sender_of_the_page_is_woken_in_its_loop() -> None:
  with BrowserViewer(BoxEnv(1), port=8300) as viewer:
    event = viewer.server._websock_server._broadcast_buffer.message_event
    assert isinstance(event, LoopEvent)
  loop = asyncio.new_event_loop()
  event = LoopEvent(loop)
  event.set()
  assert not event.is_set()
  loop.call_soon(event.set)
  # This thread may have a loop, that of Playwright.
  thread = threading.Thread(target=loop.run_until_complete, args=(event.wait(),))
  thread.start()
  thread.join()
  assert event.is_set()
  loop.close()


def test_the_private_names_of_mjviser_are_those_of_the_tested_version() -> None:
  with BrowserViewer(BoxEnv(1), port=8300) as viewer:
    assert importlib.metadata.version("mjviser") == TESTED_VERSION
    assert all(hasattr(viewer.scene.scene, name) for name in PRIVATE_NAMES)
  assert list(PRIVATE_FUNCTIONS) == [mjviser_scene._can_merge_vertices.__name__]
  assert all(hasattr(conversions, name) for name in PRIVATE_FUNCTIONS)


def test_the_private_names_of_viser_are_those_of_the_tested_versions(monkeypatch: pytest.MonkeyPatch) -> None:
  names = [path.rpartition(".")[2] for path in viser_internals.PRIVATE_NAMES]
  assert all(hasattr(viser_internals._owner_of(name), name) for name in names)
  monkeypatch.setattr(viser, "__version__", "1.9.0")
  assert [viser_internals._owner_of(name) for name in names] == [None, None]
  with BrowserViewer(BoxEnv(1), port=8300) as viewer:
    viewer.update()


def test_worlds_are_shown_without_the_private_names_of_mjviser(monkeypatch: pytest.MonkeyPatch) -> None:
  def without_private_names(scene: MujocoScene, name: str) -> Any:
    # mjviser itself goes on using them.
    if name in PRIVATE_NAMES and sys._getframe(1).f_globals["__name__"] == MujocoScene.__module__:
      raise AttributeError(name)
    return object.__getattribute__(scene, name)

  monkeypatch.setattr(MujocoScene, "__getattribute__", without_private_names)
  env = colorful_env()
  with BrowserViewer(env, port=8300) as viewer:
    viewer.scene.scene.geom_groups_visible[4] = True
    viewer.scene.show(SnapshotTaker(env, contacts=True).take((0, 1, 2, 3)))
    assert all(other.scene.geom_groups_visible[4] for other in viewer.scene.others.scenes)
    assert not viewer.scene.scene.splits_contact_forces


def test_groups_are_named_after_their_contents_and_switch_them() -> None:
  model = mujoco.MjModel.from_xml_string("""
    <mujoco>
      <worldbody>
        <geom name="terrain" type="plane" size="1 1 .1"/>
        <site name="goal"/>
        <body name="robot/trunk"><freejoint/>
          <geom name="robot/shell" type="sphere" size=".1" group="2" contype="0" conaffinity="0"/>
          <body name="robot/foot"><geom name="robot/sole" type="sphere" size=".1" group="3"/></body>
        </body>
        <body name="cube/cube"><freejoint/><geom name="cube/cube" type="box" size=".1 .1 .1" group="3"/></body>
      </worldbody>
    </mujoco>""")
  assert geom_labels(model) == {0: "terrain: collision", 2: "robot: visual", 3: "robot, cube: collision"}
  assert site_labels(model) == {0: "goal"}
  replay = Replay(model, {"qpos": model.qpos0[None, None]}, 0.02)
  with BrowserViewer(replay, port=8310) as viewer:
    boxes = inputs_of(viewer)
    assert not any(label.startswith(("G1", "tendon")) for label in boxes)
    boxes["robot, cube: collision"].value = True
    boxes["robot: visual"].value = False
    viewer._groups.inputs.read()
    assert viewer.scene.scene.geom_groups_visible == [True, True, False, True, False, False]


def test_the_selected_robot_is_marked_beside_others() -> None:
  env = BoxEnv(3)
  with BrowserViewer(env, port=8311) as viewer:
    taker = SnapshotTaker(env)
    viewer.scene.show(taker.take((1, 2)))
    (shaft, head) = viewer.scene._marks._handles.values()
    assert shaft.visible
    # It points down at the box of world 1.
    offset = viewer.scene.scene.fixed_bodies_frame.position
    box = env.sim.data.xpos[1, 1].numpy() + offset
    np.testing.assert_allclose(shaft.batched_positions[0, :2], box[:2], atol=1e-5)
    assert box[2] < head.batched_positions[0, 2] < shaft.batched_positions[0, 2]
    viewer.scene.show(taker.take((1,)))
    assert not shaft.visible


def test_the_page_waits_for_no_environment_map(monkeypatch: pytest.MonkeyPatch) -> None:
  asked: list[object] = []
  monkeypatch.setattr(
    viser.SceneApi, "configure_environment_map", lambda self, hdri="warehouse", **_: asked.append(hdri)
  )
  env = BoxEnv(2)
  env.sim.expand("geom_rgba")[1] = 0.5
  with BrowserViewer(env, port=8312) as viewer:
    viewer.scene.show(SnapshotTaker(env).take((0, 1)))
    assert len(viewer.scene.others.scenes) == 1
  # Without this call the browser loads a default map.
  assert asked == [None]


def test_the_field_of_view_is_that_of_the_slider() -> None:
  env = BoxEnv(1)
  with BrowserViewer(env, port=8313) as viewer:
    slider = inputs_of(viewer)["Field of view"]
    assert np.deg2rad(slider.value) == pytest.approx(viewer.server.initial_camera.fov, abs=0.01)
    slider.value = 90
    viewer.update()
    assert viewer.server.initial_camera.fov == pytest.approx(np.pi / 2)


def test_the_archive_of_icons_is_opened_once(monkeypatch: pytest.MonkeyPatch) -> None:
  opened: list[Any] = []
  monkeypatch.setattr(zipfile, "ZipFile", lambda path, of=zipfile.ZipFile: opened.append(path) or of(path))
  viser_internals.read_icons_once()
  viser_internals._archive.cache_clear()
  icons.svg_from_icon.cache_clear()
  texts = [icons.svg_from_icon(name) for name in (viser.Icon.PLAYER_PLAY, viser.Icon.REFRESH)]
  assert all("<svg" in text for text in texts)
  assert len(opened) == 1


def test_vertices_merge_unless_their_colors_differ() -> None:
  boxes = trimesh.util.concatenate([trimesh.creation.box()] * 2)
  red, green = [255, 0, 0, 255], [0, 255, 0, 255]
  for colors, merged in (([red] * 16, 8), (([red] * 4 + [green] * 4) * 2, 8), ([red] * 8 + [green] * 8, 16)):
    mesh: Any = boxes.copy()
    mesh.visual.vertex_colors = colors
    # mjviser moves meshes to their places, and then merges.
    result = conversions._merge_meshes([mesh], [np.zeros(3)], [np.array([1.0, 0.0, 0.0, 0.0])])
    assert len(result.vertices) == merged
