"""Tables as pandas DataFrames."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING, Any, Dict, List

from ._errors import TauflowError

if TYPE_CHECKING:
    import pandas as pd


def _pandas() -> Any:
    try:
        import pandas
    except ImportError:
        raise TauflowError("tables need pandas: `pip install pandas`; `rows()` gives them as dictionaries") from None
    return pandas


def number(text: Any) -> Any:
    """A text as the number that it says, else itself."""
    if not isinstance(text, str):
        return text
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text


def typed(rows: List[Dict[str, Any]]) -> pd.DataFrame:
    """Rows as a DataFrame; a column whose every text is a number, or empty, has numbers."""
    pandas = _pandas()
    frame = pandas.DataFrame(rows)
    for name in frame.columns:
        values = [number(value) for value in frame[name]]
        # An empty cell among numbers is a number that is not there.
        texts = [value for value in values if isinstance(value, str)]
        if len(texts) < len(values) and not any(texts):
            frame[name] = [float("nan") if value == "" else value for value in values]
    return frame


def read_rows(path: str) -> List[Dict[str, Any]]:
    """The rows of a CSV file, numbers as numbers. Raises TauflowError if it cannot be read."""
    try:
        with open(path, newline="", encoding="utf-8") as file:
            return [{name: number(value) for name, value in row.items()} for row in csv.DictReader(file)]
    except (OSError, ValueError, csv.Error) as error:
        raise TauflowError(f"{path}: {error}") from None
