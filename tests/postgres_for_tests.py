"""A PostgreSQL server of the tests' own: a throwaway cluster on a free port of this machine."""

import os
import pwd
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from pathlib import Path

import psycopg

PATIENCE_S = 600.0
_SETTINGS = """\
listen_addresses = '127.0.0.1'
fsync = off
full_page_writes = off
shared_buffers = 32MB
max_connections = 100
lc_messages = 'C'
"""


def missing_postgres() -> str | None:
    """Return why there can be no server here, None where there can be one."""
    if _programs() is None:
        return "no PostgreSQL is installed (Debian: apt-get install postgresql)"
    if os.geteuid() == 0 and not _has_user():
        return "PostgreSQL refuses to run as root, and there is no user postgres"
    return None


class PostgresServer:
    """A cluster that lives as long as the tests; its server dies with this process, however that dies."""

    def __init__(self) -> None:
        programs = _programs()
        assert programs is not None
        self.folder = Path(tempfile.mkdtemp(prefix="studies-postgres-"))
        self.port = _free_port()
        self._n_databases = 0
        if os.geteuid() == 0:
            shutil.chown(self.folder, "postgres", "postgres")
        data = self.folder / "data"
        initdb = [str(programs / "initdb"), "-D", str(data), "-U", "tester", "-E", "UTF8"]
        subprocess.run(
            [*_as_postgres(), *initdb, "-A", "trust", "-N", "--locale=C"], check=True, capture_output=True
        )
        with (data / "postgresql.conf").open("a") as file:
            file.write(f"{_SETTINGS}port = {self.port}\nunix_socket_directories = '{self.folder}'\n")
        self._start()

    def _start(self) -> None:
        programs, data = _programs(), self.folder / "data"
        assert programs is not None
        with (self.folder / "log").open("ab") as log:
            self._server = subprocess.Popen(
                [*_as_postgres(), str(programs / "postgres"), "-D", str(data)],
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                psycopg.connect(self.url("postgres"), connect_timeout=2).close()
                return
            except psycopg.OperationalError:
                if self._server.poll() is not None or time.monotonic() > deadline:
                    raise AssertionError((self.folder / "log").read_text()) from None
                time.sleep(0.02)

    def _stop(self) -> None:
        self._server.send_signal(signal.SIGQUIT)
        self._server.wait(PATIENCE_S)

    def restart(self, pause_s: float) -> None:
        """Stop the server at once, as a crash does, and start it again after a while."""
        self._stop()
        time.sleep(pause_s)
        self._start()

    def close(self) -> None:
        """Stop the server at once and remove the cluster."""
        self._stop()
        shutil.rmtree(self.folder, ignore_errors=True)

    def url(self, database: str) -> str:
        """Return the URL of a database."""
        return f"postgresql://tester@127.0.0.1:{self.port}/{database}"

    def new_database(self, of: str | None = None) -> str:
        """Make a database, an empty one or a copy of one by its URL, and return its URL."""
        self._n_databases += 1
        name = f"studies{self._n_databases}"
        template = f" template {of.rpartition('/')[2]}" if of else ""
        self.execute(f"create database {name}{template}")
        return self.url(name)

    def drop(self, url: str) -> None:
        """Remove a database, whoever is connected."""
        self.execute(f"drop database {url.rpartition('/')[2]} with (force)")

    def execute(self, statement: str, database: str = "postgres") -> list[tuple[object, ...]]:
        """Run a statement as the server's master."""
        with psycopg.connect(self.url(database), autocommit=True) as connection:
            cursor = connection.execute(statement.encode())
            return cursor.fetchall() if cursor.description else []


def _as_postgres() -> list[str]:
    command = ["setpriv", "--pdeathsig", "QUIT"]
    if os.geteuid() == 0:
        command += ["--reuid", "postgres", "--regid", "postgres", "--clear-groups"]
    return command


def _programs() -> Path | None:
    on_path = shutil.which("initdb")
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda file: float(file.parts[-3]))
    if on_path:
        return Path(on_path).resolve().parent
    return found[-1].parent if found else None


def _has_user() -> bool:
    try:
        pwd.getpwnam("postgres")
    except KeyError:
        return False
    return True


def _free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])
