"""Which version of the package this is, for all that writes it down."""

__version__ = "0.2.0"
