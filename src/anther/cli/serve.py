"""Show the history on pages for a browser or a phone: today's visits, failures, trends, robots, plants. Read-only."""

from __future__ import annotations

import socket
from contextlib import suppress

from anther.cli.args.serve import Args
from anther.core.checks import check_range
from anther.core.errors import MissingExtra, bad_input
from anther.core.files import existing
from anther.history import count_trials, hide_password

LOCALHOST = "127.0.0.1"


def run(args: Args) -> None:
    """Serve until Ctrl-C."""
    check_range("port", args.port, 0, 65535)
    try:
        import uvicorn

        from anther.show.serve import make_app
    except ImportError as error:
        raise MissingExtra(
            "anther history serve needs FastAPI. Install it with: pip install 'anther[serve]'"
        ) from error
    token = None if args.token is None else existing(args.token).read_text(encoding="utf-8").strip()
    if token is not None and len(token) < 16:
        allowed = "16 or more, e.g. of: openssl rand -hex 16"
        raise bad_input("token", given=f"{len(token)} characters", allowed=allowed, do="Write a longer one.")
    visits = count_trials(args.history)
    local = args.host in (LOCALHOST, "localhost", "::1")
    with _listen(args.host, args.port) as listener:
        port = listener.getsockname()[1]
        name = f"[{args.host}]" if ":" in args.host else args.host
        print(f"{hide_password(args.history)}: {visits} visits at http://{name}:{port}/ (Ctrl-C ends)")
        reader = "only this computer" if local else "everybody who reaches this computer"
        print(f"{reader} can read it; notes: {'with the token' if token else 'none can be written'}", flush=True)
        app = make_app(args.history, existing(args.runs), token, local=local)
        config = uvicorn.Config(app, log_level="warning", server_header=False, timeout_graceful_shutdown=3)
        with suppress(KeyboardInterrupt):  # how it is ended
            uvicorn.Server(config).run(sockets=[listener])


def _listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens there."""
    try:
        return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        given = f"{host}, port {port}: {error.strerror or error}"
        allowed = "an address of this computer and a free port"
        raise bad_input("address", given=given, allowed=allowed, do="Choose another --host or --port.") from error
