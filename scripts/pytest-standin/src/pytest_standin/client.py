"""Calls to the control interface, with nothing but the standard library."""

from __future__ import annotations

import http.client
import json
import threading
from typing import Any
from urllib.parse import quote, urlencode, urlsplit

#: How long a call may take; an advance of simulated time may take as long as it takes.
PATIENCE_S = 600.0


class StandinError(Exception):
    """A call that was not done.

    `status` is the HTTP status, `code` the interface's word for programs, `field` the field that is meant.
    """

    def __init__(self, status: int, code: str, message: str, field: str | None = None) -> None:
        super().__init__(message)
        self.status = status
        self.code = code
        self.field = field


class Client:
    """The way to a running program."""

    def __init__(self, url: str, token: str | None = None) -> None:
        self.url = url
        self._headers = {"Authorization": f"Bearer {token}"} if token else {}
        # A connection carries one call at a time, so every thread has its own: one may look on while another advances.
        self._own = threading.local()
        self._connections: list[http.client.HTTPConnection] = []

    def call(self, method: str, path: str, body: Any = None, query: dict[str, Any] | None = None) -> Any:
        """Makes a call and gives the JSON of its answer.

        StandinError where it was not done, ConnectionError where nobody answers.
        """
        wanted = {name: value for name, value in (query or {}).items() if value is not None}
        target = f"{path}?{urlencode(wanted)}" if wanted else path
        data = None if body is None else json.dumps(body).encode()
        try:
            status, text = self._patiently_sent(method, target, data)
        except (OSError, http.client.HTTPException) as error:
            self._connection().close()
            raise ConnectionError(f"standin at {self.url} does not answer: {error or type(error).__name__}") from None
        answer: Any = json.loads(text) if text else None
        if status >= 400:
            refusal = answer["error"]
            raise StandinError(status, refusal["code"], refusal["message"], refusal.get("field"))
        return answer

    def _patiently_sent(self, method: str, target: str, data: bytes | None) -> tuple[int, bytes]:
        try:
            return self._send(method, target, data)
        except (http.client.RemoteDisconnected, BrokenPipeError, ConnectionResetError):
            # The program closes a connection that was idle for a while; it has not seen this call.
            self._connection().close()
            return self._send(method, target, data)

    def _send(self, method: str, target: str, data: bytes | None) -> tuple[int, bytes]:
        connection = self._connection()
        connection.request(method, target, body=data, headers=self._headers)
        response = connection.getresponse()
        return response.status, response.read()

    def _connection(self) -> http.client.HTTPConnection:
        """The connection of this thread."""
        known: http.client.HTTPConnection | None = getattr(self._own, "connection", None)
        if known is None:
            address = urlsplit(self.url)
            known = http.client.HTTPConnection(address.hostname or "", address.port, timeout=PATIENCE_S)
            self._own.connection = known
            self._connections.append(known)
        return known

    def close(self) -> None:
        """Closes the connections."""
        for connection in self._connections:
            connection.close()


def segment(text: str) -> str:
    """A part of a path."""
    return quote(text, safe="")
