"""The one base class of everything this package refuses."""


class FlatsatError(ValueError):
    """A value that cannot be used; the text names the value, the bound it breaks and what would be valid."""
