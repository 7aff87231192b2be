"""Root of the errors that a person can act on."""


class UserError(Exception):
    """Unusable input or surroundings: one sentence that says what, where, and what to do.

    The command line prints the sentence on standard error and exits with status 2.
    """
