# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The dialect of a CSV file: what separates its columns, what they are called, and where its numbers begin.

Tools write a comma, semicolon or tab, a decimal comma, spaces, quotes, a row of units below the names, and
lines of their own above. csv.Sniffer judges by how often characters occur, and takes a decimal comma for a
separator; here the dialect counts in which most fields are numbers.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import accumulate, groupby
from pathlib import Path
from typing import TYPE_CHECKING

from quadpi_core.errors import LogError, one_line

if TYPE_CHECKING:
    import pyarrow as pa

_HEAD_BYTES = 1 << 18
_DIALECTS = ((",", "."), (";", "."), (";", ","), (",", ","), ("\t", "."), ("\t", ","), ("|", "."), (" ", "."))
_STAMP = r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d.*"
_ABSENT = {"", "nan", "-nan", "null", "n/a", "#n/a", "na", "none"}
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
_UTF8_MARK = b"\xef\xbb\xbf"
# What stands in a row of units where none is there twice: a unit by itself, in brackets or not.
UNIT = re.compile(
    r"[\[(]?\s*(-|1|s|sec|[mµμun]s|[cm]?m|[cm]?m/s|km/h|m s\^?-1|m/s\^?2|m/s²|m s\^?-2|m?g|rad|deg|°|"
    r"(rad|deg|°)(/s| s\^?-1)|e?rpm|m?v|m?n|m?nm|counts?|raw|flags)?\s*[\])]?",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class CsvDialect:
    """How a CSV file is to be read.

    Attributes:
        delimiter: between columns; a space stands for any number of them.
        decimal: the decimal point.
        names: (C,) of the columns; numbers from 1 where the file has none.
        units: (C,) as a row below the names gives them; empty without one.
        start: byte at which the first row of values begins.
        head: (R, C) the first rows of values, as text.
    """

    delimiter: str
    decimal: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    start: int
    head: tuple[tuple[str, ...], ...]


def read_content(path: Path) -> bytes:
    """The bytes of a CSV file, in UTF-8 whatever they were written in, without a byte order mark."""
    content = path.read_bytes()
    if content.startswith(_UTF16_MARKS):
        content = content.decode("utf-16", errors="replace").encode()
    return content.removeprefix(_UTF8_MARK)


def dialect_of(content: bytes) -> CsvDialect:
    """The dialect of a CSV file.

    Raises:
        LogError: if no two columns of numbers are found.
    """
    head = content[:_HEAD_BYTES]
    if len(content) > len(head):
        head = head[: head.rfind(b"\n") + 1]
    places, lines = _lines(head)
    best: tuple[float, str, str, list[list[str]]] = (0.0, "", "", [])
    for delimiter, decimal in _DIALECTS:
        rows = [_fields(line, delimiter) for line in lines]
        score = sum(_numbers(row, decimal) ** 2 / len(row) for row in rows if _holds_values(row, decimal))
        if score > best[0]:
            best = score, delimiter, decimal, rows
    _, delimiter, decimal, rows = best
    widths = Counter(len(row) for row in rows if _holds_values(row, decimal)).most_common(1)
    if not widths or widths[0][0] < 2:
        raise LogError(
            "no row has numbers in two columns, with commas, semicolons, tabs or spaces between them"
        )
    width = widths[0][0]
    first, last = _longest_run([len(row) == width and _holds_values(row, decimal) for row in rows])
    names, units = _heading(rows[:first], width)
    return CsvDialect(delimiter, decimal, names, units, places[first], tuple(map(tuple, rows[first:last])))


def _lines(head: bytes) -> tuple[list[int], list[str]]:
    """The lines that are not blank, and where each begins."""
    raw = head.splitlines(keepends=True)
    starts = accumulate(map(len, raw), initial=0)
    texts = (line.decode(errors="replace").strip(" \r\n") for line in raw)
    found = [(start, text) for start, text in zip(starts, texts, strict=False) if text]
    return [start for start, _ in found], [text for _, text in found]


def _longest_run(flags: Sequence[bool]) -> tuple[int, int]:
    """First and behind the last place of the most flags that are set one after the other."""
    runs = [(key, len(list(group))) for key, group in groupby(flags)]
    ends = list(accumulate(length for _, length in runs))
    length, end = max((length, end) for (is_set, length), end in zip(runs, ends, strict=True) if is_set)
    return end - length, end


def _fields(line: str, delimiter: str) -> list[str]:
    try:
        row = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        row = [line]
    return [field.strip() for field in row]


def _number(decimal: str) -> re.Pattern[str]:
    point = re.escape(decimal)
    return re.compile(rf"[+-]?(\d+({point}\d*)?|{point}\d+)([eE][+-]?\d+)?|[+-]?inf|{_STAMP}")


_NUMBERS = {decimal: _number(decimal) for decimal in ".,"}


def _numbers(row: Sequence[str], decimal: str) -> int:
    return sum(_NUMBERS[decimal].fullmatch(field) is not None for field in row)


def _holds_values(row: Sequence[str], decimal: str) -> bool:
    """Whether a row is one of values: all that is there are numbers, or half of it and at least two."""
    found, there = _numbers(row, decimal), sum(field.lower() not in _ABSENT for field in row)
    return 0 < found == there or (found >= 2 and 2 * found >= there)


def _heading(above: Sequence[Sequence[str]], width: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units of the columns: of the rows above the values, the last ones as wide as these."""
    fitting = [list(row) for row in above if len(row) in {width - 1, width}]
    units: tuple[str, ...] = ()
    if len(fitting) > 1 and (
        all(UNIT.fullmatch(field) for field in fitting[-1])
        or (_repeats(fitting[-1]) and not _repeats(fitting[-2]))
    ):
        units = tuple(fitting.pop())
    if not fitting:
        return tuple(str(place + 1) for place in range(width)), units
    names = [*fitting[-1], ""][:width]
    # A heading that is a comment.
    names[0] = names[0].lstrip("#% ")
    return tuple(names), units


def _repeats(row: Sequence[str]) -> bool:
    """Whether a row has an entry twice, as units are and names are not."""
    return max(Counter(field for field in row if field).values(), default=0) > 1


def read_columns(content: bytes, dialect: CsvDialect, wanted: Collection[int], stamps: int) -> pa.Table:
    """Columns by their places, as numbers; `stamps` is the place of one that may hold date and time.

    A last row that is cut off is left out.

    Raises:
        LogError: naming the column, for a value that is no number, and for rows of another length.
    """
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    body = content[dialect.start :]
    last = body[body.rfind(b"\n") + 1 :].decode(errors="replace").strip()
    if last and len(_fields(last, dialect.delimiter)) != len(dialect.names):
        body = body[: body.rfind(b"\n") + 1]
    if dialect.delimiter == " ":
        body = re.sub(rb"(?m)^ +| +(?=\r?$)", b"", re.sub(rb" +", b" ", body))
    places = [str(place) for place in sorted(wanted)]
    try:
        return arrow_csv.read_csv(
            pa.BufferReader(body),
            read_options=arrow_csv.ReadOptions(column_names=[str(k) for k in range(len(dialect.names))]),
            parse_options=arrow_csv.ParseOptions(delimiter=dialect.delimiter),
            convert_options=arrow_csv.ConvertOptions(
                include_columns=places,
                column_types={place: pa.float64() for place in places if int(place) != stamps},
                decimal_point=dialect.decimal,
            ),
        )
    except (pa.ArrowException, UnicodeDecodeError) as error:
        text = one_line(error)
        if found := re.search(r"column #(\d+):.*invalid value '(.*)'", text):
            name = dialect.names[int(found[1])]
            raise LogError(f"column {name}: {found[2]!r} is no number") from error
        raise LogError(f"not a readable csv table: {text}") from error
