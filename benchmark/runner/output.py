"""What a worker prints: its beginning and its end, however much it is."""

from __future__ import annotations

import os
import threading
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

#: Bytes kept of the beginning and of the end.
FIRST, LAST = 1 << 14, 1 << 16


class Output:
    """Reads what a worker prints, so that it neither blocks nor fills a disk.

    Parameters
    ----------
    context
        Makes the pipe.
    path
        Where a file takes its place, on systems without pipes that can be standard output.
    """

    def __init__(self, context: Any, path: Path) -> None:
        self._first, self._last, self.size = b"", bytearray(), 0
        self._path, self._ours = path, None
        #: What the worker is handed.
        self.sink: Connection | Path = path
        self._thread: threading.Thread | None = None
        if os.name == "posix":
            self._ours, self.sink = context.Pipe(duplex=False)

    def start(self) -> None:
        """Begin to read; the worker has its end by now."""
        if self._ours is None or not isinstance(self.sink, Connection):
            return
        self.sink.close()
        self._thread = threading.Thread(target=self._read, args=(self._ours.fileno(),), name="output", daemon=True)
        self._thread.start()

    def _read(self, descriptor: int) -> None:
        while True:
            try:
                data = os.read(descriptor, 1 << 16)
            except OSError:
                return
            if not data:
                return
            self.size += len(data)
            room = FIRST - len(self._first)
            self._first += data[: max(room, 0)]
            self._last += data[max(room, 0) :]
            if len(self._last) > 2 * LAST:
                del self._last[:-LAST]

    def close(self) -> str:
        """Everything that was kept; once the worker has ended."""
        if self._thread is not None:
            # A process that the worker left behind may keep the pipe open: what it prints is not waited for.
            self._thread.join(timeout=1.0)
            if not self._thread.is_alive() and self._ours is not None:
                self._ours.close()
            last = bytes(self._last[-LAST:])
            cut = self.size - len(self._first) - len(last)
            middle = f"\n… {cut} bytes left out …\n".encode() if cut else b""
            return (self._first + middle + last).decode("utf-8", "replace")
        text = self._path.read_text(encoding="utf-8", errors="replace") if self._path.exists() else ""
        self._path.unlink(missing_ok=True)
        return text
