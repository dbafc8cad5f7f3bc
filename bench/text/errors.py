"""What all errors in a user's request have in common."""


class UsageError(ValueError):
    """Something was asked for that makes no sense; the message is one line for the user."""
