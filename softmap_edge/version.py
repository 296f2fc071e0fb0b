"""The version of the package, for files and documents that say what wrote them."""

__version__ = "0.1.0"
