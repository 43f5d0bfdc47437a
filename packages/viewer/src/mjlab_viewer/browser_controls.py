"""Buttons and sliders of the page. Buttons leave wishes; who owns the environment reads values, and fulfils them."""

from __future__ import annotations

import html
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypeAlias

import viser

from mjlab_viewer.checkpoint_list import CheckpointList
from mjlab_viewer.errors import ViewerError
from mjlab_viewer.playback import SPEEDS, Playback
from mjlab_viewer.pushing import floating_dofs, push
from mjlab_viewer.replay import Replay
from mjlab_viewer.worlds import Steering

if TYPE_CHECKING:
  from mjlab_viewer.browser import BrowserViewer

Button: TypeAlias = "viser.GuiButtonHandle | viser.GuiButtonGroupHandle"

REMEMBERED = 10.0
"""How far one can go back while paused [s]."""


class Values:
  """What the page is set to.

  It is read rather than listened to: the page shows its inputs before it tells where its camera is, and of what is set
  until then viser keeps the value but tells nobody.
  """

  def __init__(self) -> None:
    self._watched: list[tuple[Callable[[], object], Callable[[], None]]] = []
    self._seen: list[object] = []

  def on_change(self, value: Callable[[], object], action: Callable[[], None]) -> None:
    """Have something done after this value became another one."""
    self._watched.append((value, action))
    self._seen.append(value())

  def read(self) -> None:
    """Do what is to be done for values that changed since the last time."""
    for row, (value, action) in enumerate(self._watched):
      now = value()
      if now != self._seen[row]:
        self._seen[row] = now
        action()


class Buttons:
  """What is done for buttons of the page, once for every press.

  Of a page that has not told yet where its camera is, viser notes when a button was pressed, but tells nobody. So that
  is looked at, too, in viser's own thread, where no press comes in between.
  """

  def __init__(self, server: viser.ViserServer) -> None:
    self._server = server
    self._presses: list[Callable[[], None]] = []

  def on_press(self, button: Button, action: Callable[[viser.ClientHandle | None], None]) -> None:
    """Have something done at once, in viser's thread, for whoever presses, as far as that is known."""
    seen = button.update_timestamp

    def press(client: viser.ClientHandle | None = None) -> None:
      nonlocal seen
      if button.update_timestamp != seen:
        seen = button.update_timestamp
        action(client)

    async def told(event: viser.GuiEvent) -> None:
      press(event.client)

    button.on_click(told)
    self._presses.append(press)

  def read(self) -> None:
    """Do what is to be done for presses that nobody was told of."""
    self._server.get_event_loop().call_soon_threadsafe(self._look)

  def _look(self) -> None:
    for press in self._presses:
      press()


class WorldControls:
  """Which worlds are shown, whether the eye follows, and what is drawn over them."""

  def __init__(self, viewer: BrowserViewer, max_worlds: int) -> None:
    gui, env = viewer.server.gui, viewer.env
    self.values = Values()
    self._boxes: dict[str, viser.GuiCheckboxHandle] = {}
    with gui.add_folder("Worlds"):
      if env.num_envs > 1:
        world = gui.add_slider("World", min=0, max=env.num_envs - 1, step=1, initial_value=viewer.selected)
        self.values.on_change(lambda: world.value, lambda: setattr(viewer, "selected", int(world.value)))
        most = min(max_worlds, env.num_envs)
        drawn = gui.add_slider(
          "Shown", min=1, max=most, step=1, initial_value=viewer.num_drawn, hint="This world and those after it"
        )
        self.values.on_change(lambda: drawn.value, lambda: setattr(viewer, "num_drawn", int(drawn.value)))
      follow = gui.add_checkbox("Follow", initial_value=viewer.scene.scene.camera_tracking_enabled)

      def move() -> None:
        viewer.scene.follow(follow.value)
        for client in viewer.server.get_clients().values():
          viewer.scene.look(client)

      self.values.on_change(lambda: follow.value, move)
    known, at_first = env.drawers(), env.drawn_at_first()
    if known:
      with gui.add_folder("Draw"):
        for name in known:
          self._boxes[name] = gui.add_checkbox(name, initial_value=name in at_first)

  def drawers(self) -> tuple[str, ...]:
    """Names of those who are to draw."""
    return tuple(name for name, box in self._boxes.items() if box.value)


class PlaybackControls:
  """Pause, step, speed, reset, time line, pushes, commands by hand, policies, films."""

  def __init__(self, viewer: BrowserViewer, playback: Playback, checkpoints: CheckpointList | None) -> None:
    self._viewer, self._playback = viewer, playback
    self._endings = Endings(viewer)
    playback.on_step.append(self._endings.look)
    self._gui = gui = viewer.server.gui
    self.values, self.buttons = Values(), Buttons(viewer.server)
    self._status = gui.add_html("")
    self._shown_status = ""
    self._told_error: str | None = None
    self._pause = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE)
    self._ask(self._pause, self._toggle)
    self._ask(gui.add_button("Step", icon=viser.Icon.PLAYER_TRACK_NEXT, hint="One step, while paused"), self._step)
    self._ask(gui.add_button("Reset", icon=viser.Icon.REFRESH), self._reset)
    speeds = {_ratio(speed): speed for speed in sorted({*SPEEDS, playback.speed})}
    speed = gui.add_dropdown("Speed", list(speeds), initial_value=_ratio(playback.speed))
    self.values.on_change(lambda: speed.value, lambda: setattr(playback, "speed", speeds[speed.value]))
    self._timeline = gui.add_slider(
      "Seconds back",
      min=0.0,
      max=REMEMBERED,
      step=min(0.05, playback.env.step_dt),
      initial_value=0.0,
      disabled=True,
      hint="While paused",
    )
    # What was shown is of the worlds that were shown then.
    self.values.on_change(viewer.drawn_worlds, lambda: setattr(self._timeline, "value", 0.0))
    self._record = gui.add_button("Record", icon=viser.Icon.PLAYER_RECORD)
    self.buttons.on_press(self._record, lambda client: playback.request(lambda: self._toggle_recording(client)))
    for command, action in (
      (gui.add_command("Pause", hotkey="space"), self._toggle),
      (gui.add_command("Step", hotkey="arrowright"), self._step),
      (gui.add_command("Reset", hotkey="enter"), self._reset),
    ):
      command.on_trigger(lambda _, action=action: playback.request(action))
    self._add_pushes()
    for name, command in playback.env.steering().items():
      self._add_command(name, command)
    if checkpoints is not None:
      self._add_checkpoints(checkpoints)

  @property
  def seconds_back(self) -> float:
    """How long ago what is to be shown was [s]; 0 unless paused."""
    return float(self._timeline.value) if self._playback.paused else 0.0

  def show_status(self) -> None:
    """Say how it goes."""
    playback = self._playback
    label, icon = ("Play", viser.Icon.PLAYER_PLAY) if playback.paused else ("Pause", viser.Icon.PLAYER_PAUSE)
    if self._pause.label != label:
      self._pause.label, self._pause.icon = label, icon
    self._record.label, self._record.color = (
      ("Stop recording", "red") if self._viewer.is_recording else ("Record", None)
    )
    self._timeline.disabled = not playback.paused
    state = "paused" if playback.paused else f"{playback.real_time_factor:.2g} × real time"
    if playback.is_capped:
      state += f" (this machine is too slow for {playback.speed:g})"
    time = playback.step_count * playback.env.step_dt
    world = self._viewer.selected
    line = f"<b>{state}</b><br>step {playback.step_count}, {time:.2f} s, world {world}"
    note = playback.env.note(world) if isinstance(playback.env, Replay) else self._endings.last
    if note:
      line += f"<br>{html.escape(note)}"
    if not self._viewer.scene.is_finite:
      line += f"<br>world {world} is not finite: shown as it was before"
    if playback.error is not None:
      line += f'<br><span style="color:#c92a2a">{html.escape(playback.error)}</span>'
    if line != self._shown_status:
      self._shown_status = line
      self._status.content = f'<div style="padding:0 0.75em 0.5em;font-size:0.875em">{line}</div>'
    if playback.error != self._told_error:
      self._told_error = playback.error
      if playback.error is not None:
        self._tell("Paused", playback.error, "red")

  def _ask(self, button: viser.GuiButtonHandle, action: Callable[[], None]) -> None:
    self.buttons.on_press(button, lambda _: self._playback.request(action))

  def _toggle(self) -> None:
    if self._playback.paused:
      self._timeline.value = 0.0
      self._playback.resume()
    else:
      self._playback.pause()

  def _step(self) -> None:
    self._timeline.value = 0.0
    self._playback.step_once()

  def _reset(self) -> None:
    self._timeline.value = 0.0
    self._playback.reset()

  def _add_pushes(self) -> None:
    env = self._playback.env
    # What was stored stays as it is.
    if isinstance(env, Replay) or floating_dofs(env.sim.mj_model) is None:
      return
    with self._gui.add_folder("Push", expand_by_default=False):
      speed = self._gui.add_slider("Speed [m/s]", min=0.1, max=3.0, step=0.1, initial_value=1.0)
      directions = {"forward": (1, 0, 0), "back": (-1, 0, 0), "left": (0, 1, 0), "right": (0, -1, 0), "up": (0, 0, 1)}
      buttons = self._gui.add_button_group("Direction", list(directions), hint="Of the world's axes: forward is +x")

      def act(_: object) -> None:
        x, y, z = (part * speed.value for part in directions[buttons.value])
        world = self._viewer.selected
        self._playback.request(lambda: push(env.sim, world, (x, y, z)))

      self.buttons.on_press(buttons, act)

  def _add_command(self, name: str, command: Steering) -> None:
    with self._gui.add_folder(f"Command {name}"):
      by_hand = self._gui.add_checkbox("By hand", initial_value=False, hint="Of the selected world")
      zeros = [_zero(lower, upper) for _, lower, upper in command.axes]
      axes = [self._add_axis(*axis, zero) for axis, zero in zip(command.axes, zeros, strict=True)]
      stop = self._gui.add_button("Stop", hint="All to zero")

    def given() -> tuple[int, list[float]] | None:
      return (self._viewer.selected, [float(axis.value) for axis in axes]) if by_hand.value else None

    def zero() -> None:
      for axis, value in zip(axes, zeros, strict=True):
        axis.value = value

    hand = Hand(command)
    self.values.on_change(given, lambda: self._playback.request(lambda: hand.give(given())))
    self._ask(stop, zero)

  def _add_axis(self, label: str, lower: float, upper: float, value: float) -> viser.GuiInputHandle[float]:
    if lower == upper:
      return self._gui.add_number(label, value, disabled=True, hint="Fixed")
    return self._gui.add_slider(label, min=lower, max=upper, step=(upper - lower) / 100, initial_value=value)

  def _add_checkpoints(self, checkpoints: CheckpointList) -> None:
    def known() -> list[str]:
      names = list(checkpoints.names())
      return names if checkpoints.loaded in names else [checkpoints.loaded, *names]

    with self._gui.add_folder("Policy"):
      choice = self._gui.add_dropdown("Checkpoint", known(), initial_value=checkpoints.loaded)
      newest = self._gui.add_button("Newest", hint="Look for new checkpoints and take the last one")

      def load() -> None:
        self._playback.request(lambda: self._playback.set_policy(checkpoints.load(choice.value)))

      def refresh() -> None:
        choice.options = known()
        choice.value = choice.options[-1]

      self.values.on_change(lambda: choice.value, load)
      self._ask(newest, refresh)

  def _toggle_recording(self, client: viser.ClientHandle | None) -> None:
    if not self._viewer.is_recording:
      self._viewer.start_recording()
      return
    try:
      path = self._viewer.stop_recording()
    except ViewerError as error:
      self._tell("Record", str(error), "red")
      return
    self._tell("Record", f"saved as {path}", "green")
    if client is not None:
      client.send_file_download(path.name, path.read_bytes())

  def _tell(self, title: str, body: str, color: str) -> None:
    for client in self._viewer.server.get_clients().values():
      client.add_notification(title, body, color=color, auto_close_seconds=10.0)  # pyright: ignore[reportArgumentType]  # ty: ignore[invalid-argument-type]


class Hand:
  """A hand that steers one world at a time; one that it leaves gets its own commands again."""

  def __init__(self, command: Steering) -> None:
    self._command = command
    self._world: int | None = None

  def give(self, given: tuple[int, Sequence[float]] | None) -> None:
    """Give these numbers to this world, or let go."""
    world, values = (None, None) if given is None else given
    if self._world is not None and self._world != world:
      self._command.steer(self._world, None)
    self._world = world
    if world is not None:
      self._command.steer(world, values)


class Endings:
  """Why the last episode of the selected world ended, as far as the environment tells by its signals."""

  def __init__(self, viewer: BrowserViewer) -> None:
    self._viewer = viewer
    self.last = ""

  def look(self) -> None:
    """Take note of what ended in the step just done."""
    names, values = self._viewer.env.signals().get("terminations", ((), None))
    if values is None:
      return
    flags = values[self._viewer.selected].tolist()
    reasons = [name for name, flag in zip(names, flags, strict=True) if flag]
    if reasons:
      self.last = f"world {self._viewer.selected} last ended by {', '.join(reasons)}"


def _ratio(speed: float) -> str:
  """A speed as a fraction where it is one."""
  inverse = 1 / speed
  return f"{speed:g}" if speed >= 1 or inverse != round(inverse) else f"1/{round(inverse)}"


def _zero(lower: float, upper: float) -> float:
  """Zero, or the middle of a range that does not hold it."""
  return 0.0 if lower <= 0.0 <= upper else round(0.5 * (lower + upper), 9)
