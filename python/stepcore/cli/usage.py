"""`Usage`: an error in the arguments of a command."""


class Usage(ValueError):
    """The arguments of a command are wrong, or contradict each other."""
