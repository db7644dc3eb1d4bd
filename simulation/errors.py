"""The one error a user's own files and options can cause."""


class InputError(ValueError):
    """Something the user gave is wrong; the message is one line that says what, where and what to do."""
