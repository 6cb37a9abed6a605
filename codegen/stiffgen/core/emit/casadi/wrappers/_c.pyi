"""Part of the compiled module NAME_python that the wrappers read; a folder's package has it as ``_c``."""

from typing import Any

SOURCES: str

def __getattr__(name: str) -> Any: ...  # a ufunc per function
