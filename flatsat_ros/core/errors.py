"""The one base class of everything this package refuses."""


class FlatsatError(ValueError):
    """A value that cannot be used; the text names the value, the bound it breaks and what would be valid."""


def require(holds: bool, name: str, value: object, valid: str) -> None:
    """Raise FlatsatError unless the bound holds: "name is value: valid is ..."."""
    if not holds:
        raise FlatsatError(f"{name} is {value}: valid is {valid}")
