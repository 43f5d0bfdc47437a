"""Buttons and sliders of the page.

Actions run in the thread that owns the environment: buttons leave requests with the playback, values are read there.
"""

from __future__ import annotations

import html
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
import viser
from mjlab_core import MjlabError

from mjlab_viewer.browser.inputs import Inputs
from mjlab_viewer.browser.recorder import Recorder
from mjlab_viewer.browser.time_line import TimeLine
from mjlab_viewer.browser.world.scene import BrowserScene, Selection
from mjlab_viewer.env import ViewedEnv, floating_dofs, push
from mjlab_viewer.playback import SPEEDS, CheckpointList, Playback
from mjlab_viewer.replay import Replay


class WorldControls:
  """Controls of the worlds that are shown, of the camera, and of the drawings over them."""

  def __init__(self, server: viser.ViserServer, env: ViewedEnv, selection: Selection, scene: BrowserScene) -> None:
    gui = server.gui
    self.inputs = Inputs(server)
    self._boxes: dict[str, viser.GuiCheckboxHandle] = {}
    if env.num_envs > 1:
      with gui.add_folder("Worlds"):
        world = gui.add_slider("World", min=0, max=env.num_envs - 1, step=1, initial_value=selection.world)
        self.inputs.on_change(lambda: world.value, lambda: setattr(selection, "world", int(world.value)))
        shown = gui.add_slider(
          "Shown",
          min=1,
          max=selection.most,
          step=1,
          initial_value=selection.count,
          hint="This world and those after it",
        )
        self.inputs.on_change(lambda: shown.value, lambda: setattr(selection, "count", int(shown.value)))
    with gui.add_folder("Camera"):
      follow = gui.add_checkbox("Follow", initial_value=scene.scene.camera_tracking_enabled)
      degrees = round(np.rad2deg(server.initial_camera.fov))
      angle = gui.add_slider(
        "Field of view",
        min=min(10, degrees),
        max=max(120, degrees),
        step=1,
        initial_value=degrees,
        hint="Vertical [deg]",
      )

      def move() -> None:
        scene.follow(follow.value)
        for client in server.get_clients().values():
          scene.look(client)

      def zoom() -> None:
        fov = float(np.deg2rad(angle.value))
        server.initial_camera.fov = fov
        for client in server.get_clients().values():
          client.camera.fov = fov

      self.inputs.on_change(lambda: follow.value, move)
      self.inputs.on_change(lambda: angle.value, zoom)
    known, on = env.drawers(), env.default_drawers()
    if known:
      with gui.add_folder("Draw"):
        for name in known:
          self._boxes[name] = gui.add_checkbox(name, initial_value=name in on)

  def drawers(self) -> tuple[str, ...]:
    """Return the names of the drawers that are on."""
    return tuple(name for name, box in self._boxes.items() if box.value)


class PlaybackControls:
  """Controls of time, pushes, manual commands, policies and films."""

  def __init__(
    self,
    server: viser.ViserServer,
    playback: Playback,
    selection: Selection,
    scene: BrowserScene,
    recorder: Recorder,
    checkpoints: CheckpointList | None,
  ) -> None:
    self._server, self._playback, self._selection = server, playback, selection
    self._scene, self._recorder = scene, recorder
    self._episode_end = ""
    playback.on_step.append(self._note_episode_end)
    self._gui = gui = server.gui
    self.inputs = Inputs(server)
    self._status = gui.add_html("")
    self._notified: str | None = None
    self._pause = self._add_action("Pause", viser.Icon.PLAYER_PAUSE, "space", playback.toggle)
    self._add_action(
      "Step", viser.Icon.PLAYER_TRACK_NEXT, "arrowright", playback.step_once, hint="One step, while paused"
    )
    self._add_action("Reset", viser.Icon.REFRESH, "enter", playback.reset)
    speeds = {_ratio(speed): speed for speed in sorted({*SPEEDS, playback.speed})}
    speed = gui.add_dropdown("Speed", list(speeds), initial_value=_ratio(playback.speed))
    self.inputs.on_change(lambda: speed.value, lambda: setattr(playback, "speed", speeds[speed.value]))
    self._time = TimeLine(gui, playback, self.inputs)
    # The history is of the worlds that were shown then.
    self.inputs.on_change(lambda: selection.worlds, self._time.to_now)
    self._record = gui.add_button("Record", icon=viser.Icon.PLAYER_RECORD)
    self.inputs.on_press(self._record, lambda client: playback.request(lambda: self._toggle_recording(client)))
    self._add_pushes()
    for name, command in playback.env.steering().items():
      self._add_command(name, command)
    if checkpoints is not None:
      self._add_checkpoints(checkpoints)

  @property
  def seconds_back(self) -> float:
    """Age of the moment to show [s]; 0 unless paused."""
    return self._time.seconds_back

  def show_status(self) -> None:
    """Show state, time and errors."""
    playback = self._playback
    self._pause.label = "Play" if playback.paused else "Pause"
    self._pause.icon = viser.Icon.PLAYER_PLAY if playback.paused else viser.Icon.PLAYER_PAUSE
    self._record.label, self._record.color = ("Stop recording", "red") if self._recorder.is_on else ("Record", None)
    self._time.update()
    state, step = playback.state, playback.step_count
    if self.seconds_back > 0.0 and self._scene.shown is not None:
      state = f"looking back {self.seconds_back:.2f} s; Play returns to now"
      # The page may go back to before the last reset, where this count has no steps.
      step = max(step - playback.total_steps + self._scene.shown.step, 0)
    world = self._selection.world
    if isinstance(playback.env, Replay):
      lines = [playback.env.note(world)]
    else:
      lines = [f"step {step}, {step * playback.env.step_dt:.2f} s, world {world}", self._episode_end]
    line = "<br>".join([f"<b>{state}</b>", *(html.escape(text) for text in lines if text)])
    if not self._scene.is_finite:
      line += f"<br>world {world} is not finite: shown as it was before"
    if playback.error is not None:
      line += f'<br><span style="color:#c92a2a">{html.escape(playback.error)}</span>'
    self._status.content = f'<div style="padding:0 0.75em 0.5em;font-size:0.875em">{line}</div>'
    if playback.error != self._notified:
      self._notified = playback.error
      if playback.error is not None:
        self._notify("Paused", playback.error, "red")

  def _note_episode_end(self) -> None:
    """Note the terminations of the selected world in the step just done, from the environment's signals."""
    names, values = self._playback.env.signals().get("terminations", ((), None))
    if values is None:
      return
    world = self._selection.world
    reasons = [name for name, flag in zip(names, values[world].tolist(), strict=True) if flag]
    if reasons:
      self._episode_end = f"world {world} last ended by {', '.join(reasons)}"

  def _request(self, button: viser.GuiButtonHandle, action: Callable[[], None]) -> None:
    self.inputs.on_press(button, lambda _: self._playback.request(action))

  def _add_action(
    self,
    name: str,
    icon: viser.IconName,
    hotkey: Literal["space", "arrowright", "enter"],
    action: Callable[[], None],
    hint: str | None = None,
  ) -> viser.GuiButtonHandle:
    """Add a button and a key that return to now and act."""

    def act() -> None:
      self._time.to_now()
      action()

    button = self._gui.add_button(name, icon=icon, hint=hint)
    self._request(button, act)
    self._gui.add_command(name, hotkey=hotkey).on_trigger(lambda _: self._playback.request(act))
    return button

  def _add_pushes(self) -> None:
    env = self._playback.env
    # Stored moments cannot be pushed.
    if isinstance(env, Replay) or floating_dofs(env.sim.mj_model) is None:
      return
    with self._gui.add_folder("Push", expand_by_default=False):
      speed = self._gui.add_slider("Speed [m/s]", min=0.1, max=3.0, step=0.1, initial_value=1.0)
      directions = {"forward": (1, 0, 0), "back": (-1, 0, 0), "left": (0, 1, 0), "right": (0, -1, 0), "up": (0, 0, 1)}
      buttons = self._gui.add_button_group("Direction", list(directions), hint="Of the world's axes: forward is +x")

      def act(_: object) -> None:
        x, y, z = (part * speed.value for part in directions[buttons.value])
        world = self._selection.world
        self._playback.request(lambda: push(env, world, (x, y, z)))

      self.inputs.on_press(buttons, act)

  def _add_command(self, name: str, command: Any) -> None:
    with self._gui.add_folder(f"Command {name}"):
      manual = self._gui.add_checkbox("Manual", initial_value=False, hint="In the selected world")
      axes = [self._add_axis(*axis) for axis in command.axes]
      zeros = [axis.value for axis in axes]
      stop = self._gui.add_button("Stop", hint="All to zero")
    held: int | None = None

    def given() -> tuple[int | None, list[float]]:
      return self._selection.world if manual.value else None, [float(axis.value) for axis in axes]

    def steer() -> None:
      """Hold the values in the selected world; other worlds keep their commands."""
      nonlocal held
      world, values = given()
      if held is not None and held != world:
        command.steer(held, None)
      held = world
      if world is not None:
        command.steer(world, values)

    def zero() -> None:
      for axis, value in zip(axes, zeros, strict=True):
        axis.value = value

    self.inputs.on_change(given, lambda: self._playback.request(steer))
    self._request(stop, zero)

  def _add_axis(self, label: str, lower: float, upper: float) -> viser.GuiInputHandle[float]:
    value = _zero(lower, upper)
    if lower == upper:
      return self._gui.add_number(label, value, disabled=True, hint="Fixed")
    return self._gui.add_slider(label, min=lower, max=upper, step=(upper - lower) / 100, initial_value=value)

  def _add_checkpoints(self, checkpoints: CheckpointList) -> None:
    def known() -> list[str]:
      names = list(checkpoints.names())
      return names if checkpoints.loaded in names else [checkpoints.loaded, *names]

    with self._gui.add_folder("Policy"):
      choice = self._gui.add_dropdown("Checkpoint", known(), initial_value=checkpoints.loaded)
      newest = self._gui.add_button("Newest", hint="Load the newest checkpoint")

      def load() -> None:
        self._playback.request(lambda: self._playback.set_policy(checkpoints.load(choice.value)))

      def refresh() -> None:
        choice.options = known()
        choice.value = choice.options[-1]

      self.inputs.on_change(lambda: choice.value, load)
      self._request(newest, refresh)

  def _toggle_recording(self, client: viser.ClientHandle | None) -> None:
    if not self._recorder.is_on:
      self._recorder.start()
      return
    try:
      path = self._recorder.stop()
    except MjlabError as error:
      self._notify("Record", str(error), "red")
      return
    self._notify("Record", f"saved as {path}", "green")
    if client is not None:
      client.send_file_download(path.name, path.read_bytes())

  def _notify(self, title: str, body: str, color: str) -> None:
    for client in self._server.get_clients().values():
      client.add_notification(title, body, color=color, auto_close_seconds=10.0)  # pyright: ignore[reportArgumentType]  # ty: ignore[invalid-argument-type]


def _ratio(speed: float) -> str:
  """Return a speed as a fraction where it is one."""
  inverse = 1 / speed
  return f"{speed:g}" if speed >= 1 or inverse != round(inverse) else f"1/{round(inverse)}"


def _zero(lower: float, upper: float) -> float:
  """Return zero, or the middle of a range without zero."""
  return 0.0 if lower <= 0.0 <= upper else round(0.5 * (lower + upper), 9)
