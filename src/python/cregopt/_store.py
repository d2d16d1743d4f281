"""Rows of a sweep in a folder of Parquet files."""

from __future__ import annotations

import pathlib
import time
import uuid
import warnings
from typing import Any, Mapping

from ._cluster import needed
from ._cregopt import Error

#: Rows are written when they are as many, or as old in s.
_ROWS, _AGE = 256, 10.0


class Store:
    """The rows of a folder. Those with an error stand in files of their own, which the next sweep writes anew."""

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
        """The results that are there for jobs, by their keys."""
        self.folder.mkdir(parents=True, exist_ok=True)
        for left in self.folder.glob(".*.parquet.tmp"):
            left.unlink()
        there = {row["key"]: row for path in self.folder.glob("part-*.parquet") for row in self._read(path) if row["key"] in jobs}
        failed = list(self.folder.glob("failed-*.parquet"))
        self._write("failed", [row for path in failed for row in self._read(path) if row["key"] not in jobs])
        for path in failed:
            path.unlink(missing_ok=True)
        return there

    def add(self, row: dict[str, Any]) -> None:
        self.rows.append(row)
        if len(self.rows) >= _ROWS or time.monotonic() - self.written > _AGE:
            self.flush()

    def flush(self) -> None:
        rows, self.rows, self.written = self.rows, [], time.monotonic()
        self._write("part", [row for row in rows if row["error"] is None])
        self._write("failed", [row for row in rows if row["error"] is not None])

    def table(self, rows: list[dict[str, Any]]) -> Any:
        return self.arrow.Table.from_pylist(rows, schema=self.arrow.schema([self.schema.field(name) for name in self.columns]))

    def _read(self, path: pathlib.Path) -> list[dict[str, Any]]:
        try:
            with open(path, "rb") as file:
                schema = self.parquet.read_schema(file)
                if schema.equals(self.schema):
                    rows: list[dict[str, Any]] = self.parquet.read_table(file, columns=self.columns).to_pylist()
                    return rows
        except PermissionError:
            raise
        except (self.arrow.ArrowInvalid, OSError) as torn:
            warnings.warn(f"{path}: dropped, for it cannot be read: {torn}", stacklevel=4)
            path.unlink()
            return []
        raise Error(f"{path}: columns {schema.names}, but those of a sweep are {self.schema.names}: choose another folder")

    def _write(self, kind: str, rows: list[dict[str, Any]]) -> None:
        if rows:
            path = self.folder / f"{kind}-{uuid.uuid4().hex}.parquet"
            part = path.with_name(f".{path.name}.tmp")
            self.parquet.write_table(self.arrow.Table.from_pylist(rows, schema=self.schema), part)
            part.replace(path)
