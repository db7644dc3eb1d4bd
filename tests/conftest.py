"""What holds for all tests."""

import signal
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from postgres_for_tests import PostgresServer

# A shell starts background jobs with Ctrl-C ignored, which they pass on; tests interrupt processes.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def postgres_server() -> Iterator["PostgresServer"]:
    """A throwaway PostgreSQL cluster."""
    from postgres_for_tests import PostgresServer, missing_postgres

    if reason := missing_postgres():
        pytest.skip(reason)
    server = PostgresServer()
    yield server
    server.close()


@pytest.fixture
def storage(postgres_server: "PostgresServer") -> str:
    """URL of an empty database."""
    return postgres_server.new_database()
