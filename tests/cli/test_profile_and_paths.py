"""Profiles are budgets checked at the edge; paths find the project and its cases."""

import pytest

from studies.keywords import window
from studies.profile import load_profile, profile_names


def test_all_shipped_profiles_are_read_under_their_own_name() -> None:
    assert {"quick", "paper", "smoke"} <= set(profile_names())
    for name in profile_names():
        assert load_profile(name).name == name
        assert load_profile(name).note


@pytest.mark.parametrize(
    ("text", "label"),
    [
        ("8-16", "d8-16"),
        ("0-2.5h", "h0-2.5"),
        ("0-1209600s", "s0-1209600"),
        ("0-1234567s", "s0-1234567"),
        ("0.00001-0.1234567", "d0.00001-0.1234567"),
    ],
)
def test_a_window_keeps_all_its_digits_and_can_be_typed_again(text: str, label: str) -> None:
    asked = window(text)
    assert (asked.label, str(asked), window(str(asked))) == (label, text, asked)
