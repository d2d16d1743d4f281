"""Progress of long calls: a callback or a progress bar."""

from __future__ import annotations

import contextlib
import importlib
from typing import Any, Callable, Iterator, Optional, Union

#: Callback that takes a dictionary. Its key ``event`` is ``generation``, ``improvement`` or ``lower-ground``; the other keys are those of
#: result.json.
Progress = Callable[[dict[str, Any]], object]
#: A callback, True for a progress bar, or False or None for neither.
Watch = Union[bool, Progress, None]


@contextlib.contextmanager
def watched(watch: Watch) -> Iterator[Optional[Progress]]:
    """Callback for the option ``progress`` of a search, or None. If the option is True, a progress bar is shown within the context."""
    if not isinstance(watch, bool):
        yield watch
    elif not watch:
        yield None
    else:
        with bar("no gait yet", " candidates") as shown:
            gaits = 0

            def update(record: dict[str, Any]) -> None:
                nonlocal gaits
                if record["event"] == "generation":
                    gaits += record["feasible"]
                    shown.set_postfix_str(f"{gaits} gaits", refresh=False)
                    shown.update(record["evaluated"])
                elif record["event"] == "lower-ground":
                    shown.set_description_str(f"a gait on {100 * record['share']:.0f} % of the relief")
                else:
                    family = f"{record['family']}, " if record["family"] else ""
                    shown.set_description_str(f"best {family}{-record['objective']:.3f} after {record['seconds']:.2f} s")

            yield update


def bar(description: str, unit: str, total: Optional[int] = None) -> Any:
    """Progress bar of tqdm: a widget in a notebook, otherwise a line on stderr."""
    try:
        tqdm = importlib.import_module("tqdm.auto").tqdm
    except ImportError as missing:
        raise ImportError("progress=True needs tqdm, which is not installed: pip install cregopt[progress]", name="tqdm") from missing
    return tqdm(desc=description, unit=unit, total=total)
