"""The folder of a sweep: nothing is lost, nothing is done twice, whatever ends it."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from unicon_base.errors import UniconError
from unicon_lab.sweep import folder as folders
from unicon_lab.sweep.figures import empty_row
from unicon_lab.sweep.folder import JOURNAL, METADATA, SWEEP, Folder, read_journal
from unicon_lab.sweep.plan import Plan
from unicon_lab.sweep.results import Results
from unicon_lab.sweep.sweep_file import read_sweep

pytest.importorskip("pyarrow")

TEXT = "workflow: go2_stand\nvary: {scene.seed: {range: [0, 19]}, platform: [mujoco, fake]}\n"


def plan_of(tmp_path: Path, text: str = TEXT) -> Plan:
    (tmp_path / "sweep.yaml").write_text(text, "utf-8")
    return Plan(read_sweep(tmp_path / "sweep.yaml"))


def figures(index: int) -> dict[str, Any]:
    return empty_row() | {"outcome": "done", "fell": index % 3 == 0, "distance_m": index / 7.0}


def filled(tmp_path: Path, rows: range, plan: Plan | None = None) -> Folder:
    folder = Folder(tmp_path / "out", plan or plan_of(tmp_path), "made")
    for index in rows:
        folder.add(index, figures(index))
    return folder


def test_rows_come_back_from_journal_and_shards_alike(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folders, "SHARD_ROWS", 8)
    folder = filled(tmp_path, range(19))
    assert len(list(folder.path.glob("*.parquet"))) == 2
    assert sorted(read_journal(folder.path)) == [16, 17, 18]
    folder.close()  # as if it were killed: nothing was flushed
    again = filled(tmp_path, range(10, 40))
    assert again.done == set(range(40))
    again.flush()
    again.close()
    results = Results(tmp_path / "out")
    assert results.rows == list(range(40))
    assert results.column("distance_m") == [i / 7.0 for i in range(40)]
    assert results.varied("platform") == ["mujoco", "fake"] * 20
    assert results.lacking == 0
    assert results.settings(3) == ["scene.seed=1", "platform=fake"]


def test_the_table_has_one_hash_in_whatever_order_and_shards(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hashes = set()
    for k, (size, order) in enumerate([(1000, 1), (7, -1), (3, 1)]):
        monkeypatch.setattr(folders, "SHARD_ROWS", size)
        folder = Folder(tmp_path / f"out{k}", plan_of(tmp_path), "made")
        for index in list(range(40))[::order]:
            folder.add(index, figures(index))
        folder.flush()
        folder.close()
        hashes.add(Results(folder.path).sha256)
    assert len(hashes) == 1


def test_a_torn_line_and_garbage_are_rows_that_were_not_run(tmp_path: Path) -> None:
    filled(tmp_path, range(5)).close()
    path = tmp_path / "out" / JOURNAL
    lines = path.read_bytes().splitlines(keepends=True)
    noise = b"\x00\xff\n[1]\n{}\n[7, 3]\n" + b'["x", {"outcome": "done"}]\n'
    path.write_bytes(b"".join([*lines[:3], noise, lines[3], lines[4][:20]]))
    folder = Folder(tmp_path / "out", plan_of(tmp_path), "made")
    assert folder.done == {0, 1, 2, 3}
    folder.add(4, figures(4))
    folder.flush()
    folder.close()
    assert Results(tmp_path / "out").rows == [0, 1, 2, 3, 4]


def test_a_shard_and_the_journal_may_both_have_a_row(tmp_path: Path) -> None:
    folder = filled(tmp_path, range(4))
    journal = (tmp_path / "out" / JOURNAL).read_bytes()
    folder.flush()
    folder.close()
    (tmp_path / "out" / JOURNAL).write_bytes(journal)  # killed between the two
    again = filled(tmp_path, range(6))
    again.flush()
    again.close()
    assert Results(tmp_path / "out").rows == [0, 1, 2, 3, 4, 5]


def test_the_metadata_say_what_made_the_rows(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    folder = filled(tmp_path, range(3))
    folder.know({"abc": {"policy walk": "1234"}})
    folder.flush()
    folder.close()
    told = parquet.read_schema(folder.path / "shard-0000.parquet").metadata[METADATA]
    said = json.loads(told)
    assert {"sha256", "code", "versions", "identity", "programs", "program"} <= set(said)
    assert said["programs"] == {"abc": {"policy walk": "1234"}}
    assert (
        len(said["code"]) == len(said["sha256"]) == len(said["identity"]["sha256_workflow"]) == 64
    )


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"sha256": "0" * 64, "identity": {}}, "has another sweep: it differs in schema, workflow"),
        ({"versions": {"numpy": "0.1"}}, "numpy was 0.1 and is "),
        ({"code": "0" * 64}, "it was made by other code of the same version"),
        ({"program": "other"}, "robot, model or policy are other files by now"),
    ],
)
def test_another_sweep_is_refused(tmp_path: Path, change: dict[str, Any], told: str) -> None:
    filled(tmp_path, range(2)).close()
    path = tmp_path / "out" / SWEEP
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(UniconError) as error:
        filled(tmp_path, range(0))
    assert told in str(error.value)
    assert str(error.value).endswith("give another folder to --out")


def test_another_file_in_the_same_folder_is_refused(tmp_path: Path) -> None:
    filled(tmp_path, range(2)).close()
    other = plan_of(tmp_path, TEXT + "repeat: 1\nduration: 0.5\n")
    with pytest.raises(UniconError, match="has another sweep: it differs in duration_s"):
        filled(tmp_path, range(0), other)


def test_two_at_once_are_refused(tmp_path: Path) -> None:
    folder = filled(tmp_path, range(1))
    with pytest.raises(UniconError, match=r"another unicon sweep writes in .*; wait for its end"):
        filled(tmp_path, range(0))
    folder.close()
    filled(tmp_path, range(0)).close()


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / JOURNAL).write_bytes(b"")
    with pytest.raises(UniconError, match=r"has results without sweep\.json; give another --out"):
        filled(tmp_path, range(0))
    (tmp_path / "out" / SWEEP).write_text("{}")
    with pytest.raises(UniconError, match=r"cannot read .*sweep\.json: it is of another kind"):
        filled(tmp_path, range(0))
    kept = {"sha256": "", "identity": {}, "programs": {}, "versions": {}}
    (tmp_path / "out" / SWEEP).write_text(json.dumps(kept | {"programs": 3}))
    with pytest.raises(UniconError, match=r"cannot read .*sweep\.json: it is of another kind"):
        Results(tmp_path / "out")
    (tmp_path / "out" / SWEEP).write_text(json.dumps(kept))
    with pytest.raises(UniconError, match=r"sweep\.json is not of unicon\.sweep/1; give the"):
        Results(tmp_path / "out")
    with pytest.raises(UniconError, match=r"has no sweep\.json; give the folder of a sweep"):
        Results(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(UniconError, match=r"cannot write in .*; give another folder to --out"):
        Folder(tmp_path / "file", plan_of(tmp_path), "made")


def test_a_broken_shard_is_told(tmp_path: Path) -> None:
    folder = filled(tmp_path, range(3))
    folder.flush()
    folder.close()
    (folder.path / "shard-0000.parquet").write_bytes(b"PAR1 no PAR1")
    with pytest.raises(UniconError, match=r"cannot read .*move it away, and its rows are"):
        filled(tmp_path, range(0))
    (folder.path / "shard-0000.parquet").rename(tmp_path / "away")
    again = filled(tmp_path, range(3))
    again.flush()
    again.close()
    assert Results(folder.path).rows == [0, 1, 2]


def test_a_shard_of_somebody_else_is_told(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    folder = filled(tmp_path, range(3))
    folder.flush()
    folder.close()
    parquet.write_table(pyarrow.table({"row": [100, 101]}), folder.path / "shard-0001.parquet")
    parquet.write_table(pyarrow.table({"row": ["x"]}), folder.path / "mine.parquet")
    for read in (lambda: filled(tmp_path, range(0)), lambda: Results(folder.path)):
        with pytest.raises(
            UniconError, match=r"shard-0001\.parquet: it is not a shard of this sweep"
        ):
            read()
    (folder.path / "shard-0001.parquet").unlink()
    assert Results(folder.path).rows == [0, 1, 2]


def test_rows_that_the_sweep_has_not_are_not_done(tmp_path: Path) -> None:
    filled(tmp_path, range(2)).close()
    with (tmp_path / "out" / JOURNAL).open("a") as journal:
        journal.write(json.dumps([40, figures(40)]) + "\n")
    folder = filled(tmp_path, range(0))
    assert folder.done == {0, 1}
    folder.close()


def test_a_full_disk_is_told_and_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = filled(tmp_path, range(3))
    write = os.write

    def half(descriptor: int, data: bytes) -> int:
        return write(descriptor, data[: len(data) // 2])

    monkeypatch.setattr(folders.os, "write", half)
    with pytest.raises(
        UniconError, match=r"cannot write in .*: No space left on device; what is in"
    ):
        folder.add(3, figures(3))
    monkeypatch.setattr(folders.os, "write", write)
    folder.close()

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    again = filled(tmp_path, range(0))
    assert again.done == {0, 1, 2}
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(UniconError, match="No space left on device; what is in it stays"):
            again.flush()
    assert not list(again.path.glob("*.half"))
    assert not list(again.path.glob("*.parquet"))
    again.flush()
    again.close()
    assert Results(tmp_path / "out").rows == [0, 1, 2]


def test_a_process_that_is_killed_loses_no_row_it_has_added(tmp_path: Path) -> None:
    plan_of(tmp_path)
    code = (
        "import os, sys; from pathlib import Path; sys.path.insert(0, sys.argv[2])\n"
        "from test_sweep_folder import *\n"
        "folder = filled(Path(sys.argv[1]), range(13)); os.kill(os.getpid(), 9)\n"
    )
    here = str(Path(__file__).parent)
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path), here], check=False)
    assert done.returncode == -9
    assert sorted(read_journal(tmp_path / "out")) == list(range(13))
    filled(tmp_path, range(0)).close()  # the lock went with it


def test_pyarrow_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("pyarrow", "pyarrow.parquet"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(UniconError, match=r"unicon sweep needs pyarrow: pip install 'unicon_ros\["):
        folders.require_pyarrow()
