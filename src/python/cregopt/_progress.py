"""How far a long call is, for those who watch."""

from __future__ import annotations

import contextlib
import importlib
from typing import Any, Callable, Iterator, Optional, Union

#: Is called with a dictionary; its key ``event`` is ``generation`` or ``improvement``, the others are those of result.json.
Progress = Callable[[dict[str, Any]], object]
#: A callable, or whether there is a bar.
Watch = Union[bool, Progress, None]


@contextlib.contextmanager
def watched(watch: Watch) -> Iterator[Optional[Progress]]:
    """The callable of those who watch a search."""
    if not isinstance(watch, bool):
        yield watch
    elif not watch:
        yield None
    else:
        with bar("no gait yet", " candidates") as shown:
            gaits = 0

            def tell(record: dict[str, Any]) -> None:
                nonlocal gaits
                if record["event"] == "generation":
                    gaits += record["feasible"]
                    shown.set_postfix_str(f"{gaits} gaits", refresh=False)
                    shown.update(record["evaluated"])
                else:
                    family = f"{record['family']}, " if record["family"] else ""
                    shown.set_description_str(f"best {family}{-record['objective']:.3f} after {record['seconds']:.2f} s")

            yield tell


def bar(description: str, unit: str, total: Optional[int] = None) -> Any:
    """A bar of tqdm: in notebooks theirs, else a line on stderr."""
    try:
        tqdm = importlib.import_module("tqdm.auto").tqdm
    except ImportError as missing:
        raise ImportError("progress=True needs tqdm, which is not here: pip install cregopt[progress]", name="tqdm") from missing
    return tqdm(desc=description, unit=unit, total=total)
