"""`Table`: rows of named values, as text, JSON and, with pandas, a data frame."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from html import escape
from typing import Any, overload

from stepcore import escapes
from stepcore._core import Settings
from stepcore.needs import need
from stepcore.report.terminal import window

# The minimum width to which a text cell is cut.
NARROW = 12


class Table:
    """A table of records in a fixed order; a value missing from a record is None.

    records: one mapping per row.
    columns: the order of the columns; by default the order of first appearance.
    formats: the formats of number columns (default ".4g"); a text column named here is
        right-aligned and never cut.
    heading, legend: the text above and below the table in a report.

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
        """Return a record by its number, a slice as a table, or a column by its name."""
        if isinstance(key, int):
            return self.records[key]
        if isinstance(key, slice):
            captions = {"heading": self.heading, "legend": self.legend}
            return Table(self.records[key], self.columns, self.formats, **captions)
        if key not in self.columns:
            raise KeyError(f"no column '{key}'; the table has: {', '.join(self.columns)}")
        return [record[key] for record in self.records]

    def to_dict(self) -> dict[str, list[Any]]:
        """Return the columns by name, each as a list."""
        return {name: self[name] for name in self.columns}

    def to_json(self, indent: int | None = None) -> str:
        """Return the records as a JSON list; non-finite numbers become null."""
        return json.dumps(jsonable(self.records), indent=indent)

    def to_pandas(self) -> Any:
        """Return the table as a pandas DataFrame. Needs pandas (the extra "data")."""
        pandas = need("pandas", "Table.to_pandas", "data")
        return pandas.DataFrame(self.records, columns=self.columns)

    def text(self, width: int | None = None) -> str:
        """Return the table in aligned columns.

        width: the maximum number of characters in a line (default: the terminal's).

        Text cells are cut first. Then columns are dropped from the right; a last line names the
        dropped columns.
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
        """Return the table as HTML, with every column and uncut texts."""
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
        """Return the printed columns, and the names of the left-aligned text columns."""
        spec = {name: self.formats.get(name, ".4g") for name in self.columns}
        grid = {name: [_cell(value, spec[name]) for value in self[name]] for name in self.columns}
        words = {name for name in self.columns if any(isinstance(v, str) for v in self[name])}
        return grid, words - set(self.formats)

    def __str__(self) -> str:
        return self.text()

    def _repr_html_(self) -> str:
        return self.html()

    def __repr__(self) -> str:
        return f"<Table: {len(self)} rows of {', '.join(self.columns)}>"


# Numbers are right-aligned with digits of equal width; a narrow window scrolls.
TABLE = """<div class="table" style="overflow-x: auto"><table style="text-align: right;\
 font-variant-numeric: tabular-nums">
<caption style="text-align: left"><span>{caption}</span></caption><thead><tr>"""


def jsonable(value: Any) -> Any:
    """Convert a value to plain data that every JSON reader accepts.

    Arrays become lists, Settings and dataclasses become mappings (of the fields that repr shows),
    and functions become their names. NaN and infinity become None.
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


def _cell(value: Any, spec: str) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else ""
    if hasattr(value, "item") and getattr(value, "ndim", 0) == 0:
        value = value.item()
    if isinstance(value, float):
        # A value that is not a number is unknown.
        return "" if value != value else f"{value:{spec}}"
    return _line_of(value)


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
