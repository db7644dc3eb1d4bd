"""A real MLflow server of the tests' own, with SQLite, that can be killed and started again."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

from mlflow_store_for_tests import give_store

PATIENCE_S = 600.0
NAME, PASSWORD = "admin", "a word of 12 letters"


class MlflowServer:
    """A server on a free port of this machine.

    Args:
        folder: where its database and its artifacts lie.
        database: URL of its database; None for SQLite in the folder.
        is_guarded: whether it asks for a name and a password.
    """

    def __init__(self, folder: Path, *, database: str | None = None, is_guarded: bool = False) -> None:
        self._folder, self._is_guarded = folder, is_guarded
        if database is None:
            give_store(folder)
        folder.mkdir(exist_ok=True)
        self._database = database or f"sqlite:///{folder}/mlruns/mlflow.db"
        with socket.socket() as listener:
            listener.bind(("127.0.0.1", 0))
            self._port = int(listener.getsockname()[1])
        self.uri = f"http://127.0.0.1:{self._port}"
        self.start()

    def start(self) -> None:
        """Start it, and wait until it answers."""
        command = [sys.executable, "-P", "-W", "ignore", "-m", "mlflow", "server", "--host", "127.0.0.1"]
        command += ["--port", str(self._port), "--workers", "1", "--backend-store-uri", self._database]
        command += ["--artifacts-destination", str(self._folder / "artifacts")]
        more = {"MLFLOW_DISABLE_TELEMETRY": "true", "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"}
        if self._is_guarded:
            command += ["--app-name", "basic-auth"]
            settings = self._folder / "auth.ini"
            settings.write_text(
                "[mlflow]\ndefault_permission = READ\n"
                f"database_uri = sqlite:///{self._folder}/auth.db\n"
                f"admin_username = {NAME}\nadmin_password = {PASSWORD}\n"
                "authorization_function = mlflow.server.auth:authenticate_request_basic_auth\n",
                encoding="utf-8",
            )
            more |= {"MLFLOW_AUTH_CONFIG_PATH": str(settings), "MLFLOW_FLASK_SERVER_SECRET_KEY": "of tests"}
        with (self._folder / "log").open("ab") as log:
            self._server = subprocess.Popen(
                command,
                cwd=self._folder,
                env=os.environ | more,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline and self._server.poll() is None:
            with suppress(OSError), urllib.request.urlopen(f"{self.uri}/health", timeout=2.0):
                return
            time.sleep(0.1)
        raise AssertionError((self._folder / "log").read_text())

    def kill(self) -> None:
        """Stop it at once, as a crash does."""
        with suppress(ProcessLookupError):
            os.killpg(self._server.pid, signal.SIGKILL)
        self._server.wait(PATIENCE_S)

    def close(self) -> None:
        """Stop it, and remove what it has."""
        self.kill()
        shutil.rmtree(self._folder, ignore_errors=True)


class WithoutRegistry(ThreadingHTTPServer):
    """A proxy before a server that serves runs and no registered models, as some companies have.

    Args:
        uri: the server.
    """

    def __init__(self, uri: str) -> None:
        class Handler(BaseHTTPRequestHandler):
            def log_message(self, *_: object) -> None:
                """Say nothing."""

            def do_GET(self) -> None:
                length = int(self.headers.get("Content-Length", 0))
                body = self.rfile.read(length) or None
                request = urllib.request.Request(uri + self.path, body, method=self.command)
                request.add_header("Content-Type", self.headers.get("Content-Type", "application/json"))
                code, answer = 404, b"no such page"
                if "registered-models" not in self.path and "model-versions" not in self.path:
                    try:
                        with urllib.request.urlopen(request) as found:
                            code, answer = found.status, found.read()
                    except urllib.error.HTTPError as error:
                        code, answer = error.code, error.read()
                self.send_response(code)
                self.send_header("Content-Length", str(len(answer)))
                self.end_headers()
                self.wfile.write(answer)

        for method in ("POST", "PUT", "PATCH", "DELETE"):
            setattr(Handler, f"do_{method}", Handler.do_GET)
        super().__init__(("127.0.0.1", 0), Handler)
        self.uri = f"http://127.0.0.1:{self.server_port}"
        self._thread = Thread(target=self.serve_forever, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop it."""
        self.shutdown()
        self.server_close()
        self._thread.join()
