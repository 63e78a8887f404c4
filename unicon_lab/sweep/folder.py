"""Folder of a sweep: what is done is in it, whatever ends the sweep, and nothing of it twice.

`sweep.json` says which sweep it is; `shard-NNNN.parquet` hold rows, each file whole or not there;
`journal.jsonl` has those since the last shard, a line each.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

from unicon_base import AnyDict, AnyMapping, UniconError, cannot, imported
from unicon_core.page import write_file, write_json
from unicon_lab.sweep.figures import COLUMNS
from unicon_lab.sweep.plan import Plan, Row, changes, code_sha256, versions

SWEEP, JOURNAL, LOCK = "sweep.json", "journal.jsonl", ".lock"
SHARD_ROWS = 1000


def require_pyarrow() -> None:
    """Say before the work that its results cannot be written.

    Raises:
        MissingDependencyError: pyarrow is not installed.
    """
    imported("pyarrow.parquet", "unicon sweep", "sweep")


def locked(folder: Path) -> IO[bytes]:
    """Return a lock on a folder until it is closed.

    Raises:
        BlockingIOError: another process has it.
        OSError: the folder cannot be written.
    """
    lock = (folder / LOCK).open("wb")
    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return lock


class Folder:
    """Where the results of a sweep go; one process has it at a time.

    Args:
        path: of the folder, made as needed.
        plan: of the sweep.
        program: hash of what the first row's program is made of.

    Attributes:
        path: the same.
        done: indices of rows that have a result.

    Raises:
        UniconError: it holds another sweep, somebody else writes in it, or it cannot be written.
    """

    def __init__(self, path: Path, plan: Plan, program: str) -> None:
        self.path, self._plan = path, plan
        with cannot(f"write in {path}", "give another folder to --out"):
            path.mkdir(parents=True, exist_ok=True)
            try:
                self._lock = locked(path)
            except BlockingIOError as error:
                raise UniconError(
                    f"another unicon sweep writes in {path}; wait for its end, or give another "
                    "--out"
                ) from error
        try:
            self._facts = self._said(program)
            self._pending = read_journal(path)
            in_shards = {int(i) for i in read_shards(path, plan.sha256, ["row"])["row"]}
            left = set(range(len(plan))) - in_shards
            self._pending = {i: r for i, r in self._pending.items() if i in left}
            self.done = in_shards | set(self._pending)
            self._numbers = max((int(name.stem[-4:]) + 1 for name in shard_names(path)), default=0)
            self._journal = self._opened()
        except BaseException:
            self._lock.close()
            raise

    def _said(self, program: str) -> AnyDict:
        """Return what the folder says of its sweep, which is this one."""
        here = {
            "sha256": self._plan.sha256,
            "code": code_sha256(),
            "versions": versions(),
            "program": program,
        }
        there = read_sweep_json(self.path)
        if there is None:
            if any(self.path.glob("*.parquet")) or (self.path / JOURNAL).exists():
                raise UniconError(f"{self.path} has results without {SWEEP}; give another --out")
            facts = {**here, "identity": self._plan.identity(), "programs": {}}
            facts["run"] = self._plan.sweep.workflow
            write_json(self.path / SWEEP, facts)
            return facts
        differs = changes(there, here, self._plan.identity())
        if differs:
            raise UniconError(
                f"{self.path} has another sweep: {differs}; give another folder to --out"
            )
        return there

    def _opened(self) -> IO[bytes]:
        """Open the journal with what is known and nothing else in it: its last line may be torn."""
        lines = [_line(index, row) for index, row in self._pending.items()]
        write_file(self.path / JOURNAL, b"".join(lines))
        return (self.path / JOURNAL).open("ab", buffering=0)

    def know(self, facts: AnyMapping) -> None:
        """Write down what programs are made of."""
        if any(name not in self._facts["programs"] for name in facts):
            self._facts["programs"] |= facts
            write_json(self.path / SWEEP, self._facts)

    def add(self, index: int, figures: AnyDict) -> None:
        """Write a row down; it is not lost from here on.

        Raises:
            UniconError: it cannot be written.
        """
        if index in self.done:
            return
        line = _line(index, figures)
        try:
            if os.write(self._journal.fileno(), line) != len(line):
                raise OSError(28, "No space left on device")
        except OSError as error:
            raise self._full(error) from error
        self.done.add(index)
        self._pending[index] = figures
        if len(self._pending) >= SHARD_ROWS:
            self.flush()

    def flush(self) -> None:
        """Put the rows of the journal into a shard.

        Raises:
            UniconError: it cannot be written; the journal keeps them.
        """
        if not self._pending:
            return
        name = f"shard-{self._numbers:04d}.parquet"
        rows = [(self._plan.row(i), self._pending[i]) for i in sorted(self._pending)]
        try:
            write_shard(self.path / name, self._plan, rows, self._facts)
        except OSError as error:
            raise self._full(error) from error
        self._numbers += 1
        self._pending.clear()
        journal = self._opened()
        self._journal.close()
        self._journal = journal

    def _full(self, error: OSError) -> UniconError:
        return UniconError(
            f"cannot write in {self.path}: {error.strerror}; what is in it stays: make room and "
            "run the same command again"
        )

    def close(self) -> None:
        """Let the folder go; what is in the journal stays there."""
        self._journal.close()
        self._lock.close()


def read_sweep_json(path: Path) -> AnyDict | None:
    """Return what a folder says of its sweep, None where there is none.

    Raises:
        UniconError: it cannot be read.
    """
    try:
        found = json.loads((path / SWEEP).read_bytes())
        kinds = {"sha256": str, "identity": dict, "programs": dict, "versions": dict}
        if not isinstance(found, dict) or any(
            not isinstance(found.get(key), kind) for key, kind in kinds.items()
        ):
            raise ValueError("it is of another kind")
        return found
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise UniconError(f"cannot read {path / SWEEP}: {error}; give another folder") from error


def read_journal(path: Path) -> dict[int, AnyDict]:
    """Return the rows of a journal; a line that is torn or garbage is a row that was not run."""
    journal = path / JOURNAL
    with cannot(f"read {journal}", "make it readable"):
        lines = journal.read_bytes().split(b"\n") if journal.exists() else []
    found = {}
    for line in lines[:-1]:  # what stands behind the last end of a line is torn
        try:
            index, figures = json.loads(line)
            if isinstance(figures, dict) and "outcome" in figures:
                found[int(index)] = figures
        except (TypeError, ValueError):
            continue
    return found


def _line(index: int, figures: AnyMapping) -> bytes:
    return (json.dumps([index, figures]) + "\n").encode()


METADATA = b"unicon.sweep"
"""Key of the schema's metadata whose value is JSON: identity, code, versions, programs."""
SETTINGS = "settings"
"""Column with the texts of `--set` of a row, as a JSON list."""
VARIED = "set."
"""What stands before the path of a parameter in the name of its column."""


def shard_names(folder: Path) -> list[Path]:
    """Return the shards of a folder, in order."""
    return sorted(folder.glob("shard-[0-9][0-9][0-9][0-9].parquet"))


def write_shard(
    path: Path, plan: Plan, rows: Sequence[tuple[Row, AnyMapping]], facts: AnyMapping
) -> None:
    """Write a shard, whole or not at all, and on the disk when it returns.

    Args:
        path: of the file.
        plan: of the sweep.
        rows: with their figures.
        facts: for the metadata.

    Raises:
        OSError: it cannot be written.
    """
    import pyarrow
    from pyarrow import parquet

    kinds = {bool: pyarrow.bool_(), int: pyarrow.int64(), float: pyarrow.float64()}
    varied = {VARIED + each.path: each.type for each in plan.sweep.parameters}
    types = {"row": int, "repetition": int, **varied, SETTINGS: str}
    types |= {name: column.kind for name, column in COLUMNS.items()}
    told = []
    for row, figures in rows:
        values = zip(varied.items(), row.values)
        told.append(
            {"row": row.index, "repetition": row.repetition, **figures}
            | {SETTINGS: json.dumps(row.settings, ensure_ascii=False)}
            | {name: _text(v) if kind is str else v for (name, kind), v in values}
        )
    schema = pyarrow.schema(
        [(name, kinds.get(kind, pyarrow.string())) for name, kind in types.items()],
        metadata={METADATA: json.dumps(facts)},
    )
    table = pyarrow.Table.from_pylist(told, schema)
    half = path.with_name(f".{path.name}.half")
    try:
        with half.open("wb") as file:
            parquet.write_table(table, file)
            file.flush()
            os.fsync(file.fileno())
        half.replace(path)
    except OSError:
        half.unlink(missing_ok=True)
        raise
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def read_shards(
    folder: Path, sha256: str, names: Sequence[str] | None = None
) -> dict[str, list[Any]]:
    """Return columns of all shards of a folder, by name.

    Args:
        folder: of the sweep.
        sha256: of the sweep.
        names: of the columns, None for all.

    Raises:
        UniconError: a file is not a shard, or one of another sweep.
    """
    import pyarrow
    from pyarrow import parquet

    found: dict[str, list[Any]] = {name: [] for name in names or ()}
    for path in shard_names(folder):
        try:
            table = parquet.read_table(path, columns=None if names is None else list(names))
            facts = json.loads((table.schema.metadata or {}).get(METADATA, b"{}"))
            if facts.get("sha256") != sha256:
                raise ValueError("it is not a shard of this sweep")
        except (OSError, ValueError, pyarrow.ArrowException) as error:
            raise UniconError(
                f"cannot read {path}: {str(error).splitlines()[0][:100]}; move it away, and its "
                "rows are run again"
            ) from error
        for name in table.column_names:
            found.setdefault(name, []).extend(table.column(name).to_pylist())
    return found
