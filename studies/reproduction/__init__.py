"""Making a recorded number again, and saying what differs when it does not come out the same."""
