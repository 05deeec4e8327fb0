"""The exception and the warning of this package."""


class TauflowError(Exception):
    """Something that cannot be read or made. The message names the file or item, and the remedy."""


class TauflowWarning(UserWarning):
    """Something that looks wrong in what was given, though the result was made."""
