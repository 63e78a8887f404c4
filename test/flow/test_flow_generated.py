"""Generated code comes from several threads at once: each run compiles its own graph."""

from __future__ import annotations

import gc
import threading
import time

from unicon_base.generated import check_source


def test_threads_that_compile_at_once_do_not_disturb_each_other() -> None:
    source = "def f(a, b):\n" + "    x = (a + (b * (a - 1)))\n" * 300
    errors: list[BaseException] = []
    trees: list[object] = []

    def compile_often() -> None:
        try:
            trees.extend(check_source(source, {}) for _ in range(10))
        except BaseException as error:
            errors.append(error)

    def change_places(phase: str, info: dict[str, int]) -> None:
        time.sleep(1e-4)

    threshold = gc.get_threshold()
    gc.callbacks.append(change_places)
    gc.set_threshold(50)
    try:
        threads = [threading.Thread(target=compile_often) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        gc.callbacks.remove(change_places)
        gc.set_threshold(*threshold)
    assert not errors
    assert len(trees) == 40
