"""What a user is told in one line: their own files and options are wrong, or the machine is in the way."""


class InputError(ValueError):
    """Something the user gave is wrong; the message is one line that says what, where and what to do."""


class MachineError(InputError):
    """The machine is in the way: told as well, but once it is put right, the same words will do."""
