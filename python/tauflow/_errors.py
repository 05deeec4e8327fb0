"""The exception and the warning of this package."""


class TauflowError(Exception):
    """Something that cannot be read or made. The message names the file or item, and the remedy."""


class Missing(TauflowError, KeyError):
    """A TauflowError of a mapping that has no such key, so that `get` and `in` work as those of a dict."""

    # KeyError would put the message in quotes.
    __str__ = Exception.__str__


class TauflowWarning(UserWarning):
    """Something that looks wrong in what was given, though the result was made."""
