"""The one exception of this package."""


class TauflowError(Exception):
    """Something that cannot be read or made. The message names the file or item, and the remedy."""
