"""Answers a query on a mission's rows as JSON or CSV, in constant memory."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, closing
from typing import IO, Any, Literal

from webapp.missions.files.csv_writer import csv_lines
from webapp.missions.store.query import ParsedQuery, Question, answer, parse_question
from webapp.store.library import Library
from webapp.tasks.exchange.export_source import Download

Form = Literal["json", "csv"]

_IN_MEMORY = 1 << 20
_PIECE = 1 << 16
_TYPES = {"json": "application/json", "csv": "text/csv; charset=utf-8"}


def query_mission(library: Library, mission_id: int, *, question: Question, form: Form) -> Download:
    """Answer a query.

    The whole answer is written to a temporary file before its first byte is sent: an error or a limit never
    results in a truncated answer, and a slow client does not block the database.

    Args:
        form: `json`: `columns`, `rows` (a list each) and `complete`, false if the limit cut off rows. `csv`:
            a header line, then the rows. Times are seconds since 1970, UTC.

    Raises:
        UsageError: The query is invalid, or takes too long.
    """
    asked = parse_question(mission_id, question)
    with ExitStack() as stack:
        file = stack.enter_context(tempfile.SpooledTemporaryFile(max_size=_IN_MEMORY))
        with library.database.read() as session, closing(answer(session, asked)) as rows:
            if form == "json":
                _write_json(file, asked, rows, limit=question.limit)
            else:
                _write_csv(file, asked, rows, limit=question.limit)
        file.seek(0)
        stack.pop_all()
    return Download(f"{question.table}.{form}", _TYPES[form], _Pieces(file))


class _Pieces(Iterator[bytes]):
    """The content of a file, which is closed at its end or by `close`."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def __next__(self) -> bytes:
        piece = b"" if self._file.closed else self._file.read(_PIECE)
        if not piece:
            self.close()
            raise StopIteration
        return piece

    def close(self) -> None:
        self._file.close()


def _write_json(file: IO[bytes], asked: ParsedQuery, rows: Iterator[tuple[Any, ...]], *, limit: int) -> None:
    file.write(f'{{"columns": {json.dumps(asked.columns)}, "rows": ['.encode())
    complete = True
    for number, row in enumerate(rows):
        if number == limit:
            complete = False
            break
        comma = "," if number else ""
        file.write(f"{comma}\n{json.dumps(row, ensure_ascii=False)}".encode("utf-8", "replace"))
    file.write(f'\n], "complete": {json.dumps(complete)}}}\n'.encode())


def _write_csv(file: IO[bytes], asked: ParsedQuery, rows: Iterator[tuple[Any, ...]], *, limit: int) -> None:
    file.write(csv_lines([asked.columns]))
    for number, row in enumerate(rows):
        if number < limit:
            file.write(csv_lines([row]))
