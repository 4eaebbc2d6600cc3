"""`Table`: rows of named values, as printed, as JSON and, where pandas is installed, as a frame."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, overload

# Where the output is no terminal: every column of a trade has room.
WIDTH = 160
# A text cell is never cut shorter than this to make a row fit.
NARROW = 12


class Table:
    """Records in a fixed order; a value that a record does not have is None.

    records: one mapping a row. columns: their order; by default that of first appearance.
    formats: how columns of numbers are printed (default ".4g").

    >>> print(Table([{"dt": 0.01, "error": 1.5e-3}, {"dt": 0.005, "error": 3.75e-4}]))
       dt     error
     0.01    0.0015
    0.005  0.000375
    """

    def __init__(
        self,
        records: Iterable[Mapping[str, Any]],
        columns: Sequence[str] | None = None,
        formats: Mapping[str, str] | None = None,
    ) -> None:
        rows = [dict(record) for record in records]
        if columns is None:
            columns = list(dict.fromkeys(name for row in rows for name in row))
        self.columns = list(columns)
        self.formats = dict(formats or {})
        self.records = [{name: row.get(name) for name in self.columns} for row in rows]

    def __len__(self) -> int:
        return len(self.records)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return iter(self.records)

    @overload
    def __getitem__(self, key: int) -> dict[str, Any]: ...
    @overload
    def __getitem__(self, key: str) -> list[Any]: ...
    def __getitem__(self, key: int | str) -> Any:
        """A record by its number, or a column by its name."""
        if isinstance(key, int):
            return self.records[key]
        if key not in self.columns:
            raise KeyError(f"no column '{key}'; the table has: {', '.join(self.columns)}")
        return [record[key] for record in self.records]

    def to_dict(self) -> dict[str, list[Any]]:
        """Column name to its values."""
        return {name: self[name] for name in self.columns}

    def to_json(self, indent: int | None = None) -> str:
        """The records as a JSON list; a number that is not finite becomes null."""
        return json.dumps(jsonable(self.records), indent=indent)

    def to_pandas(self) -> Any:
        """The table as a pandas DataFrame (pandas is not a dependency of stepcore)."""
        try:
            import pandas  # type: ignore[import-untyped,unused-ignore]
        except ImportError:
            raise ImportError("Table.to_pandas needs pandas: pip install pandas") from None
        return pandas.DataFrame(self.records, columns=self.columns)

    def text(self, width: int | None = None) -> str:
        """The table in aligned columns of at most `width` characters (default: the terminal's).

        Text cells are cut first; then whole columns from the right, which are named below.
        """
        width = width or _window()
        spec = {name: self.formats.get(name, ".4g") for name in self.columns}
        grid = {name: [_cell(value, spec[name]) for value in self[name]] for name in self.columns}
        words = {name for name in self.columns if any(isinstance(v, str) for v in self[name])}
        left = words - set(self.formats)
        sizes = {name: max(map(len, [name, *grid[name]])) for name in self.columns}
        while _total(sizes) > width:
            longest = max((name for name in sizes if name in left), key=sizes.get, default=None)  # type: ignore[arg-type]
            if longest is None or sizes[longest] <= max(NARROW, len(longest)):
                break
            over = _total(sizes) - width
            sizes[longest] = max(NARROW, len(longest), sizes[longest] - over)
        shown = list(self.columns)
        while len(shown) > 1 and _total({name: sizes[name] for name in shown}) > width:
            shown.pop()
        lines = [_line(shown, sizes, left, {name: name for name in shown})]
        rows = ({name: grid[name][i] for name in shown} for i in range(len(self)))
        lines += [_line(shown, sizes, left, row) for row in rows]
        hidden = self.columns[len(shown) :]
        if hidden:
            lines.append(f"(not wide enough for: {', '.join(hidden)})")
        return "\n".join(lines)

    def __str__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        """The table as a notebook shows it."""
        return pre(self.text(width=1000))

    def __repr__(self) -> str:
        return f"<Table: {len(self)} rows of {', '.join(self.columns)}>"


def pre(text: str) -> str:
    """Text in its columns as HTML, which a narrow window scrolls and does not wrap."""
    import html  # only notebooks need it

    return f'<pre style="white-space: pre; overflow-x: auto">{html.escape(text)}</pre>'


def jsonable(value: Any) -> Any:
    """Plain data that every JSON reader takes: numpy numbers unwrapped, NaN and infinity null."""
    if isinstance(value, Mapping):
        return {str(key): jsonable(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [jsonable(entry) for entry in value]
    if hasattr(value, "tolist"):
        return jsonable(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (bool, int, str)):
        return value
    return str(value)


def _window() -> int:
    """Characters in a line of the terminal."""
    import shutil

    return shutil.get_terminal_size((WIDTH, 40)).columns


def _cell(value: Any, spec: str) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else ""
    if hasattr(value, "item") and getattr(value, "ndim", 0) == 0:
        value = value.item()
    return f"{value:{spec}}" if isinstance(value, float) else " ".join(str(value).split())


def _total(sizes: Mapping[str, int]) -> int:
    return sum(sizes.values()) + 2 * (len(sizes) - 1)


def _line(
    shown: Sequence[str], sizes: Mapping[str, int], left: set[str], cells: Mapping[str, str]
) -> str:
    parts = []
    for name in shown:
        cell, size = cells[name], sizes[name]
        cell = cell if len(cell) <= size else cell[: size - 1] + "…"
        parts.append(cell.ljust(size) if name in left else cell.rjust(size))
    return "  ".join(parts).rstrip()
