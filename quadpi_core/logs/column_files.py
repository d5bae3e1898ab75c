# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Columns of CSV files and of MATLAB's."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, compress, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import LogError, one_line
from quadpi_core.logs.sandbox import read_apart

if TYPE_CHECKING:
    import pyarrow as pa

# Tools write a comma, semicolon or tab, a decimal comma, spaces, quotes, a row of units below the names, and
# lines of their own above. csv.Sniffer judges by how often characters occur, and takes a decimal comma for a
# separator; here the dialect counts in which most fields are numbers.

_HEAD_BYTES = 1 << 18
_DIALECTS = ((",", "."), (";", "."), (";", ","), (",", ","), ("\t", "."), ("\t", ","), ("|", "."), (" ", "."))
_STAMP = r"(\d{4}([-/]?)\d\d\2\d\d[T ])?\d\d:?\d\d:?\d\d[.,].*"
ABSENT = {"", "nan", "-nan", "null", "n/a", "#n/a", "na", "none", "-", "--"}
# As text in a column of numbers; arrow tells capitals apart.
_NULLS = [spelled for word in sorted(ABSENT) for spelled in dict.fromkeys((word, word.upper(), word.title()))]
_NULLS += ["NaN", "-NaN"]
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
    else:
        try:
            content.decode()
        except UnicodeDecodeError:
            content = content.decode("cp1252", errors="replace").encode()
    if b"\n" not in content:
        content = content.replace(b"\r", b"\n")
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
    of_values = [len(row) == width and _holds_values(row, decimal) for row in rows]
    first = _first_run(of_values)
    names, units = _heading(lines[:first], delimiter, width)
    return CsvDialect(
        delimiter,
        decimal,
        names,
        units,
        places[first],
        tuple(tuple(row) for row in compress(rows[first:], of_values[first:])),
    )


def _lines(head: bytes) -> tuple[list[int], list[str]]:
    """The lines that are not blank, and where each begins."""
    raw = head.splitlines(keepends=True)
    starts = accumulate(map(len, raw), initial=0)
    texts = (line.decode(errors="replace").strip(" \r\n") for line in raw)
    found = [(start, text) for start, text in zip(starts, texts, strict=False) if text]
    return [start for start, _ in found], [text for _, text in found]


def _first_run(flags: Sequence[bool]) -> int:
    """Place of the first two flags in a row that are set, else of the first one."""
    return next((place for place, pair in enumerate(pairwise(flags)) if all(pair)), flags.index(True))


def _fields(line: str, delimiter: str) -> list[str]:
    try:
        row = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        row = [line]
    return [field.strip() for field in row]


def _number(decimal: str) -> str:
    point = re.escape(decimal)
    return rf"([+-]?(\d+({point}\d*)?|{point}\d+)([eE][+-]?\d+)?|[+-]?inf)"


_PLAIN_NUMBERS = {decimal: _number(decimal) for decimal in ".,"}
_NUMBERS = {decimal: re.compile(f"{_STAMP}|{number}") for decimal, number in _PLAIN_NUMBERS.items()}


def _numbers(row: Sequence[str], decimal: str) -> int:
    return sum(_NUMBERS[decimal].fullmatch(field) is not None for field in row)


def _holds_values(row: Sequence[str], decimal: str) -> bool:
    """Whether a row is one of values: all that is there are numbers, or half of it and at least two."""
    found, there = _numbers(row, decimal), sum(field.lower() not in ABSENT for field in row)
    return 0 < found == there or (found >= 2 and 2 * found >= there)


def _heading(above: Sequence[str], delimiter: str, width: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units of the columns: of the lines above the values, the last ones as wide as these.

    They may be comments, and numpy's `savetxt` separates the names by commas where the values have spaces.
    """
    plain = [line.lstrip("#% ") for line in above]
    fitting = _as_wide(plain, delimiter, width)
    for other in (",", ";", "\t", " "):
        fitting = fitting or _as_wide(plain[-1:], other, width)
    units: tuple[str, ...] = ()
    if len(fitting) > 1 and (
        all(UNIT.fullmatch(field) for field in fitting[-1])
        or (_repeats(fitting[-1]) and not _repeats(fitting[-2]))
    ):
        units = tuple(fitting.pop())
    if not fitting:
        return tuple(str(place + 1) for place in range(width)), units
    return tuple([*fitting[-1], ""][:width]), units


def _as_wide(lines: Sequence[str], delimiter: str, width: int) -> list[list[str]]:
    rows = [_fields(line, delimiter) for line in lines]
    return [row for row in rows if len(row) in {width - 1, width}]


def _repeats(row: Sequence[str]) -> bool:
    """Whether a row has an entry twice, as units are and names are not."""
    return max(Counter(field for field in row if field).values(), default=0) > 1


def read_columns(
    content: bytes, dialect: CsvDialect, wanted: Collection[int], stamps: int
) -> tuple[pa.Table, list[str]]:
    """Columns by their places, as numbers, and what was left out of them, in sentences.

    Rows of another length (comments, a last row that is cut off) are left out, and what is no number, such
    as names that stand there again, is no value.

    Raises:
        LogError: naming the column, where most values are no numbers, or most rows are of another length.
    """
    import pyarrow as pa

    body = content[dialect.start :]
    if dialect.delimiter == " ":
        body = re.sub(rb"(?m)^ +| +(?=\r?$)", b"", re.sub(rb" +", b" ", body))
    places = [str(place) for place in sorted(wanted)]
    numbers = {place: pa.float64() for place in places if int(place) != stamps}
    try:
        table, skipped = _read(body, dialect, places, numbers)
        said = []
    except pa.ArrowInvalid as error:
        if "onversion error" not in str(error):
            raise LogError(f"not a readable csv table: {one_line(error)}") from error
        table, skipped = _read(body, dialect, places, dict.fromkeys(places, pa.string()))
        columns = [
            _numbers_of(table[place], dialect, int(place), may_be_text=int(place) == stamps)
            for place in places
        ]
        table = pa.table(dict(zip(places, (column for column, _ in columns), strict=True)))
        wrong = [sentence for _, sentence in columns if sentence]
        more = f" (so in {len(wrong)} columns)" if len(wrong) > 1 else ""
        said = [f"{sentence}{more}" for sentence in wrong[:1]]
    except (pa.ArrowException, UnicodeDecodeError) as error:
        raise LogError(f"not a readable csv table: {one_line(error)}") from error
    if len(skipped) > table.num_rows:
        raise LogError(
            f"{len(skipped)} rows have another number of columns than {len(dialect.names)}; the first is "
            f"{skipped[0]!r}"
        )
    if skipped:
        said.append(
            f"left out {len(skipped)} of {table.num_rows + len(skipped)} rows, which have another number of "
            f"columns; the first is {skipped[0]!r}"
        )
    return table, said


def _read(
    body: bytes, dialect: CsvDialect, places: Sequence[str], types: Mapping[str, pa.DataType]
) -> tuple[pa.Table, list[str]]:
    """The columns of these types, and the rows of another length, shortened."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    skipped: list[str] = []

    def skip(row: arrow_csv.InvalidRow) -> str:
        skipped.append(row.text[:40])
        return "skip"

    table = arrow_csv.read_csv(
        pa.BufferReader(body),
        read_options=arrow_csv.ReadOptions(column_names=[str(k) for k in range(len(dialect.names))]),
        parse_options=arrow_csv.ParseOptions(delimiter=dialect.delimiter, invalid_row_handler=skip),
        convert_options=arrow_csv.ConvertOptions(
            include_columns=places,
            column_types=types,
            decimal_point=dialect.decimal,
            null_values=_NULLS,
            strings_can_be_null=True,
        ),
    )
    return table, skipped


def _numbers_of(
    column: pa.ChunkedArray, dialect: CsvDialect, place: int, *, may_be_text: bool
) -> tuple[pa.ChunkedArray, str]:
    """A column of text as numbers, null where it holds none, and what is to be said of it.

    Numbers may have the other decimal point between thousands. What may be text stays so where few are.
    """
    import pyarrow as pa
    from pyarrow import compute

    point, other = re.escape(dialect.decimal), ",."[dialect.decimal == ","]
    text = compute.utf8_trim_whitespace(column)
    grouped = compute.match_substring_regex(
        text, rf"^[+-]?[1-9]\d{{0,2}}({re.escape(other)}\d{{3}})+({point}\d*)?$"
    )
    text = compute.if_else(grouped, compute.replace_substring(text, other, ""), text)
    is_number = compute.match_substring_regex(text, rf"^{_PLAIN_NUMBERS[dialect.decimal]}$")
    absent = compute.is_in(compute.utf8_lower(text), value_set=pa.array(sorted(ABSENT)))
    wrong = text.filter(compute.fill_null(compute.invert(compute.or_(is_number, absent)), fill_value=False))
    known = compute.sum(is_number).as_py() or 0
    if len(wrong) > known:
        if may_be_text:
            return column, ""
        raise LogError(f"column {dialect.names[place]}: {wrong[0].as_py()!r} is no number")
    text = compute.replace_substring(text, dialect.decimal, ".")
    text = compute.if_else(is_number, text, pa.scalar(None, pa.string()))
    whole = not compute.any(compute.match_substring_regex(text, "[.eEfn]")).as_py()
    values = compute.cast(text, pa.int64() if whole and may_be_text else pa.float64())
    if len(wrong) == 0:
        return values, ""
    said = f"column {dialect.names[place]}: {wrong[0].as_py()!r} is no number"
    return values, f"{said}, as {len(wrong)} of {len(column)} values: no value there"


_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
# By the kinds of numpy's types.
_KINDS = {"O": "cell array", "V": "struct", "U": "text", "c": "complex matrix"}


class Variable(NamedTuple):
    """A variable: its name, what MATLAB calls its kind, and its numbers where it is a real matrix.

    Fields of a struct are variables `STRUCT.FIELD`.
    """

    name: str
    kind: str
    values: npt.NDArray[Any] | None


def read_matlab(path: Path) -> list[Variable]:
    """The variables of a file.

    Raises:
        LogError: if it is of another version, cut off or damaged, or unpacks to too much.
    """
    # Here, so that the other process need not.
    import scipy.io  # noqa: F401

    with path.open("rb") as stream:
        head = stream.read(10)
    if head.startswith(_HDF5_MAGIC) or head == b"MATLAB 7.3":
        raise LogError("a MATLAB 7.3 file (HDF5): save it with `-v7`")
    return list(read_apart(path.stat().st_size, _variables, path))


def _variables(path: Path) -> Iterator[Variable]:
    from scipy.io import loadmat

    for name, value in loadmat(path).items():
        if not name.startswith("__"):
            yield from _flat(name, value)


def _flat(name: str, value: Any) -> Iterator[Variable]:
    """A variable, or those of its fields where it is a struct."""
    if not isinstance(value, np.ndarray):
        yield Variable(name, "sparse matrix", None)
    elif value.dtype.names and value.shape == (1, 1) and type(value) is np.ndarray:
        for field in value.dtype.names:
            yield from _flat(f"{name}.{field}", value[0, 0][field])
    elif type(value) is not np.ndarray:
        yield Variable(name, "object", None)
    elif value.dtype.kind in _KINDS:
        yield Variable(name, _KINDS[value.dtype.kind], None)
    elif value.ndim != 2:
        yield Variable(name, f"array of {value.ndim} dimensions", None)
    else:
        yield Variable(name, "matrix", value.astype("u1") if value.dtype.kind == "b" else value)
