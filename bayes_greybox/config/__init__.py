"""Configuration files: TOML in, checked key by key, and from them the data and the model.

Reading and checking a file is quick: the rest of the package is imported when data or models are built.
"""

from .file import Config, load_config

__all__ = ["Config", "load_config"]
