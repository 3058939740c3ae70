"""Exception for bad input: a sentence that names the thing and the remedy."""


class InputError(ValueError):
    """Input that cannot be used as it stands; the message says what is wrong and what to do."""
