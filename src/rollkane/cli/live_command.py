"""The command that serves a page in which a scene's numbers are dragged.

Everything heavy is imported inside the functions, as in the other commands. The server
is for this machine alone: it listens on the loopback address, and answers only to who
knows the page's address, which nobody can guess.
"""

import json
import re
import secrets
import threading
import webbrowser
from collections.abc import Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, cast

import click

from .live_question import MalformedQuestion, question_of
from .option_values import refuse
from .preparation import loaded, scene_argument, start_jax

_HOST = "127.0.0.1"
_LONGEST = 100_000  # of a question [bytes]
_BYTES = re.compile(r"[0-9]{1,15}")  # more digits than any question's length has
_MOST_READ = 100 * _LONGEST  # of what is too long, so that its sender hears why [bytes]


@click.command()
@scene_argument
@click.option(
    "--vary",
    "ranges",
    multiple=True,
    metavar="PATH=LOW:HIGH",
    help="A number to drag; left out, all of SCENE.",
)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, help="0: one that is free."
)
@click.option("--no-browser", is_flag=True, help="Print the address, open nothing.")
@click.pass_context
def live(
    ctx: click.Context, scene: str, ranges: tuple[str, ...], port: int, no_browser: bool
) -> None:
    """Serve a page in which the numbers of SCENE are dragged and it is run anew.

    For this machine alone; Ctrl-C ends it (exit code 0).
    """
    asked = _asked(ranges)
    start_jax()
    loaded(ctx, scene)  # tells all that is wrong with it

    from ..pictures.live_run import LiveRun
    from ..validation.checks import FieldError

    try:
        run = LiveRun(scene, asked)
        server = LiveServer(run, port)
    except FieldError as refused:
        raise click.UsageError(str(refused)) from refused
    except OSError as error:
        raise click.ClickException(f"cannot listen on port {port}: {error}") from error
    click.echo(f"{run.file.title}: {server.address} (Ctrl-C ends it)")
    if not no_browser:
        webbrowser.open(server.address)
    try:
        server.serve_forever()
    except KeyboardInterrupt:
        click.echo("ended", err=True)
    finally:
        server.server_close()


def _asked(given: Sequence[str]) -> dict[str, tuple[float, float]]:
    found: dict[str, tuple[float, float]] = {}
    for one in given:
        path, _, text = one.partition("=")
        ends = text.split(":")
        if not path.strip() or len(ends) != 2:
            refuse("--vary", f"{one!r} is not PATH=LOW:HIGH, such as body.mass=1:2")
        if path.strip() in found:
            refuse("--vary", f"names {path.strip()} twice")
        try:
            found[path.strip()] = float(ends[0]), float(ends[1])
        except ValueError:
            refuse("--vary", f"{one!r}: the ends are not numbers")
    return found


class LiveServer(ThreadingHTTPServer):
    """The page of a run, and runs for other numbers, under an address of its own.

    Attributes:
        address: Of the page.
    """

    daemon_threads = True

    def __init__(self, run: Any, port: int = 0):
        """Listen on this machine alone.

        Args:
            run: A :class:`rollkane.pictures.live_run.LiveRun`.
            port: 0: one that is free.

        Raises:
            OSError: the port is taken.
        """
        super().__init__((_HOST, port), _Handler)
        self.key = secrets.token_urlsafe(16)
        self.host = f"{_HOST}:{self.server_address[1]}"
        self.address = f"http://{self.host}/{self.key}/"
        self._run = run
        self._lock = threading.Lock()

    def page(self) -> bytes:
        """The page, with the scene as its file has it."""
        from ..pictures.viewer import page_of

        with self._lock:
            data = self._run.data({})
        data["numbers"] = [one._asdict() for one in self._run.numbers]
        title = self._run.file.title
        return page_of(data, title, ("live.js",), "'self'").encode()

    def answer(self, question: bytes) -> bytes:
        """A motion for ``values`` by path where others are ``shown``, or why none.

        Raises:
            MalformedQuestion: it is no such question.
        """
        from ..files.scene_files import SceneFileError
        from ..validation.checks import FieldError

        values, shown, drawn = question_of(question)
        try:
            with self._lock:
                shapes = self._run.changes_shapes(values, shown)
                found = self._run.data(values, shapes, drawn)
        except SceneFileError as error:
            found = {"refused": str(error).split("\n", 1)[0]}
        except (FieldError, ValueError, TypeError, KeyError) as error:
            found = {"refused": str(error)}
        return json.dumps(found, allow_nan=False).encode()


class _Handler(BaseHTTPRequestHandler):
    """Two addresses: the page, and ``run`` beside it."""

    protocol_version = "HTTP/1.1"  # one connection for all questions

    @property
    def _live(self) -> LiveServer:
        return cast(LiveServer, self.server)

    def do_GET(self) -> None:
        """The page."""
        if self._is_known("/"):
            self._send(200, "text/html; charset=utf-8", self._live.page())

    def do_POST(self) -> None:
        """A motion for other numbers."""
        told = self.headers.get("Content-Length") or "0"
        if not _BYTES.fullmatch(told):
            self.close_connection = True  # nobody knows where the next question begins
            self._refuse(400, "Content-Length is no number of bytes")
            return
        length = int(told)
        if length > _LONGEST:
            self._pass_over(length)
            self._refuse(413, f"the question is longer than {_LONGEST} bytes")
            return
        question = self.rfile.read(length)
        if not self._is_known("/run"):
            return
        try:
            answer = self._live.answer(question)
        except MalformedQuestion as error:
            self._refuse(400, str(error))
        else:
            self._send(200, "application/json", answer)

    def _pass_over(self, length: int) -> None:
        """Read what is not looked at: what is left of it would be the next question."""
        self.close_connection = length > _MOST_READ
        left = min(length, _MOST_READ)
        while left > 0:
            piece = self.rfile.read(min(left, _LONGEST))
            left = left - len(piece) if piece else 0

    def _refuse(self, status: int, why: str) -> None:
        self._send(status, "application/json", json.dumps({"refused": why}).encode())

    def _is_known(self, path: str) -> bool:
        """Whether the address is the page's, asked for by its own name."""
        own = self.headers.get("Host") == self._live.host
        known = own and self.path == f"/{self._live.key}{path}"
        if not known:
            self._send(404, "text/plain", b"no such page")
        return known

    def _send(self, status: int, kind: str, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: a line for each motion would tell nobody anything."""
