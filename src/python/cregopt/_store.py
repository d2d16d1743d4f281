"""Storage of the rows of a sweep in a folder of Parquet files."""

from __future__ import annotations

import pathlib
import time
import uuid
import warnings
from typing import Any, Mapping

from ._cluster import needed
from ._cregopt import Error

#: Number of rows, and time in s since the last write, after which rows are written.
_ROWS, _AGE = 256, 10.0


class Store:
    """Rows in a folder. Rows with an error are in files of their own, ``failed-*.parquet``, which the next sweep rewrites."""

    def __init__(self, folder: pathlib.Path) -> None:
        self.arrow, self.parquet = needed("pyarrow"), needed("pyarrow.parquet")
        text, number = self.arrow.string(), self.arrow.float64()
        kinds = {"key": text, "task": text, "seed": self.arrow.int64(), "feasible": self.arrow.bool_(), "family": text, "cost": number}
        kinds.update({"objective": text, "horizon": number, "seconds": number, "durations": text, "error": text, "trajectory": text})
        self.schema = self.arrow.schema(list(kinds.items()))
        self.columns = [name for name in kinds if name != "trajectory"]
        self.blank: dict[str, Any] = dict.fromkeys(kinds)
        self.folder = folder
        self.rows: list[dict[str, Any]] = []
        self.written = time.monotonic()

    def open(self, jobs: Mapping[str, object]) -> dict[str, dict[str, Any]]:
        """Stored results of these jobs, by key.

        Makes the folder, removes unfinished files, and forgets the failures of these jobs, which run again.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        for left in self.folder.glob(".*.parquet.tmp"):
            left.unlink()
        stored = {row["key"]: row for path in self.folder.glob("part-*.parquet") for row in self._read(path) if row["key"] in jobs}
        failed = list(self.folder.glob("failed-*.parquet"))
        self._write("failed", [row for path in failed for row in self._read(path) if row["key"] not in jobs])
        for path in failed:
            path.unlink(missing_ok=True)
        return stored

    def add(self, row: dict[str, Any]) -> None:
        """Adds a row. Writes all rows that are not yet written when they are many or old."""
        self.rows.append(row)
        if len(self.rows) >= _ROWS or time.monotonic() - self.written > _AGE:
            self.flush()

    def flush(self) -> None:
        """Writes all rows that are not yet written."""
        rows, self.rows, self.written = self.rows, [], time.monotonic()
        self._write("part", [row for row in rows if row["error"] is None])
        self._write("failed", [row for row in rows if row["error"] is not None])

    def table(self, rows: list[dict[str, Any]]) -> Any:
        """Arrow table of rows, without the column ``trajectory``."""
        return self.arrow.Table.from_pylist(rows, schema=self.arrow.schema([self.schema.field(name) for name in self.columns]))

    def _read(self, path: pathlib.Path) -> list[dict[str, Any]]:
        """Rows of a file, without trajectories. Deletes a file that cannot be read, with a warning; raises Error for other columns."""
        try:
            with open(path, "rb") as file:
                schema = self.parquet.read_schema(file)
                if schema.equals(self.schema):
                    rows: list[dict[str, Any]] = self.parquet.read_table(file, columns=self.columns).to_pylist()
                    return rows
        except PermissionError:
            raise
        except (self.arrow.ArrowInvalid, OSError) as torn:
            warnings.warn(f"{path}: dropped, because it cannot be read: {torn}", stacklevel=4)
            path.unlink()
            return []
        raise Error(f"{path}: columns {schema.names}, but those of a sweep are {self.schema.names}: choose another folder")

    def _write(self, kind: str, rows: list[dict[str, Any]]) -> None:
        """Writes rows to a new file, which appears under its name only when it is complete."""
        if rows:
            path = self.folder / f"{kind}-{uuid.uuid4().hex}.parquet"
            part = path.with_name(f".{path.name}.tmp")
            self.parquet.write_table(self.arrow.Table.from_pylist(rows, schema=self.schema), part)
            part.replace(path)
