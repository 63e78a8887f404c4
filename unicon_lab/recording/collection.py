"""Collection: a recording of which an operator keeps episodes, for `unicon run --collect`."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from unicon_base import AnyDict, UniconError, cannot, one_line
from unicon_core.blocks.controls.device import Keyboard, read_keys, take_terminal
from unicon_core.flow import Stage
from unicon_core.page import ROOM, write_json
from unicon_core.runtime import Report, Runner
from unicon_core.runtime.phases import Phase
from unicon_core.workflow import HookBlocks, Program
from unicon_lab.recording.recover import recover
from unicon_lab.recording.run_recording import Recording
from unicon_ros.attachments import File

LOOK = 0.02
"""How often keys and buttons are looked at, in [s]; the tick knows nothing of them."""
SETTLES = 0.1
"""For so long the pictures of the last tick may be on their way to the recording, in [s]."""
KEYS = "s start, k keep, d discard, ? these; a headset: right stick start and keep, left discard"
QUALITY = 90
"""Of the JPEG of raw pictures."""
PRESSED = 0.5
"""How far a thumbstick is pressed that counts, 0 to 1."""
BLIND = 1.0
"""A camera without a new picture for so long spoils an episode, in [s] of ticks."""


class Collection(Recording):
    """Records a run; keys say which of its ticks are episodes, and which of those are kept.

    `DIR.recordings` has a recording of each session, and `episodes.json`, which counts an episode
    once its ticks and pictures are on the medium. The data set DIR is made of them at the end.
    Episodes are marked by ticks, which may not repeat.

    Args:
        wanted: episodes that are kept in all; then the run ends.
        task: what they show; "" for the workflow's name.
        out: folder of the data set, made by an earlier session or not there.
        options: as of `Recording`, of which path and frames are given here.

    Raises:
        UniconError: the folder is none of a collection, or has as many episodes.
    """

    returns = False

    def __init__(self, wanted: int, task: str, out: str, *options: Any) -> None:
        from unicon_lab.datasets.export import KEPT, kept_in

        self._out, self._wanted, self._task = Path(out), wanted, task
        folder = self._folder = Path(f"{out.rstrip(os.sep)}.recordings")
        self._marks, self._kept = folder / KEPT, list[list[Any]]()
        if self._marks.exists():
            for path, episodes in kept_in(folder).items():
                self._kept += [[path.name, e.first, e.last, e.task] for e in episodes]
        elif self._out.exists():
            raise UniconError(f"{out} exists, and {folder} does not: give another name")
        if len(self._kept) >= wanted:
            raise UniconError(
                f"{folder} has {len(self._kept)} episodes; give more --episodes, or write them: "
                f"unicon bag export --lerobot {folder} --out {out}"
            )
        for rest in folder.glob("*.mcap.partial"):  # what a killed session left
            recover(rest, final_name=True)
        names = (folder / f"session-{number:03d}.mcap" for number in count(1))
        super().__init__(next(name for name in names if not name.exists()), *options)
        self._begin: int | None = None
        self._dropped, self._busy, self._spoiled = 0, "", ""
        self._keys, self._held = True, set[str]()
        self._give_back: Callable[[], object] = bool
        self._tells: list[Callable[[str], object]] = [self._note]
        self._over, self._anew = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._work, name="collect", daemon=True)

    def hook(self, program: Program) -> HookBlocks:
        """Return the block that records, with the pictures of all cameras."""
        for block in program.blocks:
            if isinstance(block.tick, Keyboard):
                raise UniconError(
                    "--collect reads the keys that block keyboard reads: leave one out"
                )
            self.frames = ["all"] if getattr(block.tick, "sources", ()) else self.frames
            if shows := getattr(block.tick, "say", None):
                self._tells.append(shows)
        self.jpeg = self.jpeg or QUALITY
        stages = super().hook(program)
        stages[Stage.OBSERVE][0].reset = self._anew.set
        return stages

    def attach(self, runner: Runner) -> None:
        """See `Attachment`."""
        states, self._runner = runner.program.states, runner
        self._sticks = {
            key: states[name].reshape(-1)[spec.names.index("thumbstick") :]
            for name, spec in states.layout.specs.items()
            for side, key in (("right", "r"), ("left", "d"))
            if name.endswith(f"_{side}_buttons") and "thumbstick" in spec.names
        }
        names = (name for b in runner.program.blocks for name in getattr(b.tick, "sources", ()))
        self._newest = {name: (0, 0, states[f"{name}_handle"]) for name in names}
        self._thread.start()

    def status(self) -> AnyDict:
        """See `Attachment`."""
        state = self._busy or ("idle" if self._begin is None else "RECORDING")
        return {f"episode {min(len(self._kept) + 1, self._wanted)}/{self._wanted}": state}

    def press(self, key: str) -> None:
        """Do what a key says, in a thread that may wait; `r` starts, and keeps what is started."""
        if key == "?":
            self._note(KEYS)
        elif self._busy:
            return
        elif key in "sr" and self._begin is None:
            self._begin, self._spoiled = self._tick() + 1, ""
            self._anew.clear()  # of the reset before
            self._dropped = self.counts()["dropped"]
            self._say("started")
        elif key in "kdr" and self._begin is not None:
            first, last, self._begin = self._begin, self._tick(), None
            self._say(self._keep(first, last) if key != "d" else "discarded")
            if len(self._kept) == self._wanted:
                self._runner.stop()
            elif self._runner.program.platform.facts.simulated:
                self._busy = "reset"
                self._runner.call_soon(self._reset)

    def _keep(self, first: int, last: int) -> str:
        """Mark an episode as kept once it is on the medium; return what became of it."""
        self._busy = "saving"
        time.sleep(SETTLES)
        mark = [Path(self.path).name, first, last, self._task]
        try:
            if last < first:
                return "discarded: it has no tick"
            if self._spoiled:
                return f"NOT kept: {self._spoiled}"
            if not self._recorder.flush():
                return f"NOT kept: {self.counts()['error'] or 'the recording has ended'}"
            if lost := self.counts()["dropped"] - self._dropped:
                return f"NOT kept: {lost} of its messages were lost, the medium is too slow"
            write_json(self._marks, [*self._kept, mark])
        except (OSError, UniconError) as error:
            return f"NOT kept: {one_line(error)}"
        finally:
            self._busy = ""
        self._kept.append(mark)
        return f"kept, {(last - first + 1) * self._runner.program.period:.1f} s"

    def _reset(self) -> None:
        try:
            self._runner.reset()
        finally:
            self._busy = ""

    def _tick(self) -> int:
        return int(self._runner.program.states["tick"].flat[0])

    def _spoil(self, why: str) -> None:
        """Note why the present episode cannot be kept, and say so at once."""
        if self._begin is not None and not self._spoiled:
            self._spoiled = why
            self._say(f"discard it: {why}")

    def _look(self) -> None:
        """Spoil an episode in which a camera gives no picture, or the flow was reset."""
        tick = self._tick()
        if self._anew.is_set():
            self._anew.clear()
            self._spoil("the run was reset")
        for name, (number, since, handle) in self._newest.items():
            if (new := int(handle.flat[0])) not in (0, number):
                self._newest[name] = new, tick, handle
            elif (tick - since) * self._runner.program.period > BLIND:
                self._spoil(f"{name} gives no picture")

    def _note(self, text: str) -> None:
        self.warn(f"note: collect: {text}")

    def _say(self, what: str) -> None:
        text = f"{what}; {len(self._kept)} of {self._wanted} episodes are kept"
        for tell in self._tells:
            tell(text)

    def _work(self) -> None:
        told = False
        while not self._over.wait(LOOK):
            if self._runner.phase is not Phase.RUN:  # before, Enter is the operator's go
                self._begin = None
                continue
            if not told:
                told = True
                with suppress(OSError):  # a pipe has keys as well
                    self._give_back = take_terminal()
                self._note(KEYS)
            self._look()
            for key in self._pressed():
                self.press(key)

    def _pressed(self) -> str:
        """Return the keys and buttons that were pressed since the last look."""
        held = {key for key, stick in self._sticks.items() if stick[0] > PRESSED}
        keys, self._held = "".join(sorted(held - self._held)), held
        if self._keys:
            read = read_keys()
            self._keys = read is not None
            keys += (read or b"").decode("ascii", "replace").lower()
        if not self._keys and not self._sticks:
            self._note("neither keys nor a headset: the run ends; start it in a terminal")
            self._runner.stop()
        return keys

    def close(self) -> None:
        """Give the terminal back."""
        self._over.set()
        if self._thread.ident is not None:
            self._thread.join(1.0)
        self._give_back()

    def files(self, report: Report) -> Iterator[File]:
        """See `Attachment`."""
        if self._kept:
            yield "collect", str(self._out), self._export

    def _export(self) -> None:
        """Make the data set, and put it in the place of the one before."""
        from unicon_lab.datasets.export import Wanted, export_dataset

        out = self._out
        with TemporaryDirectory(prefix=f"{out.name}.partial-", dir=out.parent) as beside:
            made = Path(beside, "new")
            lines = export_dataset([self._folder], made, Wanted())
            with cannot(f"write {out}", ROOM):
                if out.exists():
                    out.rename(Path(beside, "old"))
                made.rename(out)
        print("\n".join(lines[1:]))
