"""Calls to the control interface, with nothing but the standard library."""

from __future__ import annotations

import http.client
import json
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
        address = urlsplit(url)
        self._connection = http.client.HTTPConnection(address.hostname or "", address.port, timeout=PATIENCE_S)

    def call(self, method: str, path: str, body: Any = None, query: dict[str, Any] | None = None) -> Any:
        """Makes a call and gives the JSON of its answer; StandinError where it was not done."""
        wanted = {name: value for name, value in (query or {}).items() if value is not None}
        target = f"{path}?{urlencode(wanted)}" if wanted else path
        data = None if body is None else json.dumps(body).encode()
        try:
            status, text = self._send(method, target, data)
        except (http.client.RemoteDisconnected, BrokenPipeError, ConnectionResetError):
            # The program closes a connection that was idle for a while; it has not seen this call.
            self._connection.close()
            status, text = self._send(method, target, data)
        answer: Any = json.loads(text) if text else None
        if status >= 400:
            error = answer["error"]
            raise StandinError(status, error["code"], error["message"], error.get("field"))
        return answer

    def _send(self, method: str, target: str, data: bytes | None) -> tuple[int, bytes]:
        self._connection.request(method, target, body=data, headers=self._headers)
        response = self._connection.getresponse()
        return response.status, response.read()

    def close(self) -> None:
        """Closes the connection."""
        self._connection.close()


def segment(text: str) -> str:
    """A part of a path."""
    return quote(text, safe="")
