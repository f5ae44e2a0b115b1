"""The version of the package; package.xml and CITATION.cff say the same."""

__version__ = "0.2.0"
