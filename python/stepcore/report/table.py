"""`Table`: rows of named values, as printed, as JSON and, where pandas is installed, as a frame."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from html import escape
from typing import Any, overload

from stepcore import escapes
from stepcore._core import Settings

# Where the output is no terminal: every column of a trade has room.
WIDTH = 160
# A text cell is never cut shorter than this to make a row fit.
NARROW = 12


class Table:
    """Records in a fixed order; a value that a record does not have is None.

    records: one mapping a row.
    columns: their order; by default that of first appearance.
    formats: how columns of numbers are printed (default ".4g"); a column of texts that is named
        here is aligned at the right and never cut.
    heading, legend: what a report says above and below the table.

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
        *,
        heading: str = "",
        legend: str = "",
    ) -> None:
        rows = [dict(record) for record in records]
        if columns is None:
            columns = list(dict.fromkeys(name for row in rows for name in row))
        self.columns = list(columns)
        self.formats = dict(formats or {})
        self.heading, self.legend = heading, legend
        self.records = [{name: row.get(name) for name in self.columns} for row in rows]

    def __len__(self) -> int:
        return len(self.records)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return iter(self.records)

    @overload
    def __getitem__(self, key: int) -> dict[str, Any]: ...
    @overload
    def __getitem__(self, key: slice) -> Table: ...
    @overload
    def __getitem__(self, key: str) -> list[Any]: ...
    def __getitem__(self, key: int | slice | str) -> Any:
        """A record by its number, some records as a table, or a column by its name."""
        if isinstance(key, int):
            return self.records[key]
        if isinstance(key, slice):
            said = {"heading": self.heading, "legend": self.legend}
            return Table(self.records[key], self.columns, self.formats, **said)
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
            raise ImportError(
                "Table.to_pandas needs pandas: pip install 'stepcore[data]'"
            ) from None
        return pandas.DataFrame(self.records, columns=self.columns)

    def text(self, width: int | None = None) -> str:
        """The table in aligned columns of at most `width` characters (default: the terminal's).

        Text cells are cut first; then whole columns from the right, which are named below.
        """
        width = width or window()
        grid, left = self._cells()
        sizes = {name: max(map(len, [name, *cells])) for name, cells in grid.items()}
        while _total(sizes) > width:
            longest = max((name for name in sizes if name in left), key=sizes.get, default=None)  # type: ignore[arg-type]
            if longest is None or sizes[longest] <= max(NARROW, len(longest)):
                break
            over = _total(sizes) - width
            sizes[longest] = max(NARROW, len(longest), sizes[longest] - over)
        shown = list(self.columns)
        while len(shown) > 1 and _total({name: sizes[name] for name in shown}) > width:
            shown.pop()
        lines = [_line(shown, sizes, left, {name: _line_of(name) for name in shown})]
        rows = ({name: grid[name][i] for name in shown} for i in range(len(self)))
        lines += [_line(shown, sizes, left, row) for row in rows]
        hidden = self.columns[len(shown) :]
        if hidden:
            lines.append(f"(no room for: {', '.join(hidden)})")
        return "\n".join(lines)

    def html(self) -> str:
        """The table as HTML: every column, whole texts."""
        grid, left = self._cells()
        style = {
            name: ' class="text" style="text-align: left"' if name in left else "" for name in grid
        }
        lines = [TABLE.format(caption=escape(escapes.printable(self.heading)))]
        lines += [f"<th{style[name]}>{escape(_line_of(name))}</th>" for name in grid]
        lines.append("</tr></thead><tbody>")
        for i in range(len(self)):
            cells = (f"<td{style[name]}>{escape(grid[name][i])}</td>" for name in grid)
            lines.append(f"<tr>{''.join(cells)}</tr>")
        return "\n".join([*lines, "</tbody></table></div>"])

    def _cells(self) -> tuple[dict[str, list[str]], set[str]]:
        """Columns as they are printed, and which of them are texts, aligned at the left."""
        spec = {name: self.formats.get(name, ".4g") for name in self.columns}
        grid = {name: [_cell(value, spec[name]) for value in self[name]] for name in self.columns}
        words = {name for name in self.columns if any(isinstance(v, str) for v in self[name])}
        return grid, words - set(self.formats)

    def __str__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        """The table as a notebook shows it."""
        return self.html()

    def __repr__(self) -> str:
        return f"<Table: {len(self)} rows of {', '.join(self.columns)}>"


# Numbers stand at the right, in digits of one width; a narrow window scrolls.
TABLE = """<div class="table" style="overflow-x: auto"><table style="text-align: right;\
 font-variant-numeric: tabular-nums">
<caption style="text-align: left"><span>{caption}</span></caption><thead><tr>"""


def jsonable(value: Any) -> Any:
    """Plain data that every JSON reader takes.

    Arrays become lists, Settings and dataclasses mappings (of the fields that repr shows),
    functions their names; NaN and infinity are None.
    """
    if isinstance(value, Mapping):
        return {str(key): jsonable(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [jsonable(entry) for entry in value]
    if isinstance(value, Settings):
        return value.as_dict()
    if is_dataclass(value) and not isinstance(value, type):
        shown = [field.name for field in fields(value) if field.repr]
        return {name: jsonable(getattr(value, name)) for name in shown}
    if hasattr(value, "tolist"):
        return jsonable(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (bool, int, str)):
        return value
    return getattr(value, "__qualname__", None) or str(value)


def window() -> int:
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
    return f"{value:{spec}}" if isinstance(value, float) else _line_of(value)


def _line_of(text: object) -> str:
    return escapes.printable(" ".join(str(text).split()))


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
