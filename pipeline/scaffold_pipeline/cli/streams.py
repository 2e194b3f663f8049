"""Standard streams that a caller has closed, or no longer reads: what is printed there is lost, the command goes on."""

from __future__ import annotations

import io
import os
import sys

_STREAMS = ((1, "stdout"), (2, "stderr"))


class _LastingStream(io.TextIOWrapper):
    """A text stream on a pipe that may break: from then on it writes to nowhere."""

    def write(self, text: str) -> int:
        try:
            return super().write(text)
        except BrokenPipeError:
            self._discard()
            return len(text)

    def flush(self) -> None:
        try:
            super().flush()
        except BrokenPipeError:
            self._discard()

    def _discard(self) -> None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())


def keep_streams_open() -> None:
    """Let standard output and error outlast their reader, and open those that are closed (`>&-`) to nowhere.

    A number of a closed stream would otherwise be given to the next file, which then takes what libraries print.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the least free number, which is this one
    for number, name in _STREAMS:
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(number, "w", encoding="utf-8", closefd=False))  # noqa: SIM115 - for good
        elif isinstance(stream, io.TextIOWrapper):
            encoding, errors, by_line = stream.encoding, stream.errors, stream.line_buffering
            setattr(sys, name, _LastingStream(stream.detach(), encoding, errors, line_buffering=by_line))
