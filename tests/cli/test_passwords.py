"""A storage that holds a password is refused without showing it, however malformed it is."""

import json

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from simulation.errors import InputError
from studies.cli import main
from studies.storage_url import read_storage

MARK = "zq1x"
"""Part of every password here, and of nothing else."""
SIGNS = (*" @:/?#&='\"\\%\n\t[]", "://", "%zz", "%40", "\\'", "12", "5432/", " host=", "é", "x@y:", "***")
passwords = st.lists(st.one_of(st.just(MARK), st.sampled_from(SIGNS)), min_size=1, max_size=7).map(
    lambda parts: "".join(parts) + MARK
)
schemes = st.sampled_from(["postgresql", "postgres", "postgresql+psycopg", "mysql", "http", "https", "P2"])
users = st.sampled_from(["", "me", "me%40corp", "me@corp", "a.b"])
hosts = st.sampled_from(["host", "127.0.0.1", "[::1]", "host:5432", "", "h1:1,h2:2"])
keys = st.sampled_from(
    ["password", "sslpassword", "PGPASSWORD", "Password", "p%61ssword", "passwd", "pwd", "db_secret", "token"]
)


@given(schemes, users, passwords, hosts, keys)
def test_no_storage_that_is_refused_shows_its_password(
    scheme: str, user: str, password: str, host: str, key: str
) -> None:
    for given_ in (
        f"{scheme}://{user}:12/x?{password}@{host}/db",
        f"{scheme}://{user}:12/x#{password}@{host}/db",
        f"{scheme}://{user}:{password}@{host}/db",
        f"{scheme}://{user}:{password}@{host}",
        f"{scheme}://{user}:{password}",
        f"{scheme}:/{user}:{password}@{host}/db",
        f"{user}:{password}@{host}/db",
        f"{scheme}://{host}/db?{key}={password}",
        f"host={host} {key}={password}",
        password,
    ):
        try:
            said = read_storage(given_)
        except InputError as error:
            said = str(error)
        assert "\n" not in said
        # A number behind the colon may be a port, and what follows the database.
        assert MARK not in said or given_.endswith(password)


@example("postgresql", "me", f"%zz{MARK}", "host", "password")
@example("postgresql", "me", f"12/{MARK}", "host", "password")
@given(schemes, users, passwords, hosts, keys)
def test_no_url_that_is_accepted_holds_a_password(
    scheme: str, user: str, password: str, host: str, key: str
) -> None:
    for given_ in (
        f"{scheme}://{user}:{password}@{host}/db",
        f"{scheme}://{user}@{host}/db?{key}={password}",
    ):
        with pytest.raises(InputError, match="the storage"):
            read_storage(given_)


def test_a_url_without_a_password_is_read_and_one_with_it_names_the_remedy() -> None:
    assert read_storage("postgres://me@host:5432/db?sslmode=require") == (
        "postgresql://me@host:5432/db?sslmode=require"
    )
    with pytest.raises(InputError, match=r"holds a password.*write postgresql://user@host/database.*pgpass"):
        read_storage("postgresql://me:a@host/db")


@pytest.mark.parametrize(
    "words",
    [
        ("--storage", f"postgresql://me:a {MARK}@host/db"),
        ("--storage", f"host=h password={MARK} dbname=d"),
        (f"--storage=postgresql://me:{MARK}@host/db",),
    ],
)
def test_no_command_shows_a_password(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    for more in ((), ("--json",)):
        assert main(["status", *words, *more]) == 2
        said = capsys.readouterr()
        assert MARK not in said.out + said.err
        assert len(said.err.splitlines()) == 1
        assert not more or json.loads(said.out)["error"]
