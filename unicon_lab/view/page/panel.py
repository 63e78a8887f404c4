"""Panel: the widgets of one viewer: what he sees in numbers, and what he may do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from html import escape
from typing import Any

from unicon_lab.view.page.plots import (
    ALL,
    COMMANDED,
    MEASURED,
    PLOTTED,
    STYLE,
    TIMES,
    VELOCITY,
    History,
    Plot,
    choices,
    element_choices,
)
from unicon_lab.view.page.scene import Scene
from unicon_lab.view.shown import GraphLine, Parameter, Shown

NONE, _SAME = "nothing", "what drove then"
_HERE = "The run goes on from the last half second before, with today's parameters"
PANEL = 300
"""Width of the panel at the right in [px]."""
_WIDE = 1050  # [px]: a narrower page has narrower plots
_AXES = ("vx [m/s]", "vy [m/s]", "wz [rad/s]")
_PUSH, _PUSHES = 0.5, {"front": (1, 0), "back": (-1, 0), "left": (0, 1), "right": (0, -1)}
_HINTS = ("forwards", "to the left", "turning to the left")


def _on(event: Callable[[Any], object], do: Callable[[Any], object]) -> None:
    """Let what a viewer does to a widget do something; viser calls one after the other.

    Args:
        event: `on_click` or `on_update` of the widget.
        do: takes viser's event.
    """

    @event
    async def _(happened: Any) -> None:
        if happened.client is not None:  # else it was set from here
            do(happened)


def _switch(scene: Scene, name: str, event: Any) -> None:
    setattr(scene, name, event.target.value)


class Chart:
    """One plot and what chooses its curves.

    Args:
        gui: viser's widgets of this viewer.
        shown, history: the run.
        first: state to begin with.
    """

    def __init__(self, gui: Any, shown: Shown, history: History, first: str) -> None:
        self._gui, self._shown, self._history = gui, shown, history
        self._folder = gui.add_folder(None)
        self._chart: Any = None
        self._legend: Any = None
        self._plot: Plot
        with self._folder:
            known = (*choices(shown.layout, history), NONE)
            first = first if first in known else NONE
            self._state = gui.add_dropdown("plot", known, initial_value=first)
            self._elements = gui.add_dropdown("of", (ALL,), visible=False)
        self._changed = {"state"}
        _on(self._state.on_update, lambda _: self._changed.add("state"))
        _on(self._elements.on_update, lambda _: self._changed.add("elements"))

    def refresh(self, seconds: float, until: float) -> None:
        """Draw the curves of so long up to a time in [s], anew where something else is chosen."""
        if self._changed:
            self._build(seconds, until)
        elif self._chart is not None:
            self._chart.data = self._plot.data(seconds, until)

    def _build(self, seconds: float, until: float) -> None:
        changed, self._changed = self._changed, set()
        layout, state, elements = self._shown.layout, self._state.value, self._elements
        if "state" in changed:
            elements.options = known = element_choices(layout, state)
            elements.value, elements.visible = known[0], len(known) > 1
        if self._chart is not None:
            self._chart.remove()
            self._legend.remove()
            self._chart = None
        plot = Plot(layout, self._history, state, elements.value, self._shown.period)
        self._plot = plot
        if not plot.curves:
            return
        with self._folder:
            self._chart = self._gui.add_uplot(
                plot.data(seconds, until),
                plot.series(),
                title=plot.title,
                scales={"x": {"time": False}},
                axes=({"label": "time [s]", "size": 38, "labelSize": 18},
                      {"label": f"[{plot.unit}]" if plot.unit else "value", "size": 62,
                       "labelSize": 18}),
                legend={"show": False},
                height=175,
            )  # fmt: skip
            self._legend = self._gui.add_html(plot.legend())


class Panel:
    """All widgets of one viewer.

    Args:
        client: viser's handle.
        shown, history, scene: what is seen.
        do: is told what the viewer does: `wheel`, `steer` (velocity), `estop`, `act` (name,
            arguments), `past` (time), `live`, `branch` (then); in a recording `seek` (time),
            `play`, `speed` (factor).
        span: first and last moment of a recording in [s]; None of a live run.

    Attributes:
        stop, live: viser's buttons behind the large e-stop, and from the past to the present; None
            in a recording.
    """

    def __init__(
        self,
        client: Any,
        shown: Shown,
        history: History,
        scene: Scene,
        do: Callable[..., None],
        span: tuple[float, float] | None,
    ) -> None:
        self._gui, self._do, self._shown = client.gui, do, shown
        gui = client.gui
        self.dark(False)
        gui.set_panel_label(f"{shown.workflow} · {shown.robot.name} · {shown.platform}")
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL)
        self.stop: Any = None
        self.live: Any = None
        self._then, self._offers = list[Any](), list[Any]()
        self.status = gui.add_html("")
        _on(gui.add_button("Plots", color="gray").on_click, self._plot)
        self.sliders: list[Any] = []
        self._wheel: Any = None
        self.time: Any = None
        self.play: Any = None
        if span is None:
            self._live(gui)
        else:
            self._recorded(gui, span)
        with gui.add_folder("3D view", expand_by_default=False):
            for label, name in (
                ("follow the robot", "follow"),
                ("velocity arrows", "arrows"),
                ("contacts", "contacts"),
                ("path", "path"),
                ("ghost of the targets", "ghost"),
            ):
                box = gui.add_checkbox(label, getattr(scene, name))
                _on(box.on_update, partial(_switch, scene, name))
            gui.add_html(legend_html(bool(shown.robot.feet)))
        with gui.add_folder("running part of the graph", visible=bool(shown.graph)):
            self.graph = gui.add_html("")
        if span is None and shown.parameters:
            with gui.add_folder("Parameters", expand_by_default=False):
                for name, parameter in shown.parameters.items():
                    self._parameter(gui, name, parameter)
        self.plots = gui.add_panel(visible=False)
        with self.plots.add_tab("Plots"):
            self.window = gui.add_slider("last [s]", 1.0, PLOTTED, 1.0, 6.0)
            last = TIMES if span is None else "joint_effort"  # a recording's ticks are not timed
            self.charts = [
                Chart(gui, shown, history, first) for first in (VELOCITY, "joint_pos", last)
            ]
        self.plots.dock_left()
        self._wide = 400 if client.camera.image_width > _WIDE else PANEL
        self.plots.set_width(self._wide)

    def dark(self, dark: bool) -> None:
        """Colour the page for light or dark surroundings."""
        self._gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False)

    def again(self, ended: bool) -> None:
        """Offer what can be done with a run that has ended."""
        for button in self._offers:
            button.visible = ended

    def past(self, span: tuple[float, float], past: float | None) -> str:
        """Show what can be seen of the past, and what is; return how long ago that was, in words.

        Args:
            span: times of the oldest and the newest tick in [s].
            past: time that is shown, None for the present.
        """
        first, now = span
        if self.live is not None and first < now:
            self.time.min, self.time.max = round(first, 2), round(now, 2)
            self.show_time(now if past is None else past, False)
        for each in self._then:
            each.visible = past is not None
        return "" if past is None else f"PAST: {min(now - past, now - first):.1f} s ago ▸ live"

    def wheel(self, driver: int | None, number: int) -> None:
        """Show whether this viewer may take the wheel."""
        if self._wheel is None:
            return
        mine, label = driver == number, "Take the wheel"
        if mine:
            label = "Let go of the wheel"
        elif driver is not None:
            label = f"Viewer {driver} drives"
        self._wheel.label = label
        self._wheel.color = "orange" if mine else "blue"
        self._wheel.disabled = driver is not None and not mine
        for slider in self.sliders:
            slider.disabled = not mine

    def show_velocity(self, velocity: Any) -> None:
        """Put the sliders where the commanded velocity is."""
        for slider, value in zip(self.sliders, velocity):
            slider.value = round(float(value), 2)

    def show_time(self, moment: float, plays: bool) -> None:
        """Show where a recording is, and what its button does."""
        if self.time is not None and abs(self.time.value - moment) > 0.04:
            self.time.value = round(moment, 2)
        if self.play is not None:
            self.play.label = "Pause" if plays else "Play"

    # -- parts ----------------------------------------------------------------------------------

    def _live(self, gui: Any) -> None:
        self.stop = self._button(gui, "E-STOP", "estop", "red", visible=False)
        shown = self._shown
        with gui.add_folder("Last minute"):
            self.time = gui.add_slider("time [s]", 0.0, 0.02, 0.02, 0.0)
            _on(self.time.on_update, lambda _: self._do("past", self.time.value))
            self.live = self._button(gui, "Back to live", "live", "orange", visible=False)
            self._then.append(self.live)
            if shown.simulated:
                known = (_SAME, *(["swap"] if shown.swaps else ()), *shown.skills)
                then = gui.add_dropdown("driven by", known, visible=False)
                button = gui.add_button("Branch here", color="blue", visible=False, hint=_HERE)
                self._then += [button, then] if len(known) > 1 else [button]
                _on(button.on_click, lambda _: self._do("branch", then.value.removeprefix(_SAME)))
        drag = " Who drives drags bodies." if shown.bodies else ""
        if shown.drives or shown.pushes or shown.bodies:
            with gui.add_folder("Drive"):
                self._wheel = self._button(gui, "Take the wheel", "wheel", "blue")
                for axis, hint, (low, high) in zip(_AXES, _HINTS, shown.command_bounds):
                    self.sliders.append(self._slider(gui, axis, hint, low, high))
                if shown.drives:
                    self._button(gui, "Zero velocity", "zero", "gray")
                gui.add_html(
                    '<div style="font:12px/1.4 system-ui,sans-serif;opacity:.65;padding:0 9px 6px">'
                    "Gamepad: left stick vx, vy; right stick wz. Keys: I K forwards and back, "
                    f"U O sideways, J L turn; half speed, with Shift full.{drag}</div>"
                )
                if shown.pushes:
                    group = gui.add_button_group(f"push {_PUSH:g} m/s", tuple(_PUSHES))
                    _on(group.on_click, self._pushed)
        with gui.add_folder("Run"):
            self._acts(gui, "start", "stop")
            if shown.simulated:
                self._acts(gui, "pause", "step", "reset")
                self._offer(gui, "Run again", "again")
            if shown.records:
                self._offer(gui, "Open recording", "recording")
            if shown.swaps:
                self._acts(gui, "swap")
            if shown.skills:
                group = gui.add_button_group("skill", shown.skills)
                _on(group.on_click, lambda e: self._do("act", "skill", {"name": e.target.value}))

    def _offer(self, gui: Any, label: str, act: str) -> None:
        self._offers.append(self._button(gui, label, "act", "blue", False, act, {}))

    def _plot(self, _: Any) -> None:
        self.plots.visible = opens = not self.plots.visible
        self._do("plots", self._wide if opens else -self._wide)

    def _pushed(self, event: Any) -> None:
        velocity = [_PUSH * x for x in _PUSHES[event.target.value]]
        self._do("act", "push", {"velocity": velocity})

    def _acts(self, gui: Any, *names: str) -> None:
        group = gui.add_button_group(" ", names)
        _on(group.on_click, lambda event: self._do("act", event.target.value, {}))

    def _button(
        self, gui: Any, label: str, what: str, colour: str, visible: bool = True, *given: Any
    ) -> Any:
        button = gui.add_button(label, color=colour, visible=visible)
        _on(button.on_click, lambda _: self._do(what, *given))
        return button

    def _slider(self, gui: Any, axis: str, hint: str, low: float, high: float) -> Any:
        low, high = min(low, 0.0), max(high, 0.0)
        slider = gui.add_slider(
            axis, round(low, 2), round(max(high, low + 0.01), 2), 0.01, 0.0, hint=hint,
            disabled=True,
        )  # fmt: skip
        _on(slider.on_update, lambda _: self._do("steer", [each.value for each in self.sliders]))
        return slider

    def _parameter(self, gui: Any, name: str, parameter: Parameter) -> None:
        number = gui.add_number(
            name, parameter.value, min=parameter.low, max=parameter.high, step=0.01,
            hint=parameter.description,
        )  # fmt: skip
        _on(
            number.on_update,
            lambda _: self._do("act", "set_parameter", {"name": name, "value": number.value}),
        )

    def _recorded(self, gui: Any, span: tuple[float, float]) -> None:
        with gui.add_folder("Recording"):
            self.time = gui.add_slider("time [s]", span[0], max(span[1], span[0] + 0.01), 0.01,
                                       span[0])  # fmt: skip
            self.play = self._button(gui, "Play", "play", "blue")
            speed = gui.add_dropdown("speed", ("0.25", "0.5", "1", "2", "5", "10"), "1")
        _on(self.time.on_update, lambda _: self._do("seek", self.time.value))
        _on(speed.on_update, lambda _: self._do("speed", float(speed.value)))


def graph_html(graph: Sequence[GraphLine], counters: Sequence[int]) -> str:
    """Return the tree of the workflow, what runs in this tick in full colour."""
    lines = []
    for line in graph:
        look, mark = "opacity:.65", "·"
        if line.runs(counters):
            look, mark = "font-weight:600", "▸"
        lines.append(
            f'<div style="padding-left:{12 * line.depth}px;{look}">{mark} {escape(line.text)}</div>'
        )
    return (
        f'<div style="{STYLE};white-space:nowrap;overflow-x:auto;font-size:12px">'
        f"{''.join(lines)}</div>"
    )


def legend_html(contacts: bool) -> str:
    """Return what the colours in the 3D view mean."""
    items = [
        (COMMANDED, "commanded velocity"),
        (MEASURED, "measured velocity"),
        ((90, 90, 200), "path of the base"),
    ]
    if contacts:
        items.append(((214, 39, 40), "foot in contact"))
    marks = " &nbsp; ".join(
        f'<span style="color:rgb{colour};font-size:16px">■</span>&nbsp;{text}'
        for colour, text in items
    )
    return f'<div style="{STYLE}">{marks}<br>arrows: 0.6 m for 1 m/s; grid: 1 m</div>'
