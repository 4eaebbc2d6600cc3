"""`Usage`: an error of what was asked for."""


class Usage(ValueError):
    """What the user asked for cannot be done as asked."""
