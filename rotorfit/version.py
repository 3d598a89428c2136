"""The version, apart from the front so that lower rooms can write it into files without importing the front."""

__version__ = "0.1.0"
