"""How counted things are named in messages."""


def noun_of(n: int, noun: str, several: str = "") -> str:
    """Return the noun for so many things: call, calls.

    Args:
        n: How many there are.
        noun: What one of them is called.
        several: What several are called where an s is not enough.
    """
    return noun if n == 1 else several or f"{noun}s"
