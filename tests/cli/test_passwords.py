"""Nothing that could be a password is shown, however malformed the URL or the DSN around it is."""

import json

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from simulation.errors import InputError
from studies.cli import main
from studies.storage_url import hide_passwords, read_storage

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
before = st.sampled_from(["", "error: ", "the storage '", "a http://127.0.0.1:5000/x and ", "--storage="])
after = st.sampled_from(["", "' is away", " (server said: no)", "\nmore", "; mail me@host"])


@given(schemes, users, passwords, hosts, before, after)
@example("postgresql", "me", f"a {MARK}", "host", "", "")
@example("postgresql", "me", f"%zz{MARK}", "host", "", "")
@example("postgresql", "me", f"a@{MARK}", "host", "", "")
@example("postgresql", "me", f"12/{MARK}", "host", "", "")
def test_no_url_shows_its_password(
    scheme: str, user: str, password: str, host: str, before: str, after: str
) -> None:
    shown = hide_passwords(f"{before}{scheme}://{user}:{password}@{host}/db?sslmode=require{after}")
    assert MARK not in shown
    assert hide_passwords(shown) == shown


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
            said, is_url = read_storage(given_), True
        except InputError as error:
            said, is_url = str(error), False
        shown = hide_passwords(said)
        assert "\n" not in said
        assert is_url or shown == said, "the advice stays whole"
        # A number behind the colon may be a port, and what follows the database.
        assert MARK not in shown or (is_url and given_.endswith(password))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "postgresql://me@host/db is away; write postgresql://user@host/database",
        "http://127.0.0.1:5000/#/experiments",
        "password authentication failed for user me",
        "postgresql://me:***@host/db does not answer (at 10:12)",
    ],
)
def test_other_texts_stay_as_they_are(text: str) -> None:
    assert hide_passwords(text) == text


@pytest.mark.parametrize(
    "words",
    [
        ("--storage", f"postgresql://me:a {MARK}@host/db"),
        ("--storage", f"host=h password={MARK} dbname=d"),
        ("--storage", "postgresql://me:a", f"{MARK}@host/db"),  # a blank that the shell has split at
        (f"--store=postgresql://me:a{MARK}@host/db",),
        ("--storage", "host=h", f"password={MARK}"),
    ],
)
def test_no_command_shows_a_password(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    for more in ((), ("--json",)):
        assert main(["status", *words, *more]) == 2
        said = capsys.readouterr()
        assert MARK not in said.out + said.err
        assert len(said.err.splitlines()) == 1
        assert not more or json.loads(said.out)["error"]
